"""Levels with their intervals, one a line: people, conditions, runs, sources."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from bayestissue.figures.theme import (
    FAINT,
    POSTERIOR,
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
    tooltips,
)

ENDS = ("eti90_low", "eti50_low", "median", "eti50_high", "eti90_high")
MOST_LEVELS = 60
_SHAPES = ("circle", "square", "diamond", "triangle-up", "cross", "triangle-down", "stroke")


def quantiles(draws: np.ndarray, labels: Sequence[str]) -> pd.DataFrame:
    """Median, 50 % and 90 % interval of ``draws`` [draw, label], a row a label: `ENDS` and ``label``."""
    ends = np.percentile(draws, [5, 25, 50, 75, 95], axis=0)
    return pd.DataFrame({"label": list(labels)} | dict(zip(ENDS, ends, strict=True)))


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
    straight: bool = False,
) -> Figure:
    """A line for each ``label``, from the top in the order of ``rows``: median, 50 % and 90 % interval.

    Args:
        rows: ``label`` and `ENDS`; without the 50 % ends only the 90 % interval is drawn. Rows with a
            ``series`` share the line of their label, a colour and a mark each.
        axis: name and unit of the values.
        words: what the figure shows.
        lines: values at which a dashed line stands.
        band: shaded values, such as the typical one's interval.
        straight: never a logarithmic axis.
    """
    labels = list(dict.fromkeys(rows["label"]))
    series = list(dict.fromkeys(rows["series"])) if "series" in rows else []
    ends = rows[[end for end in ENDS if end in rows]].to_numpy().ravel()
    scale = {"zero": False} if straight else scale_over([*ends, *lines])
    details = tooltips(
        rows, label="of", series="by", median="median", eti50_low="50 % from", eti50_high="to",
        eti90_low="90 % from", eti90_high="to", rank="rank, 90 %",
    )  # fmt: skip
    line: Specification = {"y": names("label", labels), "tooltip": details}
    colour: Specification = {"value": POSTERIOR}
    shape = None
    if series:
        colour = colours(series, "series")
        shape = name("series", scale={"domain": series, "range": list(_SHAPES[: len(series)])})
        line["yOffset"] = name("series", sort=series)
    layers = []
    if band is not None:
        shaded = pd.DataFrame({"from": [band[0]], "to": [band[1]]})
        reach: Specification = {"x": number("from", axis), "x2": {"field": "to"}}
        layers.append(mark("rect", shaded, reach, color=FAINT, opacity=0.6))
    if lines:
        layers.append(level(lines, axis, "x"))
    for percent, size in ((90, 1.4), (50, 4)):
        if f"eti{percent}_low" in rows:
            reach = {
                "x": number(f"eti{percent}_low", axis, scale=scale),
                "x2": {"field": f"eti{percent}_high"},
            }
            layers.append(mark("rule", rows, {**line, **reach, "color": colour}, strokeWidth=size))
    points = {**line, "x": number("median", axis), "stroke": colour, "shape": shape}
    layers.append(mark("point", rows, points, fill="white", size=45, strokeWidth=1.6, opacity=1))
    step = 12 * len(series) + 8 if series else 22
    return Figure(layered(layers, step * max(len(labels), 1)), words, rows)
