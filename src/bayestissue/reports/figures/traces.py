"""Recordings, by themselves and over what the model predicts of them, and tests of what is left."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pandas as pd

from bayestissue.reports.figures.study_comparisons import points
from bayestissue.reports.figures.theme import (
    DASHED,
    DOTTED,
    INK,
    MUTED,
    POSTERIOR,
    RECORDED,
    SHORT,
    SOLID,
    Figure,
    Specification,
    colours,
    layered,
    level,
    mark,
    name,
    number,
    tooltips,
)

# Quantiles of the replicates, by name.
BANDS = {"low": 5, "quarter": 25, "median": 50, "three_quarters": 75, "high": 95}
# The data of a recording's figure, which a page replaces.
TRACE = "trace"
# In a panel; every other kind is a curve.
CONTACT, TURN, PEAK = "contact", "zero velocity", "peak"
PANELS_ACROSS = 3


def recording(rows: pd.DataFrame, what: str, unit: str, words: str, *, median: str = "median") -> Figure:
    """A recording over the model's predictive band; under it the same less the band's median.

    Args:
        rows: ``time_ms``, ``recorded``, ``median`` and, where there is a band, the others of `BANDS`, in
            ``unit``.
        what: was recorded: "deceleration" or "displacement".
        unit: of it.
        words: what the figure shows.
        median: what the median is called.
    """
    bands = {"predicted, 90 %": "#bcd7e8", "50 %": "#8abbd9"} if "low" in rows else {}
    kinds = {"recorded": RECORDED, **bands, median: POSTERIOR}
    legend = {"columns": 4, "symbolType": "square"}
    colour = name("kind", scale={"domain": list(kinds), "range": list(kinds.values())}, legend=legend)
    details = tooltips(rows, time_ms="time (ms)", recorded=f"recorded ({unit})", median=f"{median} ({unit})")

    def panel(value: str, axis: str, x: Specification, height: int) -> Specification:
        def layer(
            shape: str, kind: str, low: str, high: str | None = None, **properties: Any
        ) -> Specification:
            ends = {"y": low} | ({"y2": high} if high else {})
            encoding: Specification = {
                "x": x,
                "y": number("y", axis, scale={"zero": False}),
                "y2": {"field": "y2"} if high else None,
                "color": colour,
                "tooltip": details if shape == "point" else None,
            }
            return mark(shape, {"name": TRACE}, encoding, **properties) | {
                "transform": [
                    *({"calculate": value.format(column), "as": to} for to, column in ends.items()),
                    {"calculate": repr(kind), "as": "kind"},
                ]
            }

        layers = [
            layer("line", median, "median", strokeWidth=1.2),
            layer("point", "recorded", "recorded", size=9, opacity=0.9),
        ]
        if bands:
            ninety, fifty = bands
            layers.insert(0, layer("area", ninety, "low", "high"))
            layers.insert(1, layer("area", fifty, "quarter", "three_quarters"))
        return layered(layers, height)

    above = number("time_ms", None, axis={"labels": False})
    below = number("time_ms", "time since contact (ms)")
    # Where nothing is fitted, nothing is left over.
    residual = "isValid(datum.median) ? datum.{} - datum.median : null"
    panels = [
        panel("datum.{}", f"{what} ({unit})", above, 210),
        panel(residual, f"residual ({unit})", below, 90),
    ]
    chart: Specification = {
        "vconcat": panels,
        "spacing": 8,
        "data": {"name": TRACE, "values": rows.to_dict("records")},
    }
    return Figure(chart, words, rows)


def thinned(values: np.ndarray, most: int) -> np.ndarray:
    """Indices of about ``most`` values: the least and the greatest of each stretch, so that peaks stay."""
    if values.size <= most:
        return np.arange(values.size)
    stretches = np.array_split(np.arange(values.size), max(most // 2, 1))
    ends = [(part[values[part].argmin()], part[values[part].argmax()]) for part in stretches]
    return np.unique(ends)


def panels(
    rows: pd.DataFrame, time: str, value: str, words: str, *, domain: tuple[float, float] | None = None
) -> Figure:
    """A small panel for each ``impact``: curves over time, and when something happens.

    Args:
        rows: ``impact``, ``time_ms``, ``value`` and ``kind``: a curve's, or `CONTACT`, `TURN` or `PEAK`.
        time: title of the time axes, with its unit.
        value: title of the others.
        words: what the figure shows.
        domain: ends of the axes of values; each panel's own unless given.
    """
    kinds = list(dict.fromkeys(rows["kind"]))
    x = number("time_ms", time, scale={"zero": False, "nice": False}, axis={"tickCount": 5})
    y = number("value", value, scale={"zero": False} | ({"domain": domain} if domain else {}))
    colour = colours(kinds, **{CONTACT: INK, TURN: MUTED, PEAK: INK})
    dashes = itertools.cycle((SOLID, DASHED, DOTTED))

    def layer(kind: str) -> Specification:
        one: Specification = {"transform": [{"filter": {"field": "kind", "equal": kind}}]}
        if kind in (CONTACT, TURN):
            dash = DASHED if kind == CONTACT else DOTTED
            return one | mark("rule", None, {"x": x, "color": colour}, strokeDash=dash)
        encoding = {"x": x, "y": y, "color": colour}
        if kind == PEAK:
            return one | mark("point", None, encoding, shape="triangle-down", size=50)
        return one | mark("line", None, encoding, strokeDash=next(dashes), strokeWidth=1.2, clip=True)

    chart = {
        "data": rows,
        "facet": {
            **name("impact", sort=list(dict.fromkeys(rows["impact"]))),
            "header": {"labelExpr": SHORT, "labelFontSize": 11},
        },
        "columns": PANELS_ACROSS,
        "spec": layered([layer(kind) for kind in kinds], 120, 200),
        "resolve": {"scale": {"x": "independent"} | ({} if domain else {"y": "independent"})},
    }
    return Figure(chart, words, rows)


def sorted_p(values: np.ndarray, structured: float, words: str) -> Figure:
    """Sorted p-values over those that the model's noise would give, on log scales.

    ``structured`` is the p-value below which an impact's residuals count as structured.
    """
    p = np.sort(np.maximum(values[np.isfinite(values)], 1e-12))
    expected = (np.arange(p.size) + 0.5) / p.size
    rows = pd.DataFrame({"expected": expected, "p": p, "kind": "what the fit leaves"})
    log: Specification = {"type": "log", "nice": False}
    lines = {"the model's noise": (1e-3, 1.0), "structured": (structured, structured)}
    return points(
        rows,
        number("expected", "p expected", scale=log, axis={"tickCount": 5}),
        number("p", "p of the impact (10 lags)", scale=log, axis={"tickCount": 6, "format": "~g"}),
        words,
        lines=pd.concat(
            [pd.DataFrame({"expected": [1e-3, 1.0], "p": ends, "line": line}) for line, ends in lines.items()]
        ),
    )


def lag_one(rows: pd.DataFrame, words: str) -> Figure:
    """Autocorrelation of each impact's residuals at lag 1 over that of data made by the model.

    Args:
        rows: ``impact``, ``recorded``, and the replicates' 5 % and 95 % points ``low`` and ``high``.
        words: what the figure shows.
    """
    rows = rows.sort_values("recorded", kind="stable", ignore_index=True)
    rows = rows.assign(order=range(1, len(rows) + 1))
    title = "autocorrelation of residuals at lag 1"
    x = number("order", "impacts in order", scale={"nice": False, "padding": 6})
    colour = colours(("predicted, 90 %", "recorded"))
    details = tooltips(rows, impact="impact", recorded="recorded", low="predicted from", high="to")

    def kind_is(kind: str) -> list[Specification]:
        return [{"calculate": repr(kind), "as": "kind"}]

    bar = {"x": x, "y": number("low", title), "y2": {"field": "high"}, "color": colour}
    point = {"x": x, "y": number("recorded", title), "color": colour, "tooltip": details}
    layers = [
        mark("rule", rows, bar, strokeWidth=3, opacity=0.35) | {"transform": kind_is("predicted, 90 %")},
        mark("point", rows, point, size=22) | {"transform": kind_is("recorded")},
        level([0.0], title),
    ]
    return Figure(layered(layers, 260), words, rows)


def against(rows: pd.DataFrame, x: str, y: str, words: str) -> Figure:
    """What was recorded against what another channel makes of it, a curve for each impact, over equality.

    Args:
        rows: ``impact``, ``number`` of the sample, ``expected`` and ``recorded``.
        x: title of the axis of what is expected, with its unit.
        y: title of the other.
        words: what the figure shows.
    """
    ends = [float(limit(rows[["expected", "recorded"]].to_numpy())) for limit in (np.min, np.max)]
    equal = pd.DataFrame({"expected": ends, "recorded": ends})
    axes = {"x": number("expected", x), "y": number("recorded", y)}
    curve = {**axes, "detail": name("impact"), "order": number("number")}
    layers = [
        mark("line", equal, axes, color=MUTED, strokeDash=DASHED),
        mark("line", rows, curve, color=RECORDED, strokeWidth=1, opacity=0.7),
    ]
    return Figure(layered(layers, 280), words, rows)
