"""From a model and data to answers: point estimates, sampling, diagnostics, predictive checks."""
