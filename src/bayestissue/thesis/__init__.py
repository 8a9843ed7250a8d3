"""The thesis: its numbers recomputed, audited and analysed anew."""
