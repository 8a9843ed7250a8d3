"""How functions are compiled that are called a few times only, and which parts are compiled ahead."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import jax

# The parts of a fit whose functions another process may compile ahead; see `bayestissue.inference.ahead`.
CHAINS, CORRECTION, DRAWS, PREDICTIONS = "chains", "correction", "draws", "predictions"
Wait = Callable[[str], None]


def at_once(part: str) -> None:
    """Wait for nothing."""


# XLA spends most of a compilation on making the result fast.
_QUICKLY = {"xla_backend_optimization_level": 0}


def compiled_quickly(static_argnames: str | Sequence[str] = ()) -> Callable[[Callable[..., Any]], Any]:
    """`jax.jit` for what takes longer to compile than to run: half the wait, and slower steps.

    Not to be called from within another compiled function, which has options of its own.

    Args:
        static_argnames: as of `jax.jit`.
    """
    return lambda function: jax.jit(function, static_argnames=static_argnames, compiler_options=_QUICKLY)
