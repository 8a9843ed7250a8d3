"""Finished fits of the same data side by side."""
