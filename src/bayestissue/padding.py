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
    """The annotation of rows along one axis more, before those that the annotation of each names."""

    of_each: Any


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
    found: dict[str, int] = {}

    def seen(value: Any, places: dict[str, int], _: bool) -> Any:
        for name, place in places.items():
            if name not in found and np.shape(value)[place] > 1:
                found[name] = np.shape(value)[place]
        return value

    for value, annotation in zip(values, annotations, strict=True):
        _changed(value, annotation, seen)
    return found


def padded(value: Any, annotation: Any, sizes: Sizes) -> Any:
    """``value`` with every axis in ``sizes``, which has that length, filled up to its `bucket`."""

    def filled(array: Any, places: dict[str, int], empty: bool) -> Any:
        for name, place in places.items():
            more = bucket(sizes.get(name, 0)) - sizes.get(name, 0)
            if more and np.shape(array)[place] == sizes[name]:
                own = np.asarray(array)
                first = np.take(own, [0] * more, axis=place)
                nothing = empty or name != "impact"
                array = np.concatenate([own, np.zeros_like(first) if nothing else first], axis=place)
        return array

    return _changed(value, annotation, filled)


def cut(value: Any, annotation: Any, sizes: Sizes) -> Any:
    """``value`` without what `padded` added."""

    def shorter(array: Any, places: dict[str, int], _: bool) -> Any:
        for name, place in places.items():
            if name in sizes and np.shape(array)[place] == bucket(sizes[name]) != sizes[name]:
                array = np.asarray(array)
                array = array[(slice(None),) * (place % array.ndim) + (slice(sizes[name]),)]
        return array

    return _changed(value, annotation, shorter)


def _changed(value: Any, annotation: Any, change: _Change, empty: bool = False, before: int = 0) -> Any:
    """Every array in ``value`` that has a named axis, changed; so many axes come before the named ones."""
    if isinstance(annotation, Rows):
        return _changed(value, annotation.of_each, change, empty, before + 1)
    if hasattr(value, "_fields"):
        owner: Any = type(value)
        hints, empty = _hints(owner), owner in _ADD_NOTHING
        parts = zip(value._fields, value, strict=True)
        return value._replace(
            **{name: _changed(part, hints.get(name), change, empty, before) for name, part in parts}
        )
    if isinstance(value, list | tuple):
        own = get_args(annotation) or (None, ...)
        each = own if len(own) == len(value) and own[-1] is not ... else own[:1] * len(value)
        return type(value)(_changed(*pair, change, empty, before) for pair in zip(value, each, strict=True))
    if isinstance(value, dict):
        own = (get_args(annotation) or (None,))[-1]
        return {name: _changed(part, own, change, empty, before) for name, part in value.items()}
    places = {name: place if place < 0 else place + before for name, place in _places(annotation).items()}
    return value if value is None or not places else change(value, places, empty)


@cache
def _hints(owner: Any) -> dict[str, Any]:
    return get_type_hints(owner)


@cache
def _places(annotation: Any) -> dict[str, int]:
    """Where an array's named axes are, counted from the end behind one that stands for several."""
    named = [each for each in (annotation, *get_args(annotation)) if hasattr(each, "dim_str")]
    words = named[0].dim_str.split() if named else []
    several = [place for place, word in enumerate(words) if word == "..." or word.startswith("*")]
    behind = several[0] if several else len(words)
    return {
        word.lstrip("#"): place if place < behind else place - len(words)
        for place, word in enumerate(words)
        if word.lstrip("#") in AXES
    }
