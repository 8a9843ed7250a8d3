"""What a study compares: the sides of each person, repeats, methods, exponents."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from bayestissue.figures.theme import (
    DASHED,
    FAINT,
    HEIGHT,
    MUTED,
    POSTERIOR,
    RECORDED,
    Figure,
    Specification,
    layered,
    level,
    mark,
    name,
    names,
    number,
    scale_over,
    tooltips,
    where,
)


def paired(rows: pd.DataFrame, means: pd.DataFrame, factor: str, axis: str, words: str) -> Figure:
    """A line for each person from level to level, such as from left to right; beside them the levels' means.

    Args:
        rows: ``person``, ``level``, ``median`` and, where known, ``eti90_low`` and ``eti90_high``.
        means: ``level``, ``median`` and the ends of its 90 % interval, NaN where not known.
        factor: what the levels are of, such as "side".
        axis: name and unit of the values.
        words: what the figure shows.
    """
    levels = list(dict.fromkeys(means["level"]))
    values = [*rows["median"], *means[["median", "eti90_low", "eti90_high"]].to_numpy().ravel()]
    x = name(
        "level", sort=levels, axis={"labelAngle": 0, "grid": False}, scale={"type": "point", "padding": 0.6}
    )
    x["title"] = factor
    y = number("median", axis, scale=scale_over(values))
    details = tooltips(
        rows, person="person", level=factor, median="median", eti90_low="90 % from", eti90_high="to"
    )
    hovered: Specification = {
        "name": "hovered",
        "select": {"type": "point", "fields": ["person"], "on": "pointerover", "clear": "pointerout"},
    }
    strong: Specification = {"condition": {"param": "hovered", "value": 1}, "value": 0.15}
    line = {"x": x, "y": y, "detail": {"field": "person"}, "opacity": strong, "tooltip": details}
    mean = {"x": x, "xOffset": {"value": 22}}
    mean_details = tooltips(means, level=factor, median="mean", eti90_low="90 % from", eti90_high="to")
    reach = {**mean, "y": number("eti90_low", axis), "y2": {"field": "eti90_high"}}
    layers = [
        mark("line", rows, line, color=MUTED, strokeWidth=1.6) | {"params": [hovered]},
        mark("point", rows, line, color=MUTED, size=45),
        mark("rule", means.dropna(subset="eti90_low"), reach, color=POSTERIOR, strokeWidth=2),
        mark(
            "point",
            means,
            {**mean, "y": y, "tooltip": mean_details},
            color=POSTERIOR,
            shape="diamond",
            size=150,
            opacity=1,
        ),
    ]
    return Figure(layered(layers, HEIGHT, max(150 * len(levels), 300)), words, rows)


def limits_of_agreement(ratio: pd.Series) -> tuple[float, float, float]:
    """Mean ratio and the 95 % limits that hold single ratios (Bland and Altman 1999), by their logs."""
    logs = np.log(ratio[ratio > 0].dropna().to_numpy(float))
    if logs.size < 2:
        return (float(np.exp(logs.mean())) if logs.size else np.nan, np.nan, np.nan)
    half = 1.96 * logs.std(ddof=1)
    low, middle, high = np.exp(logs.mean() + half * np.array([-1.0, 0.0, 1.0]))
    return float(middle), float(low), float(high)


def agreement(rows: pd.DataFrame, axis: str, ratio_title: str, words: str) -> Figure:
    """Two measurements of the same: their ratio over their geometric mean, as Bland and Altman plot them.

    Args:
        rows: ``mean`` and ``ratio``, with names such as ``impact``, ``person`` or ``pair``.
        axis: name and unit of the mean.
        ratio_title: what is over what.
        words: what the figure shows.
    """
    middle, *limits = limits_of_agreement(rows["ratio"])
    rows = rows[rows["ratio"] > 0].reset_index(drop=True)
    lines = pd.DataFrame(
        {"at": [middle, *limits], "line": ["mean ratio", "95 % limit", "95 % limit"]}
    ).dropna()
    lines["text"] = [f"{value:.3g}" for value in lines["at"]]
    at = number("at", ratio_title)
    dash = where("datum.line == 'mean ratio'", [1, 0], {"value": DASHED})
    named = {"x": {"value": {"expr": "width"}}, "y": at, "text": {"field": "text"}}
    points = {
        "x": number("mean", axis, scale=scale_over(rows["mean"])),
        "y": number("ratio", ratio_title, scale=scale_over([*rows["ratio"], *lines["at"], 1.0])),
        "tooltip": tooltips(rows, impact="impact", person="person", pair="pair", ratio="ratio", mean="mean"),
    }
    layers = [
        level([1.0], ratio_title, strokeDash=[1, 0], strokeWidth=0.8),
        mark("rule", lines, {"y": at, "strokeDash": dash}, color=RECORDED, strokeWidth=1.4),
        mark("text", lines, named, align="right", baseline="bottom", dy=-2, color=RECORDED),
        mark("point", rows, points, color=POSTERIOR, filled=False, size=34),
    ]
    return Figure(layered(layers, 260), words, rows)


def histogram(
    draws: np.ndarray,
    axis: str,
    words: str,
    *,
    lines: Sequence[float] = (),
    regions: Sequence[tuple[float, float]] = (),
) -> Figure:
    """How the ``draws`` [draw] lie; dashed ``lines``, and shaded ``regions`` that count as equal to them."""
    bins = min(60, max(15, int(np.sqrt(draws.size))))
    density, edges = np.histogram(draws, bins=bins, density=True)
    rows = pd.DataFrame({"from": edges[:-1], "to": edges[1:], "density": density})
    reach = {"x": number("from", axis, scale={"zero": False, "nice": False}), "x2": {"field": "to"}}
    bars = {**reach, "y": number("density", None, axis=None), "y2": {"datum": 0}}
    layers = [
        mark("rect", pd.DataFrame(regions, columns=["from", "to"]), reach, color=FAINT, opacity=0.7),
        mark(
            "rect", rows, {**bars, "tooltip": tooltips(rows, **{"from": "from", "to": "to"})}, color=POSTERIOR
        ),
        level(lines, axis, "x"),
    ]
    return Figure(layered(layers, 170), words, rows)


def off_best(rows: pd.DataFrame, axis: str, words: str) -> Figure:
    """How far each ``label``'s ``value`` is off the best, which is 0, with its standard ``error``."""
    ends = rows.assign(low=rows["value"] - rows["error"], high=rows["value"] + rows["error"])
    details = tooltips(ends, label="run", value="value", error="standard error")
    line = {"y": names("label", list(rows["label"])), "tooltip": details}
    layers = [
        level([0.0], axis, "x"),
        mark("rule", ends, {**line, "x": number("low", axis), "x2": {"field": "high"}}, color=POSTERIOR),
        mark("point", ends, {**line, "x": number("value", axis)}, color=POSTERIOR, size=55),
    ]
    return Figure(layered(layers, 24 * len(rows)), words, rows)
