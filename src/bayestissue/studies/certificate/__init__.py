"""The certificate of a fit: whether it is calibrated about this very study, and what its priors do to it."""

# Studies drawn anew and fitted, unless told otherwise; the fewest and the most.
REFITS, FEWEST_REFITS, MOST_REFITS = 20, 10, 1000
