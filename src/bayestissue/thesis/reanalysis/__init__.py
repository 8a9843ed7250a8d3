"""Published estimates: their posterior, and the explanations that compete for them."""
