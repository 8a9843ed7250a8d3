"""From draws of hyperparameters, effects and impacts to all that they stand for."""
