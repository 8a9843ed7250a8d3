"""One module a command: read, compute, write whole, and say on the console what was done."""
