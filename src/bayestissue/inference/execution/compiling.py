"""How functions are compiled: for few shapes, and as well as they are worth.

All that knows about compilation is here. What is compiled is written as if it were not: its arguments are
filled up to a few sizes (`bayestissue.padding`), and its results cut, so that tomorrow's dataset finds
compiled what today's needed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache, wraps
from inspect import signature
from typing import Any, get_type_hints

import jax
import jax.numpy as jnp
import numpy as np

from bayestissue.padding import cut, padded, sizes_of

Function = Callable[..., Any]
Static = str | Sequence[str]
# XLA spends most of a compilation on making the result fast.
_QUICKLY, _SOONER = {"xla_backend_optimization_level": 0}, {"xla_backend_optimization_level": 1}
# XLA's own level, for what runs thousands of times, whatever XLA_FLAGS say.
FULLY = {"xla_backend_optimization_level": 3}


def compiled_quickly(static_argnames: Static = ()) -> Callable[[Function], Function]:
    """`jax.jit` for what takes longer to compile than to run: half the wait, and slower steps.

    Arguments are filled up along the axes that the annotations name, and the result is cut.

    Not to be called from within another compiled function, which has options of its own.

    Args:
        static_argnames: as of `jax.jit`.
    """
    return lambda function: _for_few_shapes(function, static_argnames, _QUICKLY)


def compiled_sooner(static_argnames: Static = ()) -> Callable[[Function], Function]:
    """`jax.jit` for what runs about as long as it compiles: a fifth less wait, and steps as fast.

    Not for slopes, which were measured to take up to four times as long; otherwise as `compiled_quickly`.
    """
    return lambda function: _for_few_shapes(function, static_argnames, _SOONER)


def compiled(static_argnames: Static = ()) -> Callable[[Function], Function]:
    """`jax.jit` for what runs long; otherwise as `compiled_quickly`."""
    return lambda function: _for_few_shapes(function, static_argnames, FULLY)


def _for_few_shapes(function: Function, static_argnames: Static, options: dict[str, Any]) -> Function:
    jitted = jax.jit(function, static_argnames=static_argnames, compiler_options=options)

    @lru_cache(maxsize=1)
    def annotations() -> tuple[tuple[Any, ...], Any]:
        # Only when it is called is everything defined that the annotations name.
        hints = get_type_hints(function)
        return tuple(hints.get(name) for name in signature(function).parameters), hints.get("return")

    @wraps(function)
    def called(*arguments: Any) -> Any:
        given, returned = annotations()
        given = given[: len(arguments)]
        sizes = sizes_of(arguments, given)
        if not sizes:
            return jitted(*arguments)
        pairs = zip(arguments, given, strict=True)
        return cut(jitted(*(_filled(*pair, sizes) for pair in pairs)), returned, sizes)

    called.jitted = jitted  # type: ignore[attr-defined]
    return called


def filled_up(value: Any) -> Any:
    """A tuple of named tuples filled up along the axes that their annotations name, for `run_chains`."""
    sizes = sizes_of(value, (None,) * len(value))
    return tuple(_filled(part, None, sizes) for part in value)


def _filled(value: Any, annotation: Any, sizes: dict[str, int]) -> Any:
    if not hasattr(value, "_fields"):
        return padded(value, annotation, sizes)
    return _filled_once(_Same(value), tuple(sizes.items()))


class _Same:
    """A key that is equal to that of the same object only, which it keeps."""

    def __init__(self, value: Any) -> None:
        self.value = value

    def __hash__(self) -> int:
        return id(self.value)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Same) and self.value is other.value


@lru_cache(maxsize=8)
def _filled_once(same: _Same, sizes: tuple[tuple[str, int], ...]) -> Any:
    """A dataset is asked for hundreds of times."""
    return jax.device_put(padded(same.value, None, dict(sizes)))


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
