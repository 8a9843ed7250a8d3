"""A mass on tissue that an instrumented hammer taps: it rings with an impulse that is known."""
