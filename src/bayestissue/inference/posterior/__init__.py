"""The posterior of a fit: approximate, integrate out, sample, correct, draw; and the exact path."""
