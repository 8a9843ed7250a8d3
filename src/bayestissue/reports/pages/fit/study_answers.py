"""What a lab asks of a study: who and what differs, how repeatable K and C are, how methods agree."""

from __future__ import annotations

from dataclasses import astuple
from typing import Any

import numpy as np
import pandas as pd

from bayestissue.base.errors import Coded
from bayestissue.base.outcome_table import REFERENCE_OUTCOMES
from bayestissue.inference.answers.contrasts import ALSO, INTERACTION, LEVELS
from bayestissue.inference.results.meanings import ICC, MDC, MOSTLY, REPEATS, SEM, outcome_name
from bayestissue.recordings.dataset.impact_table import SESSIONS
from bayestissue.reports.pages.fit.fit_run import FitRun, groupings
from bayestissue.reports.pages.page import worded
from bayestissue.reports.pages.page_settings import LIMITS
from bayestissue.reports.pages.page_tables import Field, Table, shown, table_of, table_of_cells
from bayestissue.reports.pages.posterior import QUANTITIES
from bayestissue.reports.pages.wording import Spread, listed, number, percent, significant

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
    for place, part in of_kind.groupby(["factor", "level", "against"], sort=False):
        factor, level, against = map(str, place)
        shown = part[part["quantity"].isin([q for q in QUANTITIES if q in run.of_tissue])].to_dict("records")
        if not shown or not {level, against} <= best.get(factor, {level, against}):
            continue
        parts = _parted(factor, level, against) if kind == INTERACTION else None
        contrasts.append(
            {
                "what": contrast_name(kind, factor, level, against),
                "kind": kind,
                "rows": {row["quantity"]: row for row in shown},
                "factor": factor,
                "ratios": [(row["quantity"], Spread.of(row, "ratio")) for row in shown],
                "outcomes": [
                    (outcome_name(row["quantity"]), Spread.of(row, "ratio"))
                    for row in _of_outcomes(part).to_dict("records")
                ],
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


_PERCENT = "%"


def _coefficients(
    run: FitRun, quantity: str, measure: str, unit: str = "1", form: str = ""
) -> list[dict[Any, Any]]:
    """The rows of a measure of K or C in a unit, of one ``form`` unless it is empty."""
    rows = run.reliability
    chosen = (rows["quantity"] == quantity) & (rows["measure"] == measure) & (rows["unit"] == unit)
    return rows[chosen & ((rows["form"] == form) | (not form))].to_dict("records")


def _spreads(run: FitRun, *which: str) -> list[Spread]:
    return [Spread.of(row) for row in _coefficients(run, *which)]


def repeatability(run: FitRun) -> list[tuple[str, list[Spread], list[Spread]]]:
    """Of K and of C the least change that shows, all else the same, and the ICC(A,1), where there is one."""
    return [
        (q, _spreads(run, q, MDC, _PERCENT)[:1], _spreads(run, q, ICC, "1", "ICC(A,1)")) for q in QUANTITIES
    ]


def reliability_table(run: FitRun) -> Table:
    """A row a coefficient, columns of K and C."""
    units = {"N/m": "N/m, N s/m", "N s/m": "N/m, N s/m", "1": ""}
    coefficients = run.reliability.assign(unit=run.reliability["unit"].replace(units))
    rows = []
    for group, part in coefficients.groupby(["measure", "form", "unit"], sort=False):
        by_quantity = part.set_index("quantity", drop=False).to_dict("index")
        rows.append((*group, *(text for q in QUANTITIES for text in _cells(by_quantity.get(q)))))
    titles = ("measure", "form", "unit", "K", "K, 90 %", "C", "C, 90 %")
    return table_of_cells(rows, *titles, number=titles[3:], words=titles[:1])


def _cells(row: dict[Any, Any] | None) -> tuple[str, str]:
    if row is None:
        return "", ""
    coefficient = Spread.of(row)
    if row["measure"] == REPEATS:
        median, low, high = (
            number(value, 0) if np.isfinite(value) else "no number" for value in astuple(coefficient)
        )
        return median, f"{low} to {high}"
    if coefficient.low == coefficient.high:
        return number(coefficient.median, 2), "taken as known"
    return (
        coefficient.value,
        f"{coefficient.range}{', largely prior' if row['prior_overlap'] > MOSTLY else ''}",
    )


def largely_prior(run: FitRun) -> list[tuple[list[str], list[str], bool]]:
    """Which coefficients the data leave largely as the prior has them, and by how much; empty where none.

    Last, whether consistency is among them: agreement alone is no wonder where conditions are few.
    """
    rows = run.reliability
    errors = (rows["measure"] == SEM) & (rows["unit"] == _PERCENT)
    vague = rows[((rows["measure"] == ICC) | errors) & (rows["prior_overlap"] > MOSTLY)]
    if vague.empty:
        return []
    forms = vague["form"].str.split(", k").str[0]
    named = forms.where(vague["measure"] == ICC, f"{SEM} (" + forms + ")") + " of " + vague["quantity"]
    overlaps = dict.fromkeys(map(percent, vague["prior_overlap"].agg(["min", "max"])))
    return [(list(named), list(overlaps), vague["form"].str.startswith(("ICC(C", "consistency")).any())]


def measurement_errors(run: FitRun) -> list[tuple[str, list[float], list[str], list[list[Spread]]]]:
    """Of K and of C the errors of one measurement in percent, of the chain and of the person; and changes.

    Last ICC(C,1), ICC(A,1) and the repeats for an ICC(A,k) of 0.9, where there are any.
    """
    forms = ((ICC, "ICC(C,1)"), (ICC, "ICC(A,1)"), (REPEATS, "ICC(A,k) of 0.9"))
    errors = []
    for q in run.reliability["quantity"].unique():
        if q in QUANTITIES:
            alone = [
                _spreads(run, q, SEM, _PERCENT, form)[0].median for form in ("measuring chain", "person")
            ]
            icc = [one for measure, form in forms for one in _spreads(run, q, measure, "1", form)]
            errors.append((q, alone, _changes(run, q), [icc] * bool(icc)))
    return errors


def _changes(run: FitRun, q: str) -> list[str]:
    """The minimal detectable changes, each with what may vary between the two measurements."""
    changes: dict[str, str] = {}
    for row in _coefficients(run, q, MDC, _PERCENT):
        change, varied = Spread.of(row), row["varies"].split(", ") if row["varies"] else []
        where = f"where {listed(varied)} may differ" if varied else "all else the same"
        _, between, means = row["form"].partition(", ")
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
