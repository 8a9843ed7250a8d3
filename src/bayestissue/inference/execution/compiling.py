"""How functions are compiled: as well as they are worth, and for any number of rows at once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial, wraps
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from bayestissue.base.impact_arrays import padded_impacts

Function = Callable[..., Any]
# XLA spends most of a compilation on making the result fast. Level 1 compiles in a fifth less time and its
# steps are as fast, but those of slopes were measured to take up to four times as long.
_QUICKLY, _SOONER = {"xla_backend_optimization_level": 0}, {"xla_backend_optimization_level": 1}
# XLA's own level, for what runs thousands of times, whatever XLA_FLAGS say.
FULLY = {"xla_backend_optimization_level": 3}

# `jax.jit` for what takes longer to compile than to run: half the wait, and slower steps. Not to be called
# from within another compiled function, which has options of its own.
compiled_quickly = partial(jax.jit, compiler_options=_QUICKLY)


def by_row(size: int, *, constant: int, axes: int = 1) -> Callable[[Function], Function]:
    """Makes a function of one row one of any number of rows along first axes, its results numpy arrays.

    A row is a draw, say, and its ``axes`` two if draws are [chain, draw, ...].

    ``size`` rows go into one compiled call, which makes as many of them as there are: one compilation serves
    any number. Not to be called from within another compiled function.

    Args:
        size: about as many rows as are often asked for at once.
        constant: how many arguments come before the row's, the same for all rows.
        axes: how many first axes rows lie along.
    """

    def decorated(function: Function) -> Function:
        @partial(jax.jit, compiler_options=_SOONER)
        @wraps(function)
        def first(*arguments: Any) -> Any:
            same, rows, number = arguments[:constant], arguments[constant:-1], arguments[-1]
            return _first_rows(lambda *row: function(*same, *row), rows, number)

        @wraps(function)
        def called(*arguments: Any) -> Any:
            of_rows = filled_up(partial(first, *arguments[:constant]), size)
            return in_parts(of_rows, arguments[constant:], size, axes)

        called.jitted = first  # type: ignore[attr-defined]
        return called

    return decorated


def padded(*axes: int | None) -> Callable[[Function], Function]:
    """Makes a compiled function of (model, data, ...) one of any number of impacts.

    It is called with a `bayestissue.base.impact_arrays.bucket` of impacts and of samples, and without the
    population's design; what it returns is cut to the impacts again, along the first of the axes that are
    named.

    Args:
        axes: along which impacts lie in each argument after the data; None of one that has none.
    """
    of_results = next(axis for axis in axes if axis is not None)

    def decorated(function: Function) -> Function:
        @wraps(function)
        def called(model: Any, data: Any, *arguments: Any) -> Any:
            filled = [
                values if axis is None else padded_impacts(values, axis)
                for values, axis in zip(arguments, axes, strict=True)
            ]
            results = function(model, replace(data.padded, design=None), *filled)
            among = (slice(None),) * of_results + (slice(len(data.log_mass)),)
            return jax.tree.map(lambda leaf: np.asarray(leaf)[among], results)

        return called

    return decorated


def filled_up(function: Function, size: int) -> Function:
    """``function(*rows, number)`` of ``size`` rows for any ``number`` up to that, the last filling up."""

    def called(*rows: Any) -> Any:
        number = len(jax.tree.leaves(rows)[0])
        places = np.minimum(np.arange(size), number - 1)
        results = function(*jax.tree.map(lambda leaf: leaf[places], rows), number)
        return jax.tree.map(lambda leaf: np.asarray(leaf)[:number], results)

    return called


def in_parts(function: Function, rows: Any, size: int, axes: int = 1) -> Any:
    """``function(*rows)`` of at most ``size`` rows at a time, as numpy arrays; ``axes`` as of `by_row`."""
    rows = jax.tree.map(np.asarray, rows)
    shape = jax.tree.leaves(rows)[0].shape[:axes]
    rows = jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[axes:]), rows)
    begins = range(0, len(jax.tree.leaves(rows)[0]), size)
    parts = [function(*jax.tree.map(lambda leaf: leaf[begin : begin + size], rows)) for begin in begins]  # noqa: B023
    results = jax.tree.map(lambda *leaves: np.concatenate(leaves), *parts)
    return jax.tree.map(lambda leaf: leaf.reshape(*shape, *leaf.shape[1:]), results)


def _first_rows(one: Function, rows: Any, number: Any) -> Any:
    """``one(*row)`` of the first ``number`` rows, and 0 behind them."""

    @partial(jax.jit, inline=True)
    def at(index: Any) -> Any:
        return one(*jax.tree.map(lambda leaf: leaf[index], rows))

    def add(index: Any, results: Any) -> Any:
        return jax.tree.map(lambda whole, row: whole.at[index].set(row), results, at(index))

    size, shapes = len(jax.tree.leaves(rows)[0]), jax.eval_shape(at, 0)
    empty = jax.tree.map(lambda shape: jnp.zeros((size, *shape.shape), shape.dtype), shapes)
    return jax.lax.fori_loop(0, number, add, empty)
