"""One Markov chain over hyperparameters, effects and every impact, from values of the likelihood alone."""
