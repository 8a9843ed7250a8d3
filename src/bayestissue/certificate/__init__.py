"""The certificate of a fit: whether it is calibrated about this very study, and what its priors do to it."""
