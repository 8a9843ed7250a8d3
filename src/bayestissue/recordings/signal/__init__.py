"""From a recording to the displacement of one impact: offset, contact, integration, window."""

from bayestissue.recordings.signal.displacement import Displacements, displacements
from bayestissue.recordings.signal.signal_settings import SignalOptions, read_signal_options

__all__ = ["Displacements", "SignalOptions", "displacements", "read_signal_options"]
