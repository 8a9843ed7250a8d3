"""The model over impacts: its specification, covariates, subject and trial effects, priors."""
