"""Levels with their intervals, one a line: people, conditions, runs, sources."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from bayestissue.reports.figures.theme import (
    FAINT,
    POSTERIOR,
    RECORDED,
    Figure,
    Specification,
    colours,
    layered,
    level,
    mark,
    name,
    names,
    number,
    scale_over,
    shapes,
    tooltips,
)

ENDS = ("eti90_low", "eti50_low", "median", "eti50_high", "eti90_high")
MOST_LEVELS = 60
# Intervals by the stem of their columns: what they hold, and how thick they are.
_REACH = {"eti90": ("90 %", 1.4), "eti50": ("50 %", 4.0), "se": ("standard error", 1.4)}


def quantiles(draws: np.ndarray, labels: Sequence[str]) -> pd.DataFrame:
    """Median, 50 % and 90 % interval of ``draws`` [draw, label], a row a label: `ENDS` and ``label``."""
    ends = np.percentile(draws, [5, 25, 50, 75, 95], axis=0)
    return pd.DataFrame({"label": list(labels)} | dict(zip(ENDS, ends, strict=True)))


def with_error_of(labels: pd.Series, values: pd.Series, errors: pd.Series) -> pd.DataFrame:
    """Values with their standard errors, as `intervals` draws them."""
    return pd.DataFrame(
        {"label": labels, "value": values, "se_low": values - errors, "se_high": values + errors}
    )


def with_ranks(draws: np.ndarray, labels: Sequence[str]) -> pd.DataFrame:
    """`quantiles` with the greatest first, and the 90 % interval of each ``rank``, 1 for the greatest.

    Of more than `MOST_LEVELS` the greatest and the least.
    """
    rows = quantiles(draws, labels)
    ranks = 1 + np.argsort(np.argsort(-draws, axis=1), axis=1)
    low, high = np.percentile(ranks, [5, 95], axis=0).round().astype(int)
    rows["rank"] = [f"{a}" if a == b else f"{a} to {b}" for a, b in zip(low, high, strict=True)]
    rows = rows.sort_values("median", ascending=False, kind="stable", ignore_index=True)
    half = MOST_LEVELS // 2
    return rows if len(rows) <= MOST_LEVELS else pd.concat([rows[:half], rows[-half:]], ignore_index=True)


def intervals(
    rows: pd.DataFrame,
    axis: str,
    words: str,
    *,
    lines: Sequence[float] = (),
    band: tuple[float, float] | None = None,
    points: pd.DataFrame | None = None,
    straight: bool = False,
    domain: tuple[float, float] | None = None,
) -> Figure:
    """A line for each ``label``, from the top in the order of ``rows``: a value and its intervals.

    Args:
        rows: ``label``; ``median`` with the ends of the 90 % interval and perhaps of the 50 % interval, by
            the names in `ENDS`, or ``value``, perhaps with ``se_low`` and ``se_high``, a standard error less
            and more. Rows with a ``series`` share the line of their label, a colour and a mark each.
        axis: name and unit of the values.
        words: what the figure shows.
        lines: values at which a dashed line stands.
        band: shaded values, such as the typical one's interval.
        points: further values of a ``label``, each a ``value``; an ``offset`` moves it off the line.
        straight: never a logarithmic axis.
        domain: the axis's ends.
    """
    labels = list(dict.fromkeys(rows["label"]))
    series = list(dict.fromkeys(rows["series"])) if "series" in rows else []
    middle = "median" if "median" in rows else "value"
    reached = {stem: reach for stem, reach in _REACH.items() if f"{stem}_low" in rows}
    ends = {f"{stem}_{end}": words for stem, (words, _) in reached.items() for end in ("low", "high")}
    further = [] if points is None else list(points["value"])
    values = [*rows[[middle, *ends]].to_numpy().ravel(), *lines, *further]
    scale = {"zero": False} if straight else scale_over(values)
    scale |= {} if domain is None else {"domain": domain}
    titles = {end: f"{words} from" if end.endswith("low") else "to" for end, words in ends.items()}
    details = tooltips(rows, label="of", series="by", **{middle: middle}, **titles, rank="rank, 90 %")
    line: Specification = {"y": names("label", labels), "tooltip": details}
    colour: Specification = {"value": POSTERIOR}
    shape = None
    if series:
        colour, shape = colours(series, "series"), shapes(series, "series")
        line["yOffset"] = name("series", sort=series)
    layers = []
    if band is not None:
        shaded = pd.DataFrame({"from": [band[0]], "to": [band[1]]})
        reach: Specification = {"x": number("from", axis), "x2": {"field": "to"}}
        layers.append(mark("rect", shaded, reach, color=FAINT, opacity=0.6))
    if lines:
        layers.append(level(lines, axis, "x"))
    for stem, (_, size) in reached.items():
        reach = {"x": number(f"{stem}_low", axis, scale=scale), "x2": {"field": f"{stem}_high"}}
        layers.append(mark("rule", rows, {**line, **reach, "color": colour}, strokeWidth=size))
    centre = {**line, "x": number(middle, axis, scale=scale), "stroke": colour, "shape": shape}
    layers.append(mark("point", rows, centre, fill="white", size=45, strokeWidth=1.6, opacity=1))
    if points is not None:
        offset = number("offset", scale={"domain": [-1, 1]}) if "offset" in points else None
        single = {"x": number("value", axis, scale=scale), "y": line["y"], "yOffset": offset}
        single["tooltip"] = tooltips(points, impact="impact", person="person", label="of", value="value")
        layers.append(mark("point", points, single, shape="diamond", color=RECORDED, size=26, filled=True))
    step = 12 * len(series) + 8 if series else 22
    return Figure(layered(layers, step * max(len(labels), 1)), words, rows)
