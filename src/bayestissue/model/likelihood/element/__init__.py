"""Decelerations of an impact on a mechanical element."""
