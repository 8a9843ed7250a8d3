"""Draws as labelled tables and trees, predictions, scores, and what makes an interval wide."""
