"""What is done with a study: fit, check, estimate, compare, simulate, plan, watch, open, certify."""
