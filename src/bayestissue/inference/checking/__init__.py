"""Whether the traces contradict the model or the declared measuring chain."""
