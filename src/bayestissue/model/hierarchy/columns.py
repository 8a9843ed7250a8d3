"""What a column of the impacts may be; and those that vary and that no formula is of, to be tried."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import pandas as pd

from bayestissue.base.errors import Coded
from bayestissue.model.hierarchy.formulas.formula import resolve
from bayestissue.model.hierarchy.formulas.group_terms import labels_of, quoted
from bayestissue.model.hierarchy.recorded import Recorded
from bayestissue.recordings.dataset.cells import HEIGHTS
from bayestissue.recordings.dataset.impact_table import REFERENCE, RESERVED

# What every study has, and what `bayestissue init` fills besides: counts of repeats, and heights of drops.
USUAL = (
    *("subject", "trial", "mass_kg", "velocity_m_s", "energy_J", "diameter_m", "sampling_rate_hz"),
    *(*REFERENCE, "n", "repeat", *HEIGHTS),
)
_DATE = r"(19|20)\d{6}|\d{4}-\d\d?-\d\d?([T ].*)?|\d\d?[./]\d\d?[./]\d{2,4}( .*)?|\d\d?:\d\d(:\d\d.*)?"


@dataclass(frozen=True)
class ColumnSettings:
    """How a column is judged by its values.

    Attributes:
        categories: so many different values at the most are categories: more whole numbers are no codes, and
            of more texts a group has an effect for each, where fewer are a covariate. As many as a person
            has fingers and conditions of a trial seldom exceed.
        codes: so many at the least: two whole numbers make the same effect as two categories.
        repeated: a label stands on average in so many impacts at the least, or it is a mere label.
    """

    categories: int = 6
    codes: int = 3
    repeated: int = 2


SETTINGS = ColumnSettings()


def few_valued(rows: pd.DataFrame) -> dict[str, list[str]]:
    """The columns, and their values, that may be codes: few whole numbers, and no count."""
    known = {
        str(name): rows[name].dropna()
        for name in rows
        if name not in (*USUAL, *RESERVED) and pd.api.types.is_numeric_dtype(rows[name])
    }
    return {
        name: labels_of(values.drop_duplicates().sort_values()).tolist()
        for name, values in known.items()
        if SETTINGS.codes <= values.nunique() <= SETTINGS.categories and (values % 1 == 0).all()
    }


def is_label(column: pd.Series) -> bool:
    """Whether a column tells impacts apart and no more: a name or a remark of nearly each, or a date."""
    labels = pd.Series(labels_of(column))
    if labels.str.fullmatch(_DATE).all():
        return True
    counted = not pd.api.types.is_numeric_dtype(column) or pd.api.types.is_integer_dtype(column)
    return counted and labels.nunique() > max(len(labels) / SETTINGS.repeated, SETTINGS.repeated)


def not_used(recorded: Recorded) -> list[str]:
    """The columns that vary and that no formula is of, besides what every study has, and mere labels."""
    others = [name for name in map(str, recorded.rows) if name not in (*USUAL, *recorded.needed)]
    return [n for n in others if len(recorded.levels(n)) > 1 and not is_label(recorded.rows[n])]


def untried(recorded: Recorded) -> list[dict[str, Any]]:
    """Each ``column``, how it ``varies``, and ``formula``: K's with it, less what the rows can't tell.

    The formula is empty where the rows can't tell what the column does.
    """
    return [_tried(recorded, name) for name in not_used(recorded)]


def _tried(recorded: Recorded, name: str) -> dict[str, Any]:
    if number := not recorded.is_category(name):
        low, high = recorded.rows[name].min(), recorded.rows[name].max()
        varies, term = f"{low:.4g} to {high:.4g}", quoted([name])
    else:
        count = len(recorded.levels(name))
        varies, term = f"{count} levels", quoted([name])
        term = f"(1|{term})" if count > SETTINGS.categories else term
    wanted = f"{recorded.formulas.get('K', '1')} + {term}"
    terms = resolve(wanted, recorded.rows, recorded.reference_mass_kg).terms
    accepted = term in (*terms.common, *map(str, terms.groups))
    return {"column": name, "number": number, "varies": varies, "formula": str(terms) if accepted else ""}


def untried_words(columns: Sequence[Mapping[str, Any]], shown: int = 4) -> list[str]:
    """A question for each of the first columns, with the formula to try."""
    words = [_question(column) for column in columns[:shown]]
    if further := [str(column["column"]) for column in columns[shown:]]:
        words.append(Coded.stated("columns-not-used.further", columns=", ".join(further)))
    return words


def _question(column: Mapping[str, Any]) -> str:
    name, formula = column["column"], column["formula"]
    question = ": what differs there counts as scatter between impacts."
    if formula:
        difference = f"change with {name}" if column["number"] else f"differ by {name}"
        argument = shlex.quote(formula) if set(formula) & set('`"$\\') else f'"{formula}"'
        question = f": does K {difference}? --K {argument}"
    return Coded.stated("columns-not-used.one", column=name, varies=column["varies"], question=question)
