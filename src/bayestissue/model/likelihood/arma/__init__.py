"""Displacements as an ARMA(2,1) or a sampled A(2)."""
