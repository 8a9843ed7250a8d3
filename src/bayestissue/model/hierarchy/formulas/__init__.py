"""Formulas: their terms, what a table of impacts can tell of them, and their columns."""
