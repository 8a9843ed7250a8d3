"""What an impact comes to: the one table of outcomes, with unit, meaning and columns of each.

``outcomes.toml`` declares them; variables, tables, pages and the manual are made of it.
"""

from __future__ import annotations

from typing import NamedTuple

from bayestissue.base.declarations import declared


class Outcome(NamedTuple):
    """What is said of an outcome beside its number: an entry of ``outcomes.toml``."""

    unit: str
    meaning: str
    column: str
    shown: tuple[str, str, float]
    formula: str
    source: str
    measured: bool = False
    compared: bool = False
    headform: bool = False
    never: str = ""
    first: int = 0


DECLARED = {name: Outcome(**entry) for name, entry in declared(__package__, "outcomes.toml").items()}
# What a lab asks of a headform's impact, and of any.
HEADFORM_OUTCOMES = tuple(DECLARED)
OUTCOMES = tuple(name for name, one in DECLARED.items() if not one.headform)
MEASURED, REFERENCE_OUTCOMES, NEVER = (
    tuple(name for name, one in DECLARED.items() if getattr(one, mark))
    for mark in ("measured", "compared", "never")
)
# In tables of impacts: first those that a console has room for.
_FIRST = sorted(DECLARED, key=lambda name: DECLARED[name].first or len(DECLARED))
HEADFORM_COLUMNS = {name: DECLARED[name].column for name in _FIRST}
OUTCOME_COLUMNS = {name: column for name, column in HEADFORM_COLUMNS.items() if name in OUTCOMES}


def _interval_column(name: str, which: str) -> str:
    """The unit last: "peak_force_N", "peak_force_low_N", "restitution"."""
    unit = DECLARED[name].unit.replace("/", "_").replace(" ", "_").replace("^", "")
    # `time_to_peak_s` is the recorded one.
    which = "" if which == "median" and name != "time_to_peak" else which
    return "_".join(part for part in (name, which, unit) if part not in ("", "1"))


# In ``estimates.csv``: which number of the posterior of which outcome a column has.
INTERVAL_COLUMNS = {
    _interval_column(name, which): (name, which)
    for name in HEADFORM_OUTCOMES
    for which in ("median", "low", "high")
} | {f"{name}_never": (name, "never") for name in NEVER}

_MEANINGS = {
    "median": "{one.meaning}: posterior median",
    "low": "lower end of its 90 % interval",
    "high": "upper end",
    "never": "probability {one.never}",
}
# What each of these columns means.
INTERVAL_MEANINGS = {
    column: _MEANINGS[which].format(one=DECLARED[name]) for column, (name, which) in INTERVAL_COLUMNS.items()
}
