"""Whether draws can be trusted: convergence, importance weights, the verdict."""
