"""Arrays filled up along named axes to one of a few sizes: what is compiled for one dataset serves others.

The axes are those of the annotations: ``Float[Array, "impact parameter"]`` has one of impacts. An impact that
is added repeats the first, whose numbers are as good as any, and what is found of it is cut off again. Where
numbers are summed over impacts, as those of Gaussian sites are, it must add nothing: a named tuple that is
marked by `adds_nothing` gets zeros. So does every other axis.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any, get_args, get_type_hints

import numpy as np

AXES = ("impact", "sample", "cell", "level")
Sizes = Mapping[str, int]
_Change = Callable[[Any, dict[str, int], bool], Any]
_ADD_NOTHING: set[type] = set()


@dataclass(frozen=True)
class Rows:
    """The annotation of an array of rows: one axis more, before those that that of a ``row`` names."""

    row: Any


def adds_nothing[Owner: type](owner: Owner) -> Owner:
    """Mark a named tuple in which an impact of zeros adds nothing to what is summed over impacts."""
    _ADD_NOTHING.add(owner)
    return owner


def bucket(size: int) -> int:
    """The least of a few sizes that holds ``size``: four to each power of two, at most a fourth too many."""
    step = max(1, 2 ** (int(size).bit_length() - 3))
    return step * -(-int(size) // step)


def sizes_of(values: tuple[Any, ...], annotations: tuple[Any, ...]) -> dict[str, int]:
    """How long the named axes are, by the first array that has one; 1, which broadcasts, is no size."""
    sizes: dict[str, int] = {}

    def measure(value: Any, axes: dict[str, int], _: bool) -> Any:
        for name, axis in axes.items():
            if name not in sizes and np.shape(value)[axis] > 1:
                sizes[name] = np.shape(value)[axis]
        return value

    for value, annotation in zip(values, annotations, strict=True):
        _changed(value, annotation, measure)
    return sizes


def padded(value: Any, annotation: Any, sizes: Sizes) -> Any:
    """``value`` with every axis in ``sizes``, which has that length, filled up to its `bucket`."""

    def filled(array: Any, axes: dict[str, int], empty: bool) -> Any:
        for name, axis in axes.items():
            more = bucket(sizes.get(name, 0)) - sizes.get(name, 0)
            if more and np.shape(array)[axis] == sizes[name]:
                values = np.asarray(array)
                first = np.take(values, [0] * more, axis=axis)
                nothing = empty or name != "impact"
                array = np.concatenate([values, np.zeros_like(first) if nothing else first], axis=axis)
        return array

    return _changed(value, annotation, filled)


def cut(value: Any, annotation: Any, sizes: Sizes) -> Any:
    """``value`` without what `padded` added."""

    def shorter(array: Any, axes: dict[str, int], _: bool) -> Any:
        for name, axis in axes.items():
            if name in sizes and np.shape(array)[axis] == bucket(sizes[name]) != sizes[name]:
                array = np.asarray(array)
                array = array[(slice(None),) * (axis % array.ndim) + (slice(sizes[name]),)]
        return array

    return _changed(value, annotation, shorter)


def _changed(value: Any, annotation: Any, change: _Change, empty: bool = False, before: int = 0) -> Any:
    """Every array in ``value`` that has a named axis, changed; so many axes come before the named ones."""
    if isinstance(annotation, Rows):
        return _changed(value, annotation.row, change, empty, before + 1)
    if hasattr(value, "_fields"):
        owner: Any = type(value)
        hints, empty = _hints(owner), owner in _ADD_NOTHING
        parts = zip(value._fields, value, strict=True)
        return value._replace(
            **{name: _changed(part, hints.get(name), change, empty, before) for name, part in parts}
        )
    if isinstance(value, list | tuple):
        inner = get_args(annotation) or (None, ...)
        annotations = inner if len(inner) == len(value) and inner[-1] is not ... else inner[:1] * len(value)
        pairs = zip(value, annotations, strict=True)
        return type(value)(_changed(*pair, change, empty, before) for pair in pairs)
    if isinstance(value, dict):
        inner = (get_args(annotation) or (None,))[-1]
        return {name: _changed(part, inner, change, empty, before) for name, part in value.items()}
    axes = {name: axis if axis < 0 else axis + before for name, axis in _named_axes(annotation).items()}
    return value if value is None or not axes else change(value, axes, empty)


@cache
def _hints(owner: Any) -> dict[str, Any]:
    return get_type_hints(owner)


@cache
def _named_axes(annotation: Any) -> dict[str, int]:
    """Where an array's named axes are, counted from the end behind one that stands for several."""
    named = [hint for hint in (annotation, *get_args(annotation)) if hasattr(hint, "dim_str")]
    words = named[0].dim_str.split() if named else []
    several = [position for position, word in enumerate(words) if word == "..." or word.startswith("*")]
    behind = several[0] if several else len(words)
    return {
        word.lstrip("#"): position if position < behind else position - len(words)
        for position, word in enumerate(words)
        if word.lstrip("#") in AXES
    }
