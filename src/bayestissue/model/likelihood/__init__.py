"""The likelihood of a trace: an exact one of ARMA(2,1) displacements, and of decelerations on any element."""
