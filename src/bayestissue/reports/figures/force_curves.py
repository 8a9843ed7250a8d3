"""What impacts do: force over depth, and an outcome over the velocity or the height of the fall."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import pandas as pd

from bayestissue.reports.figures.theme import (
    DASHED,
    HEIGHT,
    LOOK,
    SHORT,
    SOLID,
    WIDTH,
    Figure,
    Specification,
    colours,
    layered,
    mark,
    name,
    number,
    shapes,
    tooltips,
)

_ACROSS = 3
_WIDTH = 240


def loops(rows: pd.DataFrame, recorded: pd.DataFrame, words: str) -> Figure:
    """Force over depth, a panel for each motion: levels as lines, recorded impacts as thin ones.

    Args:
        rows: ``panel``, ``level``, ``branch`` ("in" to the greatest depth, "out" from there on), ``depth_mm``
            and ``force_N``, in the order of panels and levels; each level has a colour and a mark of its own.
        recorded: ``panel``, ``level``, ``impact``, ``order``, ``depth_mm`` and ``force_N``.
        words: what the figure shows.
    """
    depth, force = number("depth_mm", "depth (mm)"), number("force_N", "force (N)")
    colour, shape = _of_levels(rows)
    details = tooltips(rows, level="of", depth_mm="depth (mm)", force_N="force (N)")
    parts = {
        "recorded": recorded,
        "median": rows.assign(order=range(len(rows))),
        "deepest": rows[rows["branch"] == "in"].groupby(["panel", "level"], sort=False).tail(1),
    }
    line = {"x": depth, "y": force, "color": colour, "order": number("order")}
    single = line | {
        "detail": {"field": "impact"},
        "tooltip": tooltips(recorded, impact="impact", level="of"),
    }
    tip = {"x": depth, "y": force, "color": colour, "shape": shape, "tooltip": details}
    thin = {"strokeWidth": 0.7, "opacity": 0.4}
    layers = [
        _of("recorded", mark("line", None, single, **thin)),
        _of("median", mark("line", None, line, strokeWidth=1.6)),
        _of("deepest", mark("point", None, tip, size=55)),
    ]
    return Figure(_panels(parts, layers, list(rows["panel"].unique())), words, rows)


def over_velocity(
    rows: pd.DataFrame, recorded: pd.DataFrame, x: Specification, axis: str, panels: Sequence[str], words: str
) -> Figure:
    """An outcome over velocity or height: levels with their bands, dashed beyond what was measured.

    Args:
        rows: ``panel``, ``level``, the field of ``x``, growing, ``median``, ``low``, ``high`` and ``beyond``.
        recorded: ``panel``, ``level``, ``impact``, the field of ``x``, ``median``, ``low`` and ``high``.
        x: a channel of numbers.
        axis: name and unit of the outcome.
        panels: in order, one for each mass.
        words: what the figure shows.
    """
    x, y = x | {"scale": {"zero": False}}, number("median", axis, scale={"zero": False})
    colour, shape = _of_levels(rows)
    titles = {"impact": "impact", "level": "of", x["field"]: x["title"], "median": "median"}
    titles |= {"low": "90 % from", "high": "to"}
    at = {"x": x, "color": colour}
    reach = at | {"y": {**y, "field": "low"}, "y2": {"field": "high"}}
    point = at | {"y": y, "shape": shape, "tooltip": tooltips(recorded, **titles)}
    line = at | {"y": y, "tooltip": tooltips(rows, **titles)}
    curves = {"measured": rows[rows["beyond"] == 0]}
    # The last measured velocity is also where the rest begins.
    curves |= {"below": rows[rows.groupby(["panel", "level"]).cumcount() < 2]}
    curves |= {"above": rows[rows.groupby(["panel", "level"]).cumcount(ascending=False) < 2]}
    layers = [
        _of("all", mark("area", None, reach, opacity=0.25)),
        *(
            _of(part, mark("line", None, line, strokeDash=SOLID if part == "measured" else DASHED))
            for part in curves
        ),
        _of("recorded", mark("rule", None, reach, opacity=0.6)),
        _of("recorded", mark("point", None, point, size=34)),
    ]
    return Figure(_panels({"all": rows, "recorded": recorded, **curves}, layers, panels), words, rows)


def _of_levels(rows: pd.DataFrame) -> tuple[Specification, Specification]:
    """A colour and a shape for each level, short names side by side in the legend."""
    levels = list(rows["level"].unique())
    wide = len(levels) > 1 and sum(map(len, levels)) < LOOK.long
    legend = {"legend": {"columns": len(levels)}} if wide else {}
    return colours(levels, "level") | legend, shapes(levels, "level") | legend


def _of(part: str, layer: Specification) -> Specification:
    """A layer of one part of the table."""
    return layer | {"transform": [{"filter": {"field": "part", "equal": part}}]}


def _panels(
    parts: Mapping[str, pd.DataFrame], layers: Sequence[Specification], panels: Sequence[str]
) -> Specification:
    """The same layers for each ``panel`` of one table, whose ``part`` tells them which rows are theirs."""
    whole = [rows.assign(part=part) for part, rows in parts.items() if len(rows)]
    width = _WIDTH if len(panels) > 1 else WIDTH
    return {
        "data": pd.concat(whole, ignore_index=True),
        "facet": {**name("panel", sort=list(panels)), "header": {"labelExpr": SHORT, "labelFontSize": 12}},
        "columns": min(_ACROSS, len(panels)),
        "spec": layered(layers, HEIGHT if len(panels) == 1 else _WIDTH, width),
        "resolve": {"scale": {}},
    }
