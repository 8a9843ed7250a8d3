"""What the draws of an impact stand for: stiffness at a depth, energy, exponents."""
