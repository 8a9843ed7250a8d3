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

from bayestissue.padding import Rows, cut, padded, sizes_of

Function = Callable[..., Any]
Static = str | Sequence[str]
# XLA spends most of a compilation on making the result fast. Level 1 compiles in a fifth less time and its
# steps are as fast, but those of slopes were measured to take up to four times as long.
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


def compiled(static_argnames: Static = ()) -> Callable[[Function], Function]:
    """`jax.jit` for what runs long; otherwise as `compiled_quickly`."""
    return lambda function: _for_few_shapes(function, static_argnames, FULLY)


def by_row(
    size: int, *, constant: int, static_argnames: Static = (), options: dict[str, Any] = _SOONER
) -> Callable[[Function], Function]:
    """Makes a function of one row one of any number of rows along first axes, its results numpy arrays.

    ``size`` rows go into one compiled call, which makes as many of them as there are: one compilation serves
    any number. Otherwise as `compiled_quickly`.

    Args:
        size: about as many rows as are often asked for at once.
        constant: how many arguments come before the row's, the same for all rows.
        static_argnames: as of `jax.jit`, among these.
        options: of the compiler.
    """

    def decorated(function: Function) -> Function:
        @wraps(function)
        def first(*arguments: Any) -> Any:
            same, rows, number = arguments[:constant], arguments[constant:-1], arguments[-1]
            return _first_rows(lambda *row: function(*same, *row), rows, number)

        call = _for_few_shapes(first, static_argnames, options, constant)

        @wraps(function)
        def called(*arguments: Any) -> Any:
            def of_rows(*rows: Any) -> Any:
                number = len(jax.tree.leaves(rows)[0])
                places = np.minimum(np.arange(size), number - 1)
                results = call(*arguments[:constant], *jax.tree.map(lambda leaf: leaf[places], rows), number)
                return jax.tree.map(lambda leaf: leaf[:number], results)

            return in_parts(of_rows, arguments[constant:], size)

        called.jitted = call.jitted  # type: ignore[attr-defined]
        return called

    return decorated


def in_parts(function: Function, rows: Any, size: int) -> Any:
    """``function(*rows)`` of at most ``size`` rows at a time, as numpy arrays."""
    rows = jax.tree.map(np.asarray, rows)
    begins = range(0, len(jax.tree.leaves(rows)[0]), size)
    parts = [function(*jax.tree.map(lambda leaf: leaf[begin : begin + size], rows)) for begin in begins]  # noqa: B023
    return jax.tree.map(lambda *leaves: np.concatenate(leaves), *parts)


def _first_rows(one: Function, rows: Any, number: Any) -> Any:
    """``one(*row)`` of the first ``number`` rows, and 0 behind them."""

    def at(index: Any) -> Any:
        return one(*jax.tree.map(lambda leaf: leaf[index], rows))

    def add(index: Any, results: Any) -> Any:
        return jax.tree.map(lambda whole, row: whole.at[index].set(row), results, at(index))

    size, shapes = len(jax.tree.leaves(rows)[0]), jax.eval_shape(at, 0)
    empty = jax.tree.map(lambda shape: jnp.zeros((size, *shape.shape), shape.dtype), shapes)
    return jax.lax.fori_loop(0, number, add, empty)


def _for_few_shapes(
    function: Function, static_argnames: Static, options: dict[str, Any], constant: int | None = None
) -> Function:
    """`jax.jit` of filled up arguments, those behind the first ``constant`` being rows and their number."""
    jitted = jax.jit(function, static_argnames=static_argnames, compiler_options=options)

    @lru_cache(maxsize=1)
    def annotations() -> tuple[tuple[Any, ...], Any]:
        # Only when it is called is everything defined that the annotations name.
        hints = get_type_hints(function)
        hints_of_arguments, returned = (
            tuple(hints.get(name) for name in signature(function).parameters),
            hints.get("return"),
        )
        if constant is None:
            return hints_of_arguments, returned
        return (*hints_of_arguments[:constant], *map(Rows, hints_of_arguments[constant:]), None), Rows(
            returned
        )

    @wraps(function)
    def called(*arguments: Any) -> Any:
        hints_of_arguments, returned = annotations()
        hints_of_arguments = hints_of_arguments[: len(arguments)]
        sizes = sizes_of(arguments, hints_of_arguments)
        if not sizes:
            return jitted(*arguments)
        pairs = zip(arguments, hints_of_arguments, strict=True)
        return cut(jitted(*(_filled(*pair, sizes) for pair in pairs)), returned, sizes)

    called.jitted = jitted  # type: ignore[attr-defined]
    return called


def filled_up(value: Any) -> Any:
    """A tuple of named tuples filled up along the axes that their annotations name, for `run_chains`."""
    sizes = sizes_of(value, (None,) * len(value))
    return tuple(_filled(part, None, sizes) for part in value)


def _filled(value: Any, annotation: Any, sizes: dict[str, int]) -> Any:
    if not hasattr(value, "_fields") or isinstance(annotation, Rows):
        return padded(value, annotation, sizes)
    return _filled_once(_Same(value), tuple(sizes.items()))


class _Same:
    """A key that is equal to that of the same object only, which it keeps."""

    def __init__(self, value: Any) -> None:
        self.value = value

    def __hash__(self) -> int:
        return id(self.value)

    def __eq__(self, value: object) -> bool:
        return isinstance(value, _Same) and self.value is value.value


@lru_cache(maxsize=8)
def _filled_once(same: _Same, sizes: tuple[tuple[str, int], ...]) -> Any:
    """A dataset is asked for hundreds of times."""
    return jax.device_put(padded(same.value, None, dict(sizes)))
