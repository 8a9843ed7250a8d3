"""What a study compares: the sides of each person, repeats, methods, exponents, designs."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from bayestissue.reports.figures.theme import (
    DASHED,
    DOTTED,
    FAINT,
    HEIGHT,
    INK,
    MUTED,
    POSTERIOR,
    RECORDED,
    SOLID,
    THEME,
    Figure,
    Specification,
    colours,
    layered,
    level,
    mark,
    name,
    number,
    scale_over,
    shapes,
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
    strong: Specification = {"condition": {"param": "hovered", "value": 1}, "value": 0.15}
    line = {"x": x, "y": y, "detail": {"field": "person"}, "opacity": strong, "tooltip": details}
    mean = {"x": x, "xOffset": {"value": 22}}
    reach = {**mean, "y": number("eti90_low", axis), "y2": {"field": "eti90_high"}}
    mean_details = tooltips(means, level=factor, median="mean", eti90_low="90 % from", eti90_high="to")
    middle = {**mean, "y": y, "tooltip": mean_details}
    layers = [
        mark("line", rows, line, color=MUTED, strokeWidth=1.6) | {"params": [THEME["hovered"]]},
        mark("point", rows, line, color=MUTED, size=45),
        mark("rule", means.dropna(subset="eti90_low"), reach, color=POSTERIOR, strokeWidth=2),
        mark("point", means, middle, color=POSTERIOR, shape="diamond", size=150, opacity=1),
    ]
    return Figure(layered(layers, HEIGHT, max(150 * len(levels), 300)), words, rows)


def agreement(rows: pd.DataFrame, limits: Sequence[float], axis: str, ratio_title: str, words: str) -> Figure:
    """Two measurements of the same: their ratio over their geometric mean, as Bland and Altman plot them.

    Args:
        rows: ``mean`` and ``ratio``, with names such as ``impact``, ``person`` or ``pair``.
        limits: of the ratios, of those too that are too many to be drawn; see
            `bayestissue.inference.answers.reliability.limits_of_agreement`.
        axis: name and unit of the mean.
        ratio_title: what is over what.
        words: what the figure shows.
    """
    rows = rows[rows["ratio"] > 0].reset_index(drop=True)
    lines = pd.DataFrame({"at": limits, "line": ["mean ratio", "95 % limit", "95 % limit"]}).dropna()
    lines["text"] = [f"{value:.3g}" for value in lines["at"]]
    at = number("at", ratio_title)
    dash = where("datum.line == 'mean ratio'", SOLID, {"value": DASHED})
    named = {"x": {"value": {"expr": "width"}}, "y": at, "text": {"field": "text"}}
    points = {
        "x": number("mean", axis, scale=scale_over(rows["mean"])),
        "y": number("ratio", ratio_title, scale=scale_over([*rows["ratio"], *lines["at"], 1.0])),
        "tooltip": tooltips(rows, impact="impact", person="person", pair="pair", ratio="ratio", mean="mean"),
    }
    layers = [
        level([1.0], ratio_title, strokeDash=SOLID, strokeWidth=0.8),
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


def points(
    rows: pd.DataFrame,
    x: Specification,
    y: Specification,
    words: str,
    *,
    lines: pd.DataFrame | None = None,
    joined: bool = False,
) -> Figure:
    """A point for each row, its colour and shape by ``kind``, with its interval where there is one.

    Args:
        rows: the fields of ``x`` and ``y``, ``kind``, perhaps ``low`` and ``high`` along y, and names such
            as ``impact``.
        x: a channel of numbers.
        y: likewise.
        words: what the figure shows.
        lines: curves behind the points: the fields of ``x`` and ``y``, and their names as ``line``.
        joined: whether a line joins the points of a kind.
    """
    kinds = list(dict.fromkeys(rows["kind"]))
    at: Specification = {"x": x, "y": y, "color": colours(kinds)}
    layers = []
    if lines is not None:
        shown = list(dict.fromkeys(lines["line"]))
        dashes = name(
            "line",
            scale={"domain": shown, "range": [DASHED, SOLID, DOTTED][: len(shown)]},
            legend={"orient": "bottom"},
        )
        curve = {"x": x, "y": y, "strokeDash": dashes}
        layers.append(mark("line", lines, curve, color=INK, strokeWidth=1.2, clip=True))
    if "low" in rows:
        reach = {**at, "y": {**y, "field": "low"}, "y2": {"field": "high"}}
        layers.append(mark("rule", rows, reach, opacity=0.6))
    if joined:
        layers.append(mark("line", rows, at, strokeWidth=1.4))
    titles = {"impact": "impact", "person": "person", "condition": "condition", "kind": "kind"}
    titles |= {x["field"]: x["title"], y["field"]: y["title"], "low": "from", "high": "to"}
    shown_points = {**at, "shape": shapes(kinds), "tooltip": tooltips(rows, **titles)}
    layers.append(mark("point", rows, shown_points, size=34))
    return Figure(layered(layers), words, rows)


def shares(
    rows: pd.DataFrame, x: str, y: str, words: str, *, wanted: float, chosen: tuple[float, float]
) -> Figure:
    """A cell for each x and y with its ``share``, darker for more; in bold what reaches ``wanted``.

    Args:
        rows: ``x``, ``y`` and ``share``, from 0 to 1.
        x: a column, whose name is the axis's.
        y: likewise.
        words: what the figure shows.
        wanted: the share.
        chosen: x and y of the cell with a frame.
    """
    rows = rows.assign(text=[f"{share:.2f}" for share in rows["share"]])
    cell = {
        "x": {"field": x, "type": "ordinal", "title": x, "axis": {"labelAngle": 0}},
        "y": {"field": y, "type": "ordinal", "title": y, "sort": "descending"},
    }
    tint = number("share", scale={"scheme": "blues", "domain": [0, 1]}, legend=None)
    text = {**cell, "text": {"field": "text"}, "color": where("datum.share > 0.6", "white", INK)}
    reaches = rows["share"] >= wanted
    framed = rows[(rows[[x, y]] == list(chosen)).all(axis=1)]
    layers = [
        mark("rect", rows, {**cell, "color": tint, "tooltip": tooltips(rows, **{x: x, y: y}, share="share")}),
        mark("text", rows[~reaches], text, fontSize=12),
        mark("text", rows[reaches], text, fontSize=13, fontWeight="bold"),
        mark("rect", framed, cell, filled=False, stroke=RECORDED, strokeWidth=3),
    ]
    return Figure(layered(layers, 34 * rows[y].nunique() + 20), words, rows.drop(columns="text"))
