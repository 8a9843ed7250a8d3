"""K and C of single impacts: beside each other, in order, and over the mass of the impactor."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import pandas as pd

from bayestissue.inference.results.meanings import COLUMNS, NAMES, UNITS
from bayestissue.reports.figures.theme import (
    DASHED,
    DOTTED,
    INK,
    LOOK,
    MUTED,
    POSTERIOR,
    RECORDED,
    THEME,
    ZOOM,
    Figure,
    Specification,
    colours,
    layered,
    mark,
    number,
    scale_over,
    shapes,
    tooltips,
    where,
)

MASS = "mass of the impactor, M (kg)"
# Of an impact in tooltips, by column.
_TITLES: dict[str, str] = THEME["impact_titles"]
# Over the mass.
THESIS = "thesis's method"
LINES: dict[str, Specification] = {
    "exponent 0": {"color": INK, "strokeDash": DASHED},
    "exponent 1": {"color": INK, "strokeDash": DOTTED},
    "line of the thesis": {"color": RECORDED, "strokeDash": [8, 3, 2, 3]},
}

EXPONENTS = {"exponent 0": "no dependence", "exponent 1": "in proportion"}


def axis_title(quantity: str, names: Mapping[str, str] = NAMES) -> str:
    """Name and unit, such as "stiffness K (N/m)"."""
    return f"{names[quantity]} ({UNITS[quantity]})"


def end(quantity: str, side: str) -> str:
    """The column of an end of the 90 % interval: "K_low_N_per_m"."""
    return COLUMNS[quantity].replace("_", f"_{side}_", 1)


def factors(rows: pd.DataFrame) -> list[str]:
    """The columns by which impacts are chosen: person, condition, and further categories, such as sides."""
    further = [
        str(column)
        for column in rows
        if column not in _TITLES and not pd.api.types.is_numeric_dtype(rows[column])
    ]
    return [*further, *(column for column in ("person", "condition") if column in rows)]


_CHOSEN = "datum.impact == chosen"


def _choice(rows: pd.DataFrame) -> tuple[list[Specification], str]:
    """Parameters that a page sets, and an expression for a row that is one of those shown.

    The parameters are ``chosen``, an impact, and for each of `factors` ``only_<its place>``.
    """
    columns = factors(rows)
    parameters: list[Specification] = [{"name": "chosen", "value": ""}]
    parameters += [{"name": f"only_{at}", "value": "any"} for at in range(len(columns))]
    shown = [f"(only_{at} == 'any' || datum[{column!r}] == only_{at})" for at, column in enumerate(columns)]
    return parameters, " && ".join(shown) or "true"


def scatter(rows: pd.DataFrame, x: str, y: str, words: str, names: Mapping[str, str] = NAMES) -> Figure:
    """A point for each impact, the chosen one larger and with its 90 % intervals; in order, all with theirs.

    Args:
        rows: ``impact``, `COLUMNS` with the ends of their 90 % intervals, `factors`, ``mass_kg`` and the
            like, and perhaps ``true_K``, ``true_C``.
        x: "K", "C", "mass", or "order" for impacts in the order of ``y``.
        y: "K" or "C".
        words: what the figure shows.
        names: what K and C are called.
    """
    rows = rows.sort_values(COLUMNS[y], kind="stable", ignore_index=True)
    rows.insert(1, "order", range(1, len(rows) + 1))
    column, title = {
        "order": ("order", f"impacts in the order of {y}"),
        "mass": ("mass_kg", MASS),
        **{q: (COLUMNS[q], axis_title(q, names)) for q in COLUMNS},
    }[x]
    parameters, shown = _choice(rows)
    X = number(
        column,
        title,
        scale={"zero": False, "nice": False, "padding": 8} if x == "order" else scale_over(rows[column]),
        **({"axis": {"tickMinStep": 1}} if x == "order" else {}),
    )
    Y = number(
        COLUMNS[y],
        axis_title(y, names),
        scale=scale_over(rows[[end(y, "low"), end(y, "high")]].to_numpy().ravel()),
    )
    colour = where(_CHOSEN, RECORDED, POSTERIOR)
    # Where each interval would hide others, that of the chosen impact alone is there.
    bar = where(shown, 0.75, 0.08) if x == "order" else where(_CHOSEN, 1, 0)
    up = {"x": X, "y": number(end(y, "low"), axis_title(y, names)), "y2": {"field": end(y, "high")}}
    layers = [mark("rule", rows, {**up, "color": colour, "opacity": bar})]
    if x in COLUMNS:
        across = {"y": Y, "x": number(end(x, "low"), title), "x2": {"field": end(x, "high")}}
        layers.append(mark("rule", rows, {**across, "color": colour, "opacity": bar}))
    faint = where(shown, 0.75, 0.08)
    if x == "order" and f"true_{y}" in rows:
        crosses = {"x": X, "y": number(f"true_{y}", axis_title(y, names)), "opacity": faint}
        layers.append(mark("point", rows, crosses, shape="cross", size=20, color=INK))
    size = where(_CHOSEN, LOOK.chosen, LOOK.in_order if x == "order" else LOOK.point)
    points = {
        "x": X,
        "y": Y,
        "color": colour,
        "opacity": faint,
        "size": size,
        "tooltip": tooltips(rows, **_TITLES),
    }
    layers.append(mark("point", rows, points))
    layers[0]["params"] = [ZOOM]
    return Figure(layered(layers, params=parameters), words, rows)


def over_mass(
    impacts: pd.DataFrame,
    conditions: pd.DataFrame,
    curve: pd.DataFrame,
    quantity: str,
    words: str,
    *,
    who: str = "typical person",
    names: Mapping[str, str] = NAMES,
    others: Sequence[pd.DataFrame] = (),
) -> Figure:
    """K or C over mass on log scales: impacts, conditions, the posterior's line, exponents 0 and 1.

    Args:
        impacts: as of `scatter`.
        conditions: ``mass_kg``, ``median``, ``eti90_low``, ``eti90_high``, ``label``.
        curve: ``mass_kg``; lines, by the names in `LINES`; and, of a model with a mass exponent, ``median``,
            ``eti90_low`` and ``eti90_high``.
        quantity: "K" or "C".
        words: what the figure shows.
        who: whose line and conditions they are.
        names: what K and C are called.
        others: further values, such as point estimates by another method: ``mass_kg``, ``value``, ``kind``
            and, where they have one, the ends ``low`` and ``high`` of a range.
    """
    column, title = COLUMNS[quantity], axis_title(quantity, names)
    kinds = ["impact", who, *(str(rows["kind"].iloc[0]) for rows in others)]
    known = pd.concat([impacts[column], *(rows["value"] for rows in others)])
    X = number("mass_kg", MASS, scale={"type": "log", "nice": False, "padding": 12})
    scale = {"type": "log", "nice": False, "domain": [known.min() / 1.15, known.max() * 1.15]}
    colour = colours(kinds, **{"impact": MUTED, who: POSTERIOR, THESIS: RECORDED})
    shape = shapes(kinds)

    def y(field: str) -> Specification:
        return number(field, title, scale=scale)

    layers = []
    if "median" in curve:
        band = {"x": X, "y": y("eti90_low"), "y2": {"field": "eti90_high"}}
        layers.append(mark("area", curve, band, color=POSTERIOR, opacity=0.2, clip=True))
        layers.append(mark("line", curve, {"x": X, "y": y("median")}, color=POSTERIOR, clip=True))
    dashes = {"domain": list(EXPONENTS.values()), "range": [LINES[line]["strokeDash"] for line in EXPONENTS]}
    for line, style in LINES.items():
        if line in curve:
            drawn: Specification = {"x": X, "y": y(line), "strokeDash": None}
            if line in EXPONENTS:
                # Long enough to show how it is dashed.
                legend = {"symbolStrokeColor": INK, "symbolSize": 500}
                drawn["strokeDash"] = {
                    "datum": EXPONENTS[line],
                    "title": None,
                    "scale": dashes,
                    "legend": legend,
                }
            layers.append(mark("line", curve, drawn, strokeWidth=1.2, clip=True, **style))
    points = {
        "x": X,
        "y": y(column),
        "color": colour,
        "shape": shape,
        "tooltip": tooltips(impacts, **_TITLES),
    }
    impact = mark("point", impacts.assign(kind="impact"), points, size=LOOK.over_mass, opacity=0.7, clip=True)
    layers.append(impact)
    conditions = conditions.assign(kind=who)
    details = tooltips(conditions, label="condition", median="median", eti90_low="90 % from", eti90_high="to")
    reach = {"x": X, "y": y("eti90_low"), "y2": {"field": "eti90_high"}, "color": colour}
    layers.append(mark("rule", conditions, reach, strokeWidth=1.4, clip=True))
    middle = {"x": X, "y": y("median"), "color": colour, "shape": shape, "tooltip": details}
    layers.append(mark("point", conditions, middle, size=50, clip=True))
    for rows in others:
        if "low" in rows:
            reach = {"x": X, "y": y("low"), "y2": {"field": "high"}, "color": colour}
            layers.append(mark("rule", rows, reach, clip=True))
        marks = {"x": X, "y": y("value"), "color": colour, "shape": shape}
        layers.append(mark("point", rows, marks, filled=False, size=70, clip=True))
    layers[0]["params"] = [ZOOM]
    return Figure(layered(layers), words, impacts)
