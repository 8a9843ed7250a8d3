"""Whatever dataset.toml may say, a dataset that is written is read back saying the same."""

from __future__ import annotations

import string
import tempfile
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

import pytest
from annotated_types import Ge, Gt, Le, MaxLen
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st
from pydantic import BaseModel
from pydantic.fields import FieldInfo

import bayestissue as bt
from bayestissue.base.errors import InputError
from bayestissue.base.literature import SITES
from bayestissue.base.settings import kinds, parse_toml
from bayestissue.recordings.dataset.dataset_file import PLACES, Settings, SignalSettings, parse_settings
from bayestissue.recordings.dataset.write import settings_text
from dataset_bench import tables

# Free text is any that a file can hold; TOML has no lone halves of characters.
TEXT = st.text(st.characters(exclude_categories=["Cs", "Cc"]), max_size=12)
UNITS = {"deceleration": ["m/s^2", "g", "mm/s^2"], "acceleration": ["g_0"], "displacement": ["mm", "µm"]}
# What a type and its bounds do not say of a value.
KNOWN: dict[str, st.SearchStrategy[Any]] = {
    "signal.time_unit": st.sampled_from(["s", "ms", "µs"]),
    "signal.scale": st.floats(0.1, 10.0),
    "signal.gravity": st.sampled_from(["none", "drop", -1.5, 0.0, 9.8]),
    "signal.crop": st.tuples(st.floats(-1.0, 0.0), st.floats(1.0, 2.0)),
    "site": st.sampled_from(["", *SITES]),
    "channel.unit": st.sampled_from(["N", "kN"]),
    "channel.file": st.sampled_from(["force.csv", "other.csv.gz"]),
}


def value(field: FieldInfo, place: str) -> st.SearchStrategy[Any]:
    """Any value that a key may have, by its type and bounds."""
    if place in KNOWN:
        return KNOWN[place]
    metadata = [*field.metadata]
    for one in get_args(field.annotation):
        metadata += [bound for part in get_args(one) for bound in getattr(part, "metadata", [])]
    bounds = {type(bound): bound for bound in metadata}
    low = bounds[Ge].ge if Ge in bounds else bounds[Gt].gt + 1e-3 if Gt in bounds else -1e6
    high = bounds[Le].le if Le in bounds else 0.49 if place.endswith("_sd") else 1e6
    return st.one_of([of_kind(kind, place, low, high, MaxLen in bounds) for kind in kinds(field.annotation)])


def of_kind(kind: Any, place: str, low: float, high: float, short: bool) -> st.SearchStrategy[Any]:
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        return table(kind, place)
    if get_origin(kind) is Literal:
        return st.sampled_from(get_args(kind))
    if get_origin(kind) is tuple:
        return st.lists(table(get_args(kind)[0], place), max_size=1)
    plain = {float: st.floats(low, high, allow_subnormal=False), bool: st.booleans()}
    noun = st.text(string.ascii_letters, min_size=1, max_size=9)
    named = place.partition(".")[2] or place == "name"
    return (plain | {int: st.integers(int(low), int(high)), str: noun if short or named else TEXT})[kind]


def table(schema: type[BaseModel], place: str = "") -> st.SearchStrategy[dict[str, Any]]:
    """Some of the keys of a table, and all that it needs."""
    fields = {key: (f"{place}.{key}".lstrip("."), field) for key, field in schema.model_fields.items()}
    drawn = {key: value(field, where) for key, (where, field) in fields.items()}
    needed = {key: one for key, one in drawn.items() if schema.model_fields[key].is_required()}
    return st.fixed_dictionaries(needed, optional={key: drawn[key] for key in drawn if key not in needed})


def drawn_settings() -> st.SearchStrategy[dict[str, Any]]:
    def with_unit(content: dict[str, Any]) -> st.SearchStrategy[dict[str, Any]]:
        units = st.sampled_from(UNITS[content["signal"]["quantity"]])
        return units.map(lambda unit: content | {"signal": content["signal"] | {"unit": unit}})

    return table(Settings).flatmap(with_unit)


def accepted(content: dict[str, Any]) -> Settings:
    try:
        return parse_settings(content)
    except InputError:
        # What keys contradict one another in has tests of its own.
        assume(False)
        raise


def is_read_back(content: dict[str, Any]) -> None:
    stated = accepted(content)
    text = settings_text(stated.stated())
    assert parse_settings(parse_toml(text, "dataset.toml"), text) == stated
    assert stated.in_si().in_si() == stated.in_si()


FEW = settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))
MANY = settings(FEW, max_examples=10_000)
test_what_is_stated_is_read_back = FEW(given(drawn_settings())(is_read_back))
test_what_is_stated_is_read_back_of_many = pytest.mark.long(MANY(given(drawn_settings())(is_read_back)))


def dataset_is_read_back(content: dict[str, Any]) -> None:
    """Of recordings in SI units: with units and scales of any kind they are no impacts."""
    kept = {"quantity": "deceleration", "unit": "m/s^2", "gravity": "none"}
    stated = accepted(
        content | {"signal": {**kept, "contact": content["signal"].get("contact")}, "channel": []}
    )
    arguments = {
        name: getattr(getattr(stated, place.split(".")[0]), name) if "." in place else getattr(stated, name)
        for name, place in PLACES.items()
        if name not in SignalSettings.model_fields
    }
    try:
        data = bt.dataset(*tables(), **kept, contact=stated.signal.contact, **arguments)
    except InputError:
        # Errors that are greater than what was recorded.
        assume(False)
    with tempfile.TemporaryDirectory() as folder:
        again = bt.read_dataset(data.write(Path(folder) / "written"))
    assert again.settings == data.settings
    assert again.settings.stated() == data.settings.stated()


test_a_dataset_is_read_back = settings(FEW, max_examples=10)(given(drawn_settings())(dataset_is_read_back))
test_a_dataset_is_read_back_of_many = pytest.mark.long(
    settings(FEW, max_examples=1000)(given(drawn_settings())(dataset_is_read_back))
)
