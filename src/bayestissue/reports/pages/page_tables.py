"""Tables as a template wants them; those of settings, priors and a posterior that several pages have."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
from types import MappingProxyType
from typing import Any, NamedTuple

import pandas as pd
from markupsafe import Markup

from bayestissue.base.declarations import declared, filled
from bayestissue.base.outline import markdown_rows, numbers_in_short
from bayestissue.base.results.tables import declared_files
from bayestissue.inference.results.meanings import SECANTS, heading_words
from bayestissue.reports.pages.wording import (
    Spread,
    decimals_of,
    estimated,
    interval,
    number,
    percent,
    probability,
    significant,
    with_error,
)


@dataclass(frozen=True)
class Field:
    """A column, and what makes its cell of a row of the data.

    Attributes:
        title: its heading.
        form: how the values are written that the row has in the columns ``of``: see `form_words`. Or what
            makes the cell of the row.
        kind: how cells are set: ``"text"``, ``"number"`` (to the right) or ``"words"``, which may grow wide;
            that of the form unless given.
        of: that of the title unless given.
        missing: what stands where all of these values are missing.
        optional: whether the column is left out where all of its cells are empty.
    """

    title: str
    form: str | Callable[[Any], str] = "text"
    kind: str = ""
    of: Sequence[str] = ()
    missing: str = ""
    optional: bool = False

    def text(self, row: Any) -> str:
        """The cell of a row."""
        if callable(self.form):
            return self.form(row)
        values = [row[column] for column in self.of or (self.title,)]
        return self.missing if all(map(pd.isna, values)) else form_words(self.form)(*values)

    @property
    def column(self) -> Column:
        """Its heading, and how its cells are set."""
        of_texts = dict.fromkeys(_TEXTS, "text") | {"words": "words"}
        of_form = "text" if callable(self.form) else of_texts.get(self.form, "number")
        return Column(self.title, self.kind or of_form)


class Column(NamedTuple):
    """A heading and how its cells are set: see `Field`."""

    title: str
    kind: str = "text"


class Row(NamedTuple):
    """The cells of one row; ``mark`` is a class of the style sheet, such as ``"disagrees"``."""

    cells: Sequence[str]
    mark: str = ""


class Table(NamedTuple):
    """A whole table; cells are text, or `Markup` where they hold more than text."""

    columns: Sequence[Column] = ()
    rows: Sequence[Row] = ()

    def markdown(self) -> list[str]:
        """Its lines in Markdown."""
        return markdown_rows(tuple(column.title for column in self.columns), (row.cells for row in self.rows))


def table_of(
    rows: Iterable[Any] | pd.DataFrame, *fields: Field, mark: Callable[[Any], str] = lambda row: ""
) -> Table:
    """A table with a row for each of ``rows``, and a cell in it for each of ``fields``."""
    rows = rows.to_dict("records") if isinstance(rows, pd.DataFrame) else list(rows)
    used = [field for field in fields if not field.optional or any(field.text(row) for row in rows)]
    return Table(
        [field.column for field in used],
        [Row(tuple(field.text(row) for field in used), mark(row)) for row in rows],
    )


def table_of_cells(
    rows: Iterable[Sequence[str]], *titles: str, number: Sequence[str] = (), words: Sequence[str] = ()
) -> Table:
    """A table of cells; columns in ``number`` are set to the right, those in ``words`` may grow wide."""
    kinds = dict.fromkeys(number, "number") | dict.fromkeys(words, "words")
    return Table([Column(title, kinds.get(title, "text")) for title in titles], [Row(row) for row in rows])


def _region(low: float, high: float) -> str:
    ends = (f"{low:g} to {high:g}", f"above {low:g}", f"below {high:g}", "")
    return ends[math.isnan(high) + 2 * math.isnan(low)].replace("-", "−")


# How a cell of a declared table is written, of the columns that it is made of; see also `form_words`.
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
    "%": percent,
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
    # At a terminal, without exponents.
    "median": lambda *ends: estimated(*ends)[0],
    "from": lambda *ends: estimated(*ends)[1].replace("nan", ""),
    "to": lambda *ends: estimated(*ends)[2].replace("nan", ""),
    "range": lambda *ends: Spread(*ends).range,
}


@cache
def form_words(form: str) -> Callable[..., str]:
    """What writes a form: digits as "3", decimals as ".3", "± .2" with an error, or "{:g} %", in braces."""
    if form in _TEXTS or form in _NUMBERS:
        return (_TEXTS | _NUMBERS)[form]
    if "{" in form:
        return partial(filled, form)
    if form.startswith("± "):
        return partial(with_error, decimals=int(form.removeprefix("± .")))
    if form.startswith("."):
        return partial(number, decimals=int(form[1:]))
    return partial(significant, digits=int(form))


def shown(
    name: str,
    rows: pd.DataFrame,
    view: str = "shown",
    *,
    fields: Mapping[str, Field] = MappingProxyType({}),
    mark: Callable[[Any], str] = lambda row: "",
    **values: str,
) -> Table:
    """A table as it is declared to be shown, without columns that ``rows`` lack.

    Args:
        name: of a file of a result folder, without suffix, or of a table of ``page_tables.toml``.
        rows: of the table.
        view: its name, of a table that looks otherwise here or there.
        fields: in the place of some that are declared, by their names.
        mark: of a row, as of `Row`.
        **values: what stands in braces in titles.
    """
    looks = _looks(name, view)
    present = [column for column in looks if set(looks[column]["of"]) <= set(rows)]
    stated = zip(present, declared_fields(name, present, view, **values), strict=True)
    return table_of(rows, *(fields.get(column, field) for column, field in stated), mark=mark)


def declared_fields(name: str, columns: Iterable[str], view: str = "shown", **values: str) -> list[Field]:
    """Columns of the table ``name`` as they are declared to be shown; see `shown`."""
    looks = _looks(name, view)
    return [
        Field(**looks[column] | {"title": filled(looks[column]["title"], **values)}) for column in columns
    ]


def _looks(name: str, view: str) -> dict[str, dict[str, Any]]:
    if of_page := _OF_PAGES.get(name):
        return {column: {"title": column, "of": [column]} | look for column, look in of_page.items()}
    return declared_files()[f"{name}.csv"].looks[view]


def frame_table(frame: pd.DataFrame, digits: int = 4) -> Table:
    """Every column of ``frame`` under its own name, numbers to the right and with so many digits."""
    numbers = [str(name) for name in frame if pd.api.types.is_numeric_dtype(frame[name])]
    rows = [
        [cell if isinstance(cell, str) else f"{cell:.{digits}g}" for cell in row]
        for row in frame.itertuples(index=False, name=None)
    ]
    return table_of_cells(rows, *map(str, frame), number=numbers)


def over(*words: str) -> Markup:
    """Words, and others in grey under them; nothing of none."""
    return Markup('{}<br><span class="muted">{}</span>').format(*words) if words else Markup()


def tag(kind: str, words: str) -> Markup:
    """``words`` as a small coloured label; ``kind`` is a class of the style sheet, such as ``"major"``."""
    return Markup('<span class="tag {}">{}</span>').format(kind, words)


def settings_table(content: Mapping[str, Any], shown_elsewhere: Collection[str] = ()) -> Table:
    """Every key of ``content`` and its value, one a row; inner tables' keys are joined with a dot.

    The top-level keys in ``shown_elsewhere`` are left out.
    """
    remaining = {key: value for key, value in content.items() if key not in shown_elsewhere}
    return table_of_cells(_flat(remaining), "setting", "value", words=("value",))


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


# Tables of pages that are in no file, as ``tables.toml`` has the looks of those that are.
_OF_PAGES = declared(__package__, "page_tables.toml")
_MEANINGS = declared(__package__, "priors.toml")
SHOWN_ELSEWHERE = ("name", "description", "formula", "priors")


def priors_table(model: Mapping[str, Any], unused: Collection[str] = ()) -> Table:
    """Every prior but the ``unused``: of what, for which quantity, and the distribution in words."""
    rows = [
        (name, _MEANINGS.get(name, ""), quantity, distribution)
        for name, prior in dict(model.get("priors", {})).items()
        if name not in unused
        for quantity, distribution in _distributions(prior)
    ]
    return table_of_cells(rows, "parameter", "meaning", "quantity", "prior", words=("meaning",))


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


def diagnostics_table(diagnostics: Mapping[str, Any]) -> Table:
    """Every check of the sampler: value, limit, verdict, meaning and next step."""
    return table_of(
        diagnostics["checks"],
        Field("check", of=["name"]),
        Field("value", lambda check: _plain(check["value"]), "number"),
        Field("limit", lambda check: _plain(check["limit"]), "number"),
        Field("verdict", lambda check: tag("yes", "passed") if check["passed"] else tag("no", "FAILED")),
        Field("what it means", "words", of=["meaning"]),
        Field("next step", lambda check: check["next_step"] or "", "words"),
        mark=lambda check: "" if check["passed"] else "failed",
    )


def _plain(value: object) -> str:
    return significant(value, 4) if isinstance(value, float) else "" if value is None else str(value)
