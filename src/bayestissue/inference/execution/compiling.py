"""How functions are compiled that are called a few times only."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

Function = Callable[..., Any]


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
