"""What is believed: the likelihood of a trace, formulas, and the population over impacts."""
