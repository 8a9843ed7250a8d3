"""Simulation files that lie in tables beside the scripts, and what a script changes of them."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from bayestissue.studies.simulation import Simulation


def tables(script: str) -> dict[str, Any]:
    """The TOML file beside a script, of the script's name."""
    return tomllib.loads(Path(script).with_suffix(".toml").read_text(encoding="utf-8"))


def simulation(*contents: Mapping[str, Any], **more: Any) -> Simulation:
    """The simulation file of some tables, each of which changes those before it, at any depth.

    A condition may be written as trial, mass [kg] and velocity [m/s]; ``spreads`` are standard deviations of
    log K and of log C by group.
    """
    from bayestissue.studies.simulation import Simulation

    content: dict[str, Any] = {}
    for table in (*contents, more):
        content = merged(content, table)
    design, names = content["design"], ("trial", "mass_kg", "velocity_m_s")
    design["conditions"] = [
        each if isinstance(each, Mapping) else dict(zip(names, each, strict=True))
        for each in design["conditions"]
    ]
    for group, sd in content.pop("spreads", {}).items():
        content["tissue"] |= by_response(**{f"sd_{group}": (sd, sd)})
    return Simulation.model_validate(content)


def merged(content: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """A table with changes; a table within it is changed, anything else is replaced."""
    return {**content} | {
        key: merged(content.get(key, {}), value) if isinstance(value, Mapping) else value
        for key, value in changes.items()
    }


def by_response(**pairs: Sequence[float]) -> dict[str, float]:
    """Values of K and of C under names that end so."""
    return {
        f"{name}_{q}": float(value)
        for name, pair in pairs.items()
        for q, value in zip("KC", pair, strict=True)
    }
