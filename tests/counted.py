"""Counts that say how much a fit works, the same on any machine."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager

import jax

COMPILED = "/jax/core/compile/backend_compile_duration"


@contextmanager
def counted() -> Iterator[Counter[str]]:
    """How often each of JAX's events came; programs that are read from a folder count as compiled too."""
    events: Counter[str] = Counter()

    def listen(event: str, _: float, **__: object) -> None:
        events[event] += 1

    jax.monitoring.register_event_duration_secs_listener(listen)
    try:
        yield events
    finally:
        jax.monitoring.unregister_event_duration_listener(listen)
