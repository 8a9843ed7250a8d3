"""Tables as a template wants them; those of settings, priors and a posterior that several pages have."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from types import MappingProxyType
from typing import Any

import pandas as pd
from markupsafe import Markup

from bayestissue.base.declarations import declared, filled
from bayestissue.base.outline import markdown_rows, numbers_in_short
from bayestissue.base.results.tables import ShownColumn, declared_files
from bayestissue.inference.results.meanings import SECANTS, heading_words
from bayestissue.reports.pages.wording import (
    Spread,
    decimals,
    decimals_of,
    digits,
    interval,
    number,
    probability,
    significant,
    with_error,
)


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

    def markdown(self) -> list[str]:
        """Its lines in Markdown."""
        return markdown_rows(tuple(column.title for column in self.columns), (row.cells for row in self.rows))


@dataclass(frozen=True)
class Field:
    """A column with what makes its cell of a row of the data; ``kind`` as of `Column`.

    That is a function of the row, or the name of what the row has there, which is the title unless given.
    Where it is ``optional`` it is left out if all its cells are empty.
    """

    title: str
    cell: Callable[[Any], str] | str = ""
    kind: str = "text"
    optional: bool = False

    def text(self, row: Any) -> str:
        """The cell of a row."""
        return str(row[self.cell or self.title]) if isinstance(self.cell, str) else self.cell(row)


def number_field(
    title: str, column: str = "", words: Callable[[float], str] = significant, missing: str = ""
) -> Field:
    """A column of numbers in words; ``missing`` where a row lacks its number."""

    def cell(row: Any) -> str:
        value = row[column or title]
        return missing if pd.isna(value) else words(value)

    return Field(title, cell, "number")


def table_of(
    rows: Iterable[Any] | pd.DataFrame,
    *fields: Field,
    mark: Callable[[Any], str] = lambda row: "",
) -> Table:
    """A table with a row for each of ``rows``, and a cell in it for each of ``fields``."""
    rows = rows.to_dict("records") if isinstance(rows, pd.DataFrame) else list(rows)
    used = [field for field in fields if not field.optional or any(field.text(row) for row in rows)]
    return Table(
        [Column(field.title, field.kind) for field in used],
        [Row(tuple(field.text(row) for field in used), mark(row)) for row in rows],
    )


def _region(low: float, high: float) -> str:
    ends = (f"{low:g} to {high:g}", f"above {low:g}", f"below {high:g}", "")
    return ends[math.isnan(high) + 2 * math.isnan(low)].replace("-", "−")


# How a cell of a declared table is written, of the columns that it is made of; see also `_words_of`.
_TEXTS: dict[str, Callable[..., str]] = {
    "text": str,
    "words": str,
    "name": lambda name: name.replace("_", " "),
    "quantity": lambda name: str(SECANTS.get(name, name)),
    "heading": heading_words,
    "unit": lambda unit: "" if unit == "1" else unit,
    "scheme": lambda scheme: scheme.removeprefix("leave one ").removesuffix(" out"),
    "over": "{} over {}".format,
    "passed": lambda passed: "yes" if passed else "NO",
    "numbers": lambda text: numbers_in_short(text.split()),
}
_NUMBERS: dict[str, Callable[..., str]] = {
    "g": "{:g}".format,
    "p": probability,
    "± %": lambda share, se: f"{100 * share:.1f} ± {100 * se:.1f} %",
    "hours": lambda minutes: significant(minutes / 60, 2),
    "printed": str,
    "ends": lambda low, high: " to ".join(dict.fromkeys((f"{low:g}", f"{high:g}"))),
    "region": _region,
    "interval": interval,
    # With the digits that the interval deserves which the last two columns are.
    "value": lambda value, low, high: number(value, decimals_of(high - low)),
    "within": lambda low, high, *ends: interval(low, high, decimals_of(ends[1] - ends[0])),
    "spread": lambda *ends: Spread(*ends).value,
    "range": lambda *ends: Spread(*ends).range,
}


def _words_of(form: str) -> Callable[..., str]:
    """What writes a form that is declared: digits as "3", decimals as ".3", or "± .2" with an error."""
    if form in _TEXTS or form in _NUMBERS:
        return (_TEXTS | _NUMBERS)[form]
    if form.startswith("± "):
        return partial(with_error, decimals=int(form.removeprefix("± .")))
    return decimals(int(form[1:])) if form.startswith(".") else digits(int(form))


def shown(
    name: str,
    rows: pd.DataFrame,
    only: Collection[str] = (),
    *,
    fields: Mapping[str, Field] = MappingProxyType({}),
    mark: Callable[[Any], str] = lambda row: "",
    **values: str,
) -> Table:
    """A table of a result folder as it is declared to be shown, without columns that ``rows`` lack.

    Args:
        name: of its file, without suffix.
        rows: of the table.
        only: the columns that are shown, in this order; all unless given.
        fields: in the place of some that are declared, by their names.
        mark: of a row, as of `Row`.
        **values: what stands in braces in titles.
    """
    looks = declared_files()[f"{name}.csv"].looks
    present = [column for column in only or looks if set(looks[column].of) <= set(rows)]
    declared = zip(present, declared_fields(name, present, **values), strict=True)
    return table_of(rows, *(fields.get(column, field) for column, field in declared), mark=mark)


def declared_fields(name: str, columns: Iterable[str], **values: str) -> list[Field]:
    """Columns of the table ``name`` as they are declared to be shown; see `shown`."""
    looks = declared_files()[f"{name}.csv"].looks
    return [_field(looks[column], values) for column in columns]


def _field(look: ShownColumn, values: Mapping[str, str]) -> Field:
    words = _words_of(look.form)

    def cell(row: Any) -> str:
        cells = [row[column] for column in look.of]
        return look.missing if all(map(pd.isna, cells)) else words(*cells)

    kind = "words" if look.form == "words" else "text" if look.form in _TEXTS else "number"
    return Field(filled(look.title, **values), cell, kind, look.optional)


def columns(*titles: str, number: Sequence[str] = (), words: Sequence[str] = ()) -> tuple[Column, ...]:
    """One column a title; those in ``number`` are set to the right, those in ``words`` may grow wide."""
    return tuple(
        Column(title, "number" if title in number else "words" if title in words else "text")
        for title in titles
    )


def frame_table(frame: pd.DataFrame, words: Callable[[Any], str]) -> Table:
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


def summary_table(summary: pd.DataFrame, variables: Collection[str]) -> Table:
    """The rows of `summary.csv` for ``variables``, without the impacts' own."""
    return shown("summary", summary[summary["variable"].isin(variables)])


def diagnostics_table(diagnostics: Mapping[str, Any]) -> Table:
    """Every check of the sampler: value, limit, verdict, meaning and next step."""
    return table_of(
        diagnostics["checks"],
        Field("check", "name"),
        Field("value", lambda check: _plain(check["value"]), "number"),
        Field("limit", lambda check: _plain(check["limit"]), "number"),
        Field("verdict", lambda check: tag("yes", "passed") if check["passed"] else tag("no", "FAILED")),
        Field("what it means", "meaning", "words"),
        Field("next step", lambda check: check["next_step"] or "", "words"),
        mark=lambda check: "" if check["passed"] else "failed",
    )


def _plain(value: object) -> str:
    return significant(value, 4) if isinstance(value, float) else "" if value is None else str(value)
