"""How work is compiled, cut into chunks and shared."""
