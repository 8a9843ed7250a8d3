"""Tables as a template wants them; those of settings, priors and a posterior that several pages have."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import pandas as pd
from markupsafe import Markup

from bayestissue.declarations import declared
from bayestissue.inference.results.meanings import SECANTS
from bayestissue.report.wording import decimals_of, interval, number, probability, significant


@dataclass(frozen=True)
class Column:
    """A heading and how its cells are set: ``"text"``, ``"number"`` (to the right) or ``"words"``."""

    title: str
    kind: str = "text"


@dataclass(frozen=True)
class Row:
    """The cells of one row; ``mark`` is a class of the style sheet, such as ``"disagrees"``."""

    cells: Sequence[str]
    mark: str = ""
    anchor: str = ""


@dataclass(frozen=True)
class Table:
    """A whole table; cells are text, or `Markup` where they hold more than text."""

    columns: Sequence[Column]
    rows: Sequence[Row] = field(default_factory=tuple)


@dataclass(frozen=True)
class Field:
    """A column with what makes its cell of a row of the data; ``kind`` as of `Column`."""

    title: str
    cell: Callable[[Any], str]
    kind: str = "text"


def number_field(title: str, column: str, words: Callable[[float], str] = significant) -> Field:
    """A column of numbers in words; a row that lacks its number has an empty cell."""
    return Field(title, lambda row: "" if pd.isna(row[column]) else words(row[column]), "number")


def table_of(rows: Iterable[Any], *fields: Field, mark: Callable[[Any], str] = lambda row: "") -> Table:
    """A table with a row for each of ``rows``, and a cell in it for each of ``fields``."""
    return Table(
        [Column(field.title, field.kind) for field in fields],
        [Row(tuple(field.cell(row) for field in fields), mark(row)) for row in rows],
    )


def columns(*titles: str, number: Sequence[str] = (), words: Sequence[str] = ()) -> tuple[Column, ...]:
    """One column a title; those in ``number`` are set to the right, those in ``words`` may grow wide."""
    return tuple(
        Column(title, "number" if title in number else "words" if title in words else "text")
        for title in titles
    )


def lines(frame: pd.DataFrame) -> list[Any]:
    """The rows of ``frame`` as named tuples, whose fields are the columns and ``Index``."""
    return list(frame.itertuples())


def cell_words(value: Any) -> str:
    """A cell of a table: a number that is not whole with four digits, empty where there is none."""
    if isinstance(value, float):
        return "" if math.isnan(value) else significant(value, 4)
    return str(value)


def frame_table(frame: pd.DataFrame, words: Callable[[Any], str] = cell_words) -> Table:
    """Every column of ``frame`` under its own name, each cell in ``words``, numbers to the right."""
    numbers = [str(name) for name in frame if pd.api.types.is_numeric_dtype(frame[name])]
    rows = [Row([words(value) for value in row]) for row in frame.itertuples(index=False, name=None)]
    return Table(columns(*map(str, frame), number=numbers), rows)


def tag(kind: str, words: str) -> Markup:
    """``words`` as a small coloured label; ``kind`` is a class of the style sheet, such as ``"major"``."""
    return Markup('<span class="tag {}">{}</span>').format(kind, words)


def settings_table(content: Mapping[str, Any], shown_elsewhere: Collection[str] = ()) -> Table:
    """Every key of ``content`` and its value, one a row; inner tables' keys are joined with a dot.

    The top-level keys in ``shown_elsewhere`` are left out.
    """
    remaining = {key: value for key, value in content.items() if key not in shown_elsewhere}
    return Table(columns("setting", "value", words=("value",)), [Row(pair) for pair in _flat(remaining)])


def _flat(content: Mapping[str, Any], above: str = "") -> Iterator[tuple[str, str]]:
    for key, value in content.items():
        name = f"{above}{key}"
        if isinstance(value, Mapping):
            yield from _flat(value, f"{name}.")
        else:
            yield name, plain(value)


def plain(value: Any) -> str:
    """One value of a TOML or JSON file as a reader would write it."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:g}".replace("-", "−")
    if isinstance(value, list):
        return ", ".join(plain(item) for item in value)
    return "not set" if value is None else str(value)


_MEANINGS = declared(__package__, "priors.toml")
SHOWN_ELSEWHERE = ("name", "description", "formula", "priors")


def priors_table(model: Mapping[str, Any], unused: Collection[str] = ()) -> Table:
    """Every prior but the ``unused``: of what, for which quantity, and the distribution in words."""
    rows = [
        Row((name, _MEANINGS.get(name, ""), quantity, distribution))
        for name, prior in dict(model.get("priors", {})).items()
        if name not in unused
        for quantity, distribution in _distributions(prior)
    ]
    return Table(columns("parameter", "meaning", "quantity", "prior", words=("meaning",)), rows)


