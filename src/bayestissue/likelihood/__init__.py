"""The probability of a whole impact's displacement, as numpyro distributions."""
