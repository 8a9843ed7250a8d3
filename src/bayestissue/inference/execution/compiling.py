"""How functions are compiled that are called a few times only, and what a second process may do meanwhile."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

# The parts of a fit whose functions another process may compile ahead: see `ahead`.
CHAINS, CORRECTION, CHOICE = "chains", "correction", "choice"
DRAWS, PREDICTIONS = "draws", "predictions"


Function = Callable[..., Any]
Result = Callable[[], Any]


class Helper:
    """Nobody: whoever asks does everything himself. `inference.execution.ahead` has one on another core."""

    def compile_ahead(self, *, profiled: bool | None = None) -> None:
        """Compile what a fit will need; asked once or more often.

        ``profiled`` is a guess of what will be `decided`.
        """

    def decided(self, *, profiled: bool) -> None:
        """Told as soon as it is known whether the last parameter has a profile, as compiled functions ask."""

    def wait(self, part: str) -> None:
        """Wait until a part is compiled."""

    def share(
        self, part: str, function: Function, given: tuple[Any, ...], pieces: Sequence[tuple[Any, ...]]
    ) -> list[Any]:
        """``function(*given, *piece)`` of every piece, done by whoever is free."""
        return [function(*given, *piece) for piece in pieces]

    def begin(self, function: Function, *arguments: Any) -> Result:
        """Begin any function; what is returned gives the result."""
        return partial(function, *arguments)


def in_pieces(
    helper: Helper, part: str, function: Function, given: tuple[Any, ...], rows: tuple[Any, ...]
) -> Any:
    """``function(*given, *rows)``, of which rows on a first axis are independent, shared with the helper.

    All pieces have one length, so that one compilation serves them, and the numbers are the same whoever
    makes them.
    """
    count = len(jax.tree.leaves(rows)[0])
    each = length_of_piece(count)
    # The last rows fill the last piece, which begins with some that the one before it has too.
    begins = range(0, count, each)
    starts = [min(begin, count - each) for begin in begins]
    pieces = [jax.tree.map(lambda leaf: leaf[start : start + each], rows) for start in starts]  # noqa: B023
    made = helper.share(part, function, given, pieces)
    own = [
        jax.tree.map(lambda leaf: leaf[begin - start :], piece)  # noqa: B023
        for piece, begin, start in zip(made, begins, starts, strict=True)
    ]
    return jax.tree.map(lambda *parts: jnp.concatenate(parts), *own)


def length_of_piece(count: int) -> int:
    """How many of so many rows `in_pieces` asks for at once."""
    return -(-count // _PIECES)


# So few that what they share is not sent too often, so many that nobody waits long for another.
_PIECES = 8


def in_calls(function: Function, rows: Any, size: int) -> Any:
    """``function(*rows, number)`` for any number of rows, ``size`` of them a call, as numpy arrays.

    ``function`` makes the first ``number`` of them, by `first_rows`: one compilation serves any number.
    """
    count, parts = len(jax.tree.leaves(rows)[0]), []
    for begin in range(0, count, size):
        number = min(size, count - begin)
        places = begin + np.minimum(np.arange(size), number - 1)
        found = function(*jax.tree.map(lambda leaf: np.asarray(leaf)[places], rows), number)  # noqa: B023
        parts.append(jax.tree.map(lambda leaf: np.asarray(leaf)[:number], found))  # noqa: B023
    return jax.tree.map(lambda *leaves: np.concatenate(leaves), *parts)


def first_rows(one: Function, size: int, number: Any) -> Any:
    """``one(place)`` of the first ``number`` places along an axis as long as ``size``, 0 behind them."""

    def add(place: Any, found: Any) -> Any:
        return jax.tree.map(lambda whole, row: whole.at[place].set(row), found, one(place))

    shapes = jax.eval_shape(one, 0)
    empty = jax.tree.map(lambda shape: jnp.zeros((size, *shape.shape), shape.dtype), shapes)
    return jax.lax.fori_loop(0, number, add, empty)


# XLA spends most of a compilation on making the result fast.
_QUICKLY, _SOONER = {"xla_backend_optimization_level": 0}, {"xla_backend_optimization_level": 1}
Static = str | Sequence[str]


def compiled_quickly(static_argnames: Static = ()) -> Callable[[Callable[..., Any]], Any]:
    """`jax.jit` for what takes longer to compile than to run: half the wait, and slower steps.

    Not to be called from within another compiled function, which has options of its own.

    Args:
        static_argnames: as of `jax.jit`.
    """
    return lambda function: jax.jit(function, static_argnames=static_argnames, compiler_options=_QUICKLY)


def compiled_sooner(static_argnames: Static = ()) -> Callable[[Callable[..., Any]], Any]:
    """`jax.jit` for what runs about as long as it compiles: a fifth less wait, and steps as fast.

    Not for slopes, which were measured to take up to four times as long; otherwise as `compiled_quickly`.
    """
    return lambda function: jax.jit(function, static_argnames=static_argnames, compiler_options=_SOONER)
