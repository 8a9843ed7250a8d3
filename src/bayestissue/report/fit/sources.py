"""What makes the intervals of K and C, in a table and in words."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import pandas as pd

from bayestissue.report.fit.run import FitRun
from bayestissue.report.tables import Row, Table, columns
from bayestissue.report.wording import listed, percent, relative

_LEVELS = {"impact": "impact", "typical person": "typical person", "new person": "new person"}
_LEVELS_OF_ONE_PERSON = {"impact": "impact", "typical person": "this person", "new person": "new impact"}
# In the order of the page, as the run names them and as the page does.
_NAMES = {
    "noise": "noise of the recorder",
    "velocity": "velocity at contact",
    "gain": "gain",
    "velocity and gain": "velocity at contact and gain",
    "offset": "offset of the recorder",
    "mass": "mass",
    "contact moment": "contact moment",
    "element": "element (discrepancy)",
    "element's parameters": "the element's further parameters",
    "impacts": "scatter between impacts",
    "people": "people",
    "conditions": "conditions",
    "person and condition": "rest of person and condition",
    "priors": "priors",
}
_ALL, _DRAWN = "all", "as drawn"
_WINDOW, _BY_NOISE = "window a tenth shorter", "window a tenth shorter, by noise"
# Half a 90 % interval of a normal, in its standard deviations.
_HALF = 1.645
_WORTH_NAMING = 0.1
# Below this share a part makes nothing of the interval that is worth a number.
_LEAST = 0.01
# Of the draws' variance: how far off the sum of the sources may be before the page says so.
_NEAR = (0.7, 1.4)
_QUANTITIES = ("K", "C")


def sources_table(run: FitRun) -> Table | None:
    """A row a source, columns of K and C by level: share of the variance, and half its own interval."""
    if (sources := run.interval_sources) is None:
        return None
    cells = {(row["source"], row["level"], row["quantity"]): row for row in sources.to_dict("records")}
    levels = _levels(run)
    columns_shown = [(level, q) for level in levels for q in _QUANTITIES if (_ALL, level, q) in cells]
    titles = [f"{q}, {levels[level]}" for level, q in columns_shown]
    present = set(sources["source"])
    names = _source_names(sources)
    rows = [
        Row((words, *(_cell(cells.get((name, *column))) for column in columns_shown)))
        for name, words in names.items()
        if name in present
    ]
    if "element" not in present:
        rows.append(Row((_NAMES["element"], *("taken as true" for _ in columns_shown))))
    rows.append(
        Row(("all together", *(_half_width(cells[(_ALL, *column)]["sd"]) for column in columns_shown)))
    )
    return Table(columns("source", *titles, number=titles), rows)


def _source_names(sources: pd.DataFrame) -> dict[str, str]:
    """The sources in the order of the page, further group terms as the model file has them before priors."""
    last = ("priors",)
    known = {*_NAMES, _ALL, _DRAWN, _WINDOW, _BY_NOISE}
    further = {str(name): str(name) for name in dict.fromkeys(sources["source"]) if name not in known}
    return {
        **{name: words for name, words in _NAMES.items() if name not in last},
        **further,
        **{name: _NAMES[name] for name in last},
    }


def _levels(run: FitRun) -> dict[str, str]:
    """Levels that these data tell something of, in words: of one impact, that impact alone."""
    if len(run.impacts) == 1:
        return {"impact": _LEVELS["impact"]}
    return _LEVELS_OF_ONE_PERSON if run.people == 1 else _LEVELS


def _cell(row: Mapping[Any, Any] | None) -> str:
    if row is None:
        return ""
    share = percent(max(row["share"], 0.0))
    return share if row["share"] < _LEAST else f"{share} ({_half_width(row['sd'])})"


def _half_width(sd: float) -> str:
    return relative(math.expm1(_HALF * sd))


def sources_words(run: FitRun) -> list[str]:
    """What makes most of the interval of an impact and a new person, and what the fit takes for granted."""
    if (sources := run.interval_sources) is None:
        return []
    levels = _levels(run)
    said = [
        f"Of the 90 % interval of a {words}: "
        f"{'; '.join(_largest_sources(sources, level, q) for q in _QUANTITIES)}."
        for level, words in (("impact", "recorded impact"), ("new person", levels.get("new person")))
        if words
    ]
    if "element" not in set(sources["source"]):
        said.append(
            "The element is taken as true: no part of these intervals stands for another law of the tissue."
        )
    return [*said, _window_words(sources), *_approximation_remarks(sources, levels)]


def _largest_sources(sources: pd.DataFrame, level: str, quantity: str) -> str:
    names = _source_names(sources)
    chosen = sources[
        (sources["level"] == level) & (sources["quantity"] == quantity) & sources["source"].isin(names)
    ]
    ordered = chosen.sort_values("share", ascending=False, kind="stable")
    ordered = ordered[ordered["share"] >= min(_WORTH_NAMING, ordered["share"].max())]
    named = [f"{names[row['source']]} {percent(row['share'])}" for row in ordered.to_dict("records")]
    return f"of {quantity}’s variance {listed(named)}"


def _window_words(sources: pd.DataFrame) -> str:
    cells = sources[sources["level"] == "impact"].set_index(["source", "quantity"])["sd"]
    if (_WINDOW, "K") not in cells.index:
        return "The window is taken as given."
    effects = [
        f"{q} by {relative(math.expm1(cells[_WINDOW, q]))} where noise alone makes "
        f"{relative(math.expm1(cells[_BY_NOISE, q]))}"
        for q in _QUANTITIES
    ]
    return (
        "The window is taken as given and has no part of its own. With a window a tenth shorter a trace by "
        f"itself moves {listed(effects)} (standard deviations over impacts)."
    )


def _approximation_remarks(sources: pd.DataFrame, levels: Mapping[str, str]) -> list[str]:
    drawn = sources[(sources["source"] == _DRAWN) & sources["level"].isin(levels)]
    off = drawn[~drawn["share"].between(*_NEAR)]
    doubtful = [
        f"{row['quantity']} of {levels[row['level']]} ({row['share']:.2g} times)"
        for row in off.to_dict("records")
    ]
    if not doubtful:
        return []
    return [
        "The parts are those of a normal approximation with known spreads. The variance of the draws differs "
        f"most for {listed(doubtful)}."
    ]
