"""Samplers of any density, importance weights, and whether draws can be trusted."""
