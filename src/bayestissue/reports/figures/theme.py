"""How every figure looks, and what goes with it: words, and the table that it is drawn from.

A figure is a specification of Vega-Lite as plain dictionaries, tables in place of data. They are made a
hundred times faster so than by a library of classes, which would check each of them against the schema.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

import pandas as pd

type Specification = dict[str, Any]

SCHEMA = "https://vega.github.io/schema/vega-lite/v6.json"
# Vega's configuration, parameters of charts and titles of columns. A label at the end of an axis reaches
# beyond it, hence the padding; the colours are Okabe and Ito's, but for yellow and orange, which are too pale
# on white.
THEME = json.loads(files(__package__).joinpath("theme.json").read_text(encoding="utf-8"))
_CONFIG: Specification = THEME["config"]
# Shift and wheel zoom, Shift and drag move, a double click resets: the page scrolls as ever.
ZOOM: Specification = THEME["zoom"]
INK, MUTED, FAINT = _CONFIG["axis"]["labelColor"], _CONFIG["axis"]["tickColor"], "#d0d7de"
PALETTE: tuple[str, ...] = (*_CONFIG["range"]["category"],)
POSTERIOR, RECORDED = PALETTE[:2]

# No label is cut: a long name loses its middle, and stands whole in the tooltip and in the table.
SHORT = "length(datum.label) > 28 ? slice(datum.label, 0, 13) + '…' + slice(datum.label, -14) : datum.label"
# A figure of more marks is painted rather than kept as elements.
MANY = 1500
WIDTH, HEIGHT = 460, 300
SOLID, DASHED, DOTTED = [1, 0], [5, 4], [2, 3]
SHAPES = ("circle", "square", "diamond", "triangle-up", "cross", "triangle-down", "stroke")


@dataclass(frozen=True)
class Look:
    """What figures were set by eye to.

    Attributes:
        many_fold: ratio of the greatest to the least beyond which a logarithmic axis shows more than a
            straight one.
        long: letters of a name from which on a legend has one column.
        point: area of an impact's mark, in pixels.
        in_order: that of one among all impacts in order.
        over_mass: that of one behind the line over the mass.
        chosen: that of the chosen impact.
    """

    many_fold: float = 10.0
    long: int = 30
    point: int = 36
    in_order: int = 14
    over_mass: int = 22
    chosen: int = 130


LOOK = Look()


@dataclass(frozen=True)
class Figure:
    """A chart, what it shows in words for those who can't see it, and the table behind it.

    Attributes:
        chart: a specification of Vega-Lite in which ``data`` are tables.
        words: a sentence.
        data: the rows that the figure's numbers are read from.
    """

    chart: Specification
    words: str
    data: pd.DataFrame

    def specification(self) -> Specification:
        """The chart as Vega-Lite has it, whole: data, theme and all."""
        tables: list[pd.DataFrame] = []
        whole = {"$schema": SCHEMA, **_with_named_data(self.chart, tables), "config": _CONFIG}
        whole["datasets"] = {f"rows-{at}": table.to_dict("records") for at, table in enumerate(tables)}
        if any(len(table) > MANY for table in tables):
            whole["usermeta"] = {"embedOptions": {"renderer": "canvas"}}
        return whole

    def svg(self) -> str:
        """The figure drawn."""
        import vl_convert

        return vl_convert.vegalite_to_svg(self.specification())

    def _repr_mimebundle_(self, *_: Any, **__: Any) -> dict[str, Any]:
        """A notebook draws the chart."""
        return {"application/vnd.vegalite.v6+json": self.specification(), "text/plain": self.words}


def _with_named_data(part: Any, tables: list[pd.DataFrame]) -> Any:
    """``part`` with names in place of tables, which are added to ``tables`` once each."""
    if isinstance(part, pd.DataFrame):
        at = next((at for at, known in enumerate(tables) if known is part), len(tables))
        if at == len(tables):
            tables.append(part)
        return {"name": f"rows-{at}"}
    if isinstance(part, dict):
        return {name: _with_named_data(inner, tables) for name, inner in part.items()}
    return [_with_named_data(inner, tables) for inner in part] if isinstance(part, list) else part


def mark(
    kind: str, data: pd.DataFrame | Specification | None, encoding: Specification, **properties: Any
) -> Specification:
    """A layer: a ``kind`` of mark, such as "point", a row of ``data`` each; a channel may be None.

    Without ``data`` they are those of the whole figure.
    """
    return {
        "mark": {"type": kind, **properties},
        **({} if data is None else {"data": data}),
        "encoding": {name: channel for name, channel in encoding.items() if channel is not None},
    }


def number(field: str, title: str | None = None, **further: Any) -> Specification:
    """A channel of numbers in the column ``field``, under ``title``, name and unit."""
    return {"field": field, "type": "quantitative", "title": title, **further}


def name(field: str, **further: Any) -> Specification:
    """A channel of names in the column ``field``."""
    return {"field": field, "type": "nominal", "title": None, **further}


def names(field: str, order: Sequence[str]) -> Specification:
    """An axis of names from the data, in their ``order``."""
    axis = {"labelExpr": SHORT, "grid": False, "ticks": False, "domain": False, "labelPadding": 9}
    return name(field, sort=list(order), axis=axis)


def where(test: str, then: Any, otherwise: Any) -> Specification:
    """A channel of one of two values, or of a value and another channel, by an expression."""
    channel = otherwise if isinstance(otherwise, dict) else {"value": otherwise}
    return {"condition": {"test": test, "value": then}, **channel}


def scale_over(values: Iterable[float]) -> Specification:
    """A scale that suits ``values``: logarithmic where they are positive and differ by a factor of ten."""
    known = [float(value) for value in values if pd.notna(value)]
    if known and min(known) > 0 and max(known) > LOOK.many_fold * min(known):
        return {"type": "log", "nice": False, "padding": 6}
    return {"type": "linear", "zero": False, "padding": 6}


def tooltips(rows: pd.DataFrame, **titles: str) -> list[Specification]:
    """A line of a tooltip for each of the columns in ``titles`` that ``rows`` has: column to title."""
    return [
        number(column, title, format=".4~g")
        if pd.api.types.is_numeric_dtype(rows[column])
        else {"field": column, "type": "nominal", "title": title}
        for column, title in titles.items()
        if column in rows
    ]


def colours(kinds: Iterable[str], field: str = "kind", **chosen: str) -> Specification:
    """Colours of kinds of marks, named in a legend; those of ``chosen`` by name."""
    domain = list(kinds)
    shown = [chosen.get(kind, PALETTE[at % len(PALETTE)]) for at, kind in enumerate(domain)]
    return name(field, scale={"domain": domain, "range": shown}, legend=_legend(domain))


def shapes(kinds: Iterable[str], field: str = "kind") -> Specification:
    """A shape for each kind of mark, which tells them apart without colours too."""
    domain = list(kinds)
    shown = [SHAPES[at % len(SHAPES)] for at in range(len(domain))]
    return name(field, scale={"domain": domain, "range": shown}, legend=_legend(domain))


def _legend(kinds: Sequence[str]) -> Specification | None:
    """None of one kind."""
    if len(kinds) < 2:
        return None
    return {"columns": 1} if max(map(len, kinds)) > LOOK.long else {}


def level(at: Iterable[float], axis: str, channel: str = "y", **properties: Any) -> Specification:
    """Lines across the figure where ``channel`` has the values ``at``; ``axis`` is its title."""
    rows = pd.DataFrame({"at": [float(value) for value in at]})
    return mark(
        "rule", rows, {channel: number("at", axis)}, **({"color": INK, "strokeDash": DASHED} | properties)
    )


def layered(
    layers: Sequence[Specification], height: Any = HEIGHT, width: int = WIDTH, **further: Any
) -> Specification:
    """One panel of several layers; the last lies on top."""
    return {"layer": list(layers), "width": width, "height": height, **further}
