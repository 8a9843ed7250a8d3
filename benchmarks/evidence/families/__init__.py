"""Figures of each family of pieces, in functions of its name."""
