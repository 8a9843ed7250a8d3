"""The thesis: its numbers recomputed, audited and analysed anew, and why K seems to grow with the mass."""
