"""Effects and parameters of impacts integrated out in closed form, Gaussian factors given."""
