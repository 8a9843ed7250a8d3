"""Recordings over what the model predicts of them, and tests of what is left."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from bayestissue.figures.theme import (
    DASHED,
    INK,
    MUTED,
    POSTERIOR,
    RECORDED,
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
_COLOURS = {"recorded": RECORDED, "predicted, 90 %": "#bcd7e8", "50 %": "#8abbd9", "median": POSTERIOR}


def recording(rows: pd.DataFrame, what: str, unit: str, words: str) -> Figure:
    """A recording over the model's predictive band; under it the same less the band's median.

    Args:
        rows: ``time_ms``, ``recorded`` and `BANDS`, in ``unit``.
        what: was recorded: "deceleration" or "displacement".
        unit: of it.
        words: what the figure shows.
    """
    legend = {"columns": 4, "symbolType": "square"}
    colour = name("kind", scale={"domain": list(_COLOURS), "range": list(_COLOURS.values())}, legend=legend)
    details = tooltips(rows, time_ms="time (ms)", recorded=f"recorded ({unit})", median=f"predicted ({unit})")

    def panel(less: str, axis: str, x: Specification, height: int) -> Specification:
        def layer(
            shape: str, kind: str, low: str, high: str | None = None, **properties: Any
        ) -> Specification:
            ends = {"y": low} | ({"y2": high} if high else {})
            encoding: Specification = {
                "x": x,
                "y": number("y", axis, scale={"zero": False}),
                "y2": {"field": "y2"} if high else None,
                "color": colour,
            }
            if shape == "point":
                encoding["tooltip"] = details
            return mark(shape, {"name": TRACE}, encoding, **properties) | {
                "transform": [
                    *({"calculate": f"datum.{column}{less}", "as": to} for to, column in ends.items()),
                    {"calculate": repr(kind), "as": "kind"},
                ]
            }

        return layered(
            [
                layer("area", "predicted, 90 %", "low", "high"),
                layer("area", "50 %", "quarter", "three_quarters"),
                layer("line", "median", "median", strokeWidth=1.2),
                layer("point", "recorded", "recorded", size=9, opacity=0.9),
            ],
            height,
        )

    above = number("time_ms", None, axis={"labels": False})
    below = number("time_ms", "time since contact (ms)")
    panels = [
        panel("", f"{what} ({unit})", above, 210),
        panel(" - datum.median", f"residual ({unit})", below, 90),
    ]
    chart: Specification = {
        "vconcat": panels,
        "spacing": 8,
        "data": {"name": TRACE, "values": rows.to_dict("records")},
    }
    return Figure(chart, words, rows)


def sorted_p(sets: Mapping[str, np.ndarray], structured: float, words: str) -> Figure:
    """Sorted p-values over those that the model's noise would give, on log scales, by kind of test.

    ``structured`` is the p-value below which an impact's residuals count as structured.
    """
    least = 1e-12
    parts = [pd.DataFrame({"expected": [], "p": [], "kind": []})]
    for kind, values in sets.items():
        p = np.sort(np.maximum(values[np.isfinite(values)], least))
        parts.append(pd.DataFrame({"expected": (np.arange(p.size) + 0.5) / p.size, "p": p, "kind": kind}))
    rows = pd.concat([part for part in parts if len(part)] or parts[:1], ignore_index=True)
    x = number("expected", "p expected", scale={"type": "log", "nice": False}, axis={"tickCount": 5})
    title = "p of the impact (10 lags)"
    y = number("p", title, scale={"type": "log", "nice": False}, axis={"tickCount": 6, "format": "~g"})
    ends = pd.DataFrame({"expected": [1e-3, 1.0], "p": [1e-3, 1.0]})
    shape = name("kind", scale={"domain": list(sets), "range": ["circle", "triangle-up"]})
    points: Specification = {"x": x, "y": y, "color": colours(sets), "shape": shape}
    points["tooltip"] = tooltips(rows, kind="test", p="p", expected="expected")
    layers = [
        mark("line", ends, {"x": x, "y": y}, strokeDash=DASHED, color=INK),
        level([structured], title, color=MUTED, strokeDash=[1, 0]),
        mark("point", rows, points, filled=False),
    ]
    return Figure(layered(layers, 260), words, rows)


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
