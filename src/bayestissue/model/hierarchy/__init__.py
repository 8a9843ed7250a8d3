"""The model over impacts: its specification, covariates, subject and trial effects, priors."""

# The element of a model file that names none: a spring and a damper side by side.
SIDE_BY_SIDE = "kelvin_voigt"
