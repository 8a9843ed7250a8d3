"""From a recording to the displacement of one impact: offset, contact, integration, window."""
