"""From draws of hyperparameters, effects and impacts to quantities: K and C, energy, exponents."""
