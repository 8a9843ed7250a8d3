"""What a lab asks of a study: who and what differs, how repeatable K and C are, how methods agree."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from bayestissue.base.errors import Coded
from bayestissue.base.outcomes import REFERENCE_OUTCOMES
from bayestissue.inference.answers.contrasts import ALSO, INTERACTION, LEVELS
from bayestissue.inference.results.meanings import ICC, MDC, MOSTLY, REPEATS, SEM, outcome_name
from bayestissue.recordings.dataset.impact_table import SESSIONS
from bayestissue.reports.pages.fit.fit_run import FitRun
from bayestissue.reports.pages.fit.groups import groupings
from bayestissue.reports.pages.page import worded
from bayestissue.reports.pages.page_settings import LIMITS
from bayestissue.reports.pages.page_tables import Field, Table, shown, table_of, table_of_cells
from bayestissue.reports.pages.posterior import QUANTITIES
from bayestissue.reports.pages.wording import (
    Spread,
    listed,
    number,
    percent,
    significant,
)

# What reaches the body, or what is protected: the outcome of the first screen.
FIRST_OUTCOME = "peak_force"


def first_contrasts(run: FitRun) -> list[dict[str, Any]]:
    """The first comparisons, not of one person's levels: each with K, C and a sentence; empty if none.

    Interactions stand first: where there are some, a difference is another one at another level.
    """
    return [*_first(run, INTERACTION), *_first(run, LEVELS)]


def leading_levels(run: FitRun) -> dict[str, list[str]]:
    """The levels of each factor, those of the lowest peak force first; as the table has them without one."""
    levels = {}
    for factor, rows in run.levels.groupby("factor", sort=False):
        of_force = rows[rows["quantity"] == FIRST_OUTCOME].sort_values("median", kind="stable")
        levels[str(factor)] = list(dict.fromkeys((of_force if len(of_force) else rows)["level"]))
    return levels


def _first(run: FitRun, kind: str) -> list[dict[str, Any]]:
    of_kind = run.contrasts[run.contrasts["kind"] == kind]
    contrasts = []
    # Of several levels the two best: a table beside has them all.
    best = {factor: set(levels[:2]) for factor, levels in leading_levels(run).items() if len(levels) > 2}
    for (factor, level, against), part in of_kind.groupby(["factor", "level", "against"], sort=False):
        shown = part[part["quantity"].isin([q for q in QUANTITIES if q in run.of_tissue])].to_dict("records")
        if not shown or not {str(level), str(against)} <= best.get(str(factor), {str(level), str(against)}):
            continue
        parts = _parted(str(factor), str(level), str(against)) if kind == INTERACTION else None
        in_outcomes = [
            (outcome_name(row["quantity"]), Spread.of(row, "ratio"))
            for row in _of_outcomes(part).to_dict("records")
        ]
        contrasts.append(
            {
                "what": contrast_name(kind, str(factor), str(level), str(against)),
                "kind": kind,
                "rows": {row["quantity"]: row for row in shown},
                "factor": str(factor),
                "ratios": [(row["quantity"], Spread.of(row, "ratio")) for row in shown],
                "outcomes": in_outcomes,
                "first_outcome": in_outcomes[:1],
                "words": worded("fit", "contrast", shown, percent(equivalence(run)), parts, ALSO),
            }
        )
    return contrasts[: LIMITS.comparisons]


def contrast_name(kind: str, factor: str, level: str, against: str) -> str:
    """What is held against what, such as "left over right" or "after over before, treated over control"."""
    if kind == INTERACTION:
        (first, inner), (second, _) = _parted(factor, level, against)
        return f"{inner}, {first} over {second}"
    # A number alone says nothing: session 2 over session 1.
    numbered = not np.isnan(pd.to_numeric(level, errors="coerce"))
    return f"{factor} {level} over {against}" if numbered else f"{level} over {against}"


def _parted(factor: str, level: str, against: str) -> tuple[tuple[str, str], tuple[str, str]]:
    """Of treated:after/before and control:after/before the levels, each with "after over before".

    Of treated:after/before:left, with "after over before, side left".
    """
    ends = (level[at:] for at, letter in enumerate(level) if letter == ":")
    inner = next(end for end in ends if against.endswith(end))[1:]
    ratio, at = inner, ""
    if factor.count(":") > 1:
        ratio, _, third = inner.rpartition(":")
        at = f", {factor.rpartition(':')[2]} {third}"
    over = (ratio.replace("/", " over ") if ratio.count("/") == 1 else ratio) + at
    return tuple((text.removesuffix(f":{inner}"), over) for text in (level, against))  # type: ignore[return-value]


def equivalence(run: FitRun) -> float:
    """The relative difference that counts as none in practice."""
    return float(run.record.get("model", {}).get("practical_equivalence", {}).get("ratio", 0.1))


def contrasts_table(run: FitRun) -> Table:
    """The first 300 rows of `contrasts.csv` that are of no outcome."""
    rows = run.contrasts.drop(_of_outcomes(run.contrasts).index)
    return shown("contrasts", rows[: LIMITS.rows], near=percent(equivalence(run)))


def outcomes_table(run: FitRun) -> Table:
    """The first 300 comparisons in outcomes, those of a comparison side by side."""
    rows = _of_outcomes(run.contrasts)
    if rows.empty:
        return Table()
    by = rows.assign(words=[Spread.of(row, "ratio").words for row in rows.to_dict("records")])
    names = ["factor", "level", "against", "note"]
    wide = by.pivot_table("words", names, "quantity", aggfunc="first", sort=False).reset_index()
    return table_of(
        wide[: LIMITS.rows],
        *_COMPARED,
        *(Field(outcome_name(q), kind="number", of=[str(q)]) for q in dict.fromkeys(rows["quantity"])),
        Field("note", optional=True),
    )


def reference_words(run: FitRun) -> str:
    """The impact whose outcomes are compared."""
    motion = run.contrasts[["mass_kg", "velocity_m_s"]].dropna().drop_duplicates()
    if len(motion) != 1:
        return "an impact"
    return impact_words(*motion.iloc[0])


def impact_words(mass: float, velocity: float) -> str:
    """An impact of a mass [kg] at a velocity [m/s]: "an impact of 0.707 kg at 1.53 m/s"."""
    return f"an impact of {significant(mass)} kg at {significant(velocity)} m/s"


def _of_outcomes(contrasts: pd.DataFrame) -> pd.DataFrame:
    return contrasts[contrasts["quantity"].isin(REFERENCE_OUTCOMES)]


_COMPARED = (Field("of", of=["factor"]), Field("comparison", "over", of=["level", "against"]))


def repeatability(run: FitRun) -> list[tuple[str, list[Spread], Spread | None]]:
    """Of K and of C the least change that shows, all else the same, and the ICC(A,1)."""
    cells = _by_place(run.reliability)
    answers: list[tuple[str, list[Spread], Spread | None]] = []
    for q in QUANTITIES:
        changes = [
            Spread.of(row) for key, row in cells.items() if (key[0], key[1], key[3]) == (q, MDC, _PERCENT)
        ]
        icc = cells.get((q, ICC, "ICC(A,1)", "1"))
        answers.append((q, changes[:1], Spread.of(icc) if icc else None))
    return answers


_PERCENT = "%"


def reliability_table(run: FitRun) -> Table:
    """A row a coefficient, columns of K and C."""
    units = {"N/m": "units", "N s/m": "units"}
    coefficients = run.reliability.assign(unit=run.reliability["unit"].replace(units))
    cells = _by_place(coefficients)
    rows = []
    for measure, form, unit in dict.fromkeys(key[1:] for key in cells):
        pairs = [_cells(cells.get((q, measure, form, unit))) for q in QUANTITIES]
        shown = {"units": "N/m, N s/m", "1": ""}.get(unit, unit)
        rows.append((measure, form, shown, *(text for pair in pairs for text in pair)))
    titles = ("measure", "form", "unit", "K", "K, 90 %", "C", "C, 90 %")
    return table_of_cells(rows, *titles, number=titles[3:], words=titles[:1])


def _by_place(table: pd.DataFrame) -> dict[tuple[str, str, str, str], dict[Any, Any]]:
    """The rows by quantity, measure, form and unit."""
    names = ("quantity", "measure", "form", "unit")
    return {(*(str(row[name]) for name in names),): row for row in table.to_dict("records")}  # type: ignore[misc]


def _cells(row: dict[Any, Any] | None) -> tuple[str, str]:
    if row is None:
        return "", ""
    coefficient = Spread.of(row)
    if row["measure"] == REPEATS:
        return _whole(coefficient.median), f"{_whole(coefficient.low)} to {_whole(coefficient.high)}"
    if coefficient.low == coefficient.high:
        return number(coefficient.median, 2), "taken as known"
    return coefficient.value, f"{coefficient.range}{', largely prior' if _largely_prior(row) else ''}"


def _largely_prior(row: dict[Any, Any]) -> bool:
    return bool(row["prior_overlap"] > MOSTLY)


def largely_prior(run: FitRun) -> list[tuple[list[str], list[str], bool]]:
    """Which coefficients the data leave largely as the prior has them, and by how much; empty where none.

    Last, whether consistency is among them: agreement alone is no wonder where conditions are few.
    """
    rows = [
        row
        for row in run.reliability.to_dict("records")
        if row["measure"] == ICC or (row["measure"] == SEM and row["unit"] == _PERCENT)
    ]
    vague = [row for row in rows if _largely_prior(row)]
    overlaps = [percent(end(row["prior_overlap"] for row in vague)) for end in (min, max) if vague]
    consistent = any(row["form"].startswith(("ICC(C", "consistency")) for row in vague)
    return [([_name(row) for row in vague], list(dict.fromkeys(overlaps)), consistent)] if vague else []


def _name(row: dict[Any, Any]) -> str:
    form = str(row["form"]).split(", k")[0]
    return f"{form if row['measure'] == ICC else f'{SEM} ({form})'} of {row['quantity']}"


def _whole(value: float) -> str:
    return number(value, 0) if np.isfinite(value) else "no number"


def measurement_errors(run: FitRun) -> list[tuple[str, list[float], list[str], list[list[Spread]]]]:
    """Of K and of C the errors of one measurement in percent, of the chain and of the person; and changes.

    Last ICC(C,1), ICC(A,1) and the repeats for an ICC(A,k) of 0.9, where there are any.
    """
    cells = _by_place(run.reliability)
    errors: list[tuple[str, list[float], list[str], list[list[Spread]]]] = []
    for q in dict.fromkeys(key[0] for key in cells if key[0] in QUANTITIES):
        chain, person = (cells[q, SEM, form, _PERCENT]["median"] for form in ("measuring chain", "person"))
        forms = [(ICC, "ICC(C,1)"), (ICC, "ICC(A,1)"), (REPEATS, "ICC(A,k) of 0.9")]
        has_icc = (q, *forms[1], "1") in cells
        icc = [[Spread.of(cells[q, measure, form, "1"]) for measure, form in forms]] if has_icc else []
        errors.append((q, [chain, person], _changes(cells, q), icc))
    return errors


def _changes(cells: dict[tuple[str, str, str, str], dict[Any, Any]], q: str) -> list[str]:
    """The minimal detectable changes, each with what may vary between the two measurements."""
    changes: dict[str, str] = {}
    for (quantity, measure, form, unit), row in cells.items():
        if (quantity, measure, unit) == (q, MDC, _PERCENT):
            change, varied = Spread.of(row), row["varies"].split(", ") if row["varies"] else []
            where = f"where {listed(varied)} may differ" if varied else "all else the same"
            _, between, means = form.partition(", ")
            words = f"{change.value}\N{NO-BREAK SPACE}% ({change.range})"
            changes.setdefault(f"{where}{' between ' if between else ''}{means}", words)
    return [f"{words} {where}" for where, words in changes.items()]


def another_day(run: FitRun) -> str:
    """The warning that repeats of one session say nothing of another day; empty where it does not apply."""
    if run.reliability.empty or any(
        word in grouping.lower() for grouping in groupings(run) for word in SESSIONS
    ):
        return ""
    return Coded.stated("one-session")
