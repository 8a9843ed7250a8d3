"""How functions are compiled that are called a few times only, and what a second process may do meanwhile."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp

# The parts of a fit whose functions another process may compile ahead; see `bayestissue.inference.ahead`.
CHAINS, CORRECTION, CHOICE = "chains", "correction", "choice"
DRAWS, PREDICTIONS = "draws", "predictions"


Function = Callable[..., Any]
Result = Callable[[], Any]


class Helper:
    """Nobody: whoever asks does everything himself. `bayestissue.inference.ahead` has one on another core."""

    def decided(self, *, profiled: bool) -> None:
        """Told as soon as it is known whether the last parameter has a profile, as compiled functions ask."""

    def wait(self, part: str) -> None:
        """Wait until a part is compiled."""

    def begin_rows(self, part: str, function: Function, *arguments: Any) -> Result:
        """Begin a part's function on some rows; what is returned gives the result."""
        return partial(function, *arguments)

    def begin(self, function: Function, *arguments: Any) -> Result:
        """Begin any function; what is returned gives the result."""
        return partial(function, *arguments)


def in_halves(
    helper: Helper, part: str, function: Function, given: tuple[Any, ...], rows: tuple[Any, ...]
) -> Any:
    """``function(*given, *rows)``, of which rows on a first axis are independent: half of it by the helper.

    Both halves have one length, the last row being done twice where the number is odd, so that one
    compilation serves both, and the numbers are the same whoever makes them.
    """
    count = len(jax.tree.leaves(rows)[0])
    half = -(-count // 2)
    first = jax.tree.map(lambda leaf: leaf[:half], rows)
    second = jax.tree.map(lambda leaf: leaf[count - half :], rows)
    others = helper.begin_rows(part, function, *given, *second)
    made = function(*given, *first)
    return jax.tree.map(lambda a, b: jnp.concatenate([a, b[2 * half - count :]]), made, others())


# XLA spends most of a compilation on making the result fast.
_QUICKLY = {"xla_backend_optimization_level": 0}


def compiled_quickly(static_argnames: str | Sequence[str] = ()) -> Callable[[Callable[..., Any]], Any]:
    """`jax.jit` for what takes longer to compile than to run: half the wait, and slower steps.

    Not to be called from within another compiled function, which has options of its own.

    Args:
        static_argnames: as of `jax.jit`.
    """
    return lambda function: jax.jit(function, static_argnames=static_argnames, compiler_options=_QUICKLY)
