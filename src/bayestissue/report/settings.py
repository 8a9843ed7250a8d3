"""Settings, nested as a model file nests them, as one flat table."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from typing import Any

from bayestissue.report.tables import Row, Table, columns


def settings_table(content: Mapping[str, Any], told_elsewhere: Collection[str] = ()) -> Table:
    """Every key of ``content`` and its value, one a row; inner tables' keys are joined with a dot.

    The top-level keys in ``told_elsewhere`` are left out.
    """
    rest = {key: value for key, value in content.items() if key not in told_elsewhere}
    return Table(columns("setting", "value", words=("value",)), [Row(pair) for pair in _flat(rest)])


def _flat(content: Mapping[str, Any], above: str = "") -> Iterator[tuple[str, str]]:
    for key, value in content.items():
        name = f"{above}{key}"
        if isinstance(value, Mapping):
            yield from _flat(value, f"{name}.")
        else:
            yield name, plain(value)


def plain(value: Any) -> str:
    """One value of a TOML or JSON file as a reader would write it."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:g}".replace("-", "−")
    if isinstance(value, list):
        return ", ".join(plain(item) for item in value)
    return "not set" if value is None else str(value)
