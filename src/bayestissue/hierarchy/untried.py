"""Columns that vary and that no formula is of: how they vary, and the formula of K that has them."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from typing import Any

from bayestissue.errors import Coded
from bayestissue.hierarchy.columns import SETTINGS, USUAL, is_label
from bayestissue.hierarchy.formulas.formula import judge
from bayestissue.hierarchy.formulas.group_terms import quoted
from bayestissue.hierarchy.recorded import Recorded


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
    terms = judge(wanted, recorded.rows, recorded.reference_mass_kg).terms
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
        question = f": does K {difference}? --K {_shell(formula)}"
    return Coded.stated("columns-not-used.one", column=name, varies=column["varies"], question=question)


def _shell(formula: str) -> str:
    return shlex.quote(formula) if set(formula) & set('`"$\\') else f'"{formula}"'