def _distributions(prior: Any) -> Iterator[tuple[str, str]]:
    if isinstance(prior, Mapping) and "distribution" not in prior:
        for quantity, inner in prior.items():
            # Of an element's parameters there are the mean over impacts and the spread.
            named = isinstance(inner, Mapping) and "distribution" not in inner
            for part, words in _distributions(inner):
                yield (f"{quantity}, {part}" if named else quantity), words
    else:
        yield "both", distribution_words(prior)


def distribution_words(prior: Any) -> str:
    """A distribution as a model file writes it, in words: "half-normal, scale 0.5"."""
    if not isinstance(prior, Mapping):
        return plain(prior)
    settings = [f"{name} {plain(value)}" for name, value in prior.items() if name != "distribution"]
    return ", ".join([str(prior["distribution"]), *settings])


def formulas(model: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Pairs of left and right side, such as ``("log K", "log(mass_kg) + (1|subject)")``."""
    return [(f"log {name}", str(right)) for name, right in dict(model.get("formula", {})).items()]


def hypotheses_table(hypotheses: pd.DataFrame) -> Table:
    """`hypotheses.csv`: the posterior probability that a mass exponent counts as 0, as 1, or as neither."""
    return table_of(
        lines(hypotheses),
        Field("quantity", lambda line: SECANTS.get(line.quantity, line.quantity)),
        Field("hypothesis", lambda line: line.hypothesis),
        Field("exponent", lambda line: "" if math.isnan(line.value) else f"{line.value:g}", "number"),
        Field("counts as equal", lambda line: _region(line.rope_low, line.rope_high), "number"),
        Field("probability", lambda line: probability(line.probability), "number"),
    )


def _region(low: float, high: float) -> str:
    ends = (f"{low:g} to {high:g}", f"above {low:g}", f"below {high:g}", "")
    return ends[math.isnan(high) + 2 * math.isnan(low)].replace("-", "−")


def summary_table(summary: pd.DataFrame, variables: Collection[str]) -> Table:
    """The rows of `summary.csv` for ``variables``, without the impacts' own."""

    def ends(line: Any, percent: int) -> str:
        low, high = (getattr(line, f"eti{percent}_{end}") for end in ("low", "high"))
        return interval(low, high, places(line))

    def places(line: Any) -> int:
        return decimals_of(line.eti90_high - line.eti90_low)

    chosen = summary[summary["variable"].isin(variables)]
    noted = "note" in chosen and bool(chosen["note"].ne("").any())
    return table_of(
        lines(chosen),
        Field("variable", lambda line: line.variable),
        Field("label", lambda line: line.label),
        Field("unit", lambda line: line.unit),
        Field("median", lambda line: number(line.median, places(line)), "number"),
        Field("50 %", lambda line: ends(line, 50), "number"),
        Field("90 %", lambda line: ends(line, 90), "number"),
        Field("effective draws", lambda line: number(line.ess_bulk, 0), "number"),
        Field("R̂", lambda line: number(line.r_hat, 3), "number"),
        *[Field("note", lambda line: line.note, "words")] * noted,
    )


def sensitivity_table(sensitivity: pd.DataFrame) -> Table:
    """`sensitivity.csv`: how much each posterior moves when prior or likelihood is weighted up or down."""
    return table_of(
        lines(sensitivity),
        Field("variable", lambda line: line.variable),
        Field("prior", lambda line: number(line.prior, 3), "number"),
        Field("likelihood", lambda line: number(line.likelihood, 3), "number"),
        Field("diagnosis", lambda line: line.diagnosis),
    )


def diagnostics_table(diagnostics: Mapping[str, Any]) -> Table:
    """Every check of the sampler: value, limit, verdict, meaning and next step."""
    return table_of(
        diagnostics["checks"],
        Field("check", lambda check: check["name"]),
        Field("value", lambda check: _plain(check["value"]), "number"),
        Field("limit", lambda check: _plain(check["limit"]), "number"),
        Field("verdict", lambda check: tag("yes", "passed") if check["passed"] else tag("no", "FAILED")),
        Field("what it means", lambda check: check["meaning"], "words"),
        Field("next step", lambda check: check["next_step"] or "", "words"),
        mark=lambda check: "" if check["passed"] else "failed",
    )


def _plain(value: object) -> str:
    return significant(value, 4) if isinstance(value, float) else "" if value is None else str(value)
