"""The regression equations of section 5.4, their figures, and the stepwise selection of Table 5.17."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
import statsmodels.api as sm

from bayestissue.dataset.published import PublishedTables
from bayestissue.thesis.reproduction.agreement import Line, Recomputed, line
from bayestissue.thesis.reproduction.conditions import (
    NEVER_TABULATED,
    QUANTITIES,
    Quantity,
    conditions,
    covariate,
    factors,
    unrounded_mass,
)

ALPHA = 0.05  # the level below which a variable enters


def straight_line(table: pd.DataFrame, mass: pd.Series | None = None) -> Any:
    """Least squares of the averages on mass: average = b0 + b1 M, as statsmodels' results.

    ``mass`` (kg, one per condition) is the printed one unless given.
    """
    mass = table["mass_kg"] if mass is None else mass
    return sm.OLS(table["average"], sm.add_constant(mass.rename("Mass"))).fit()


def candidates(names: Iterable[str], table: pd.DataFrame) -> dict[tuple[str, ...], np.ndarray]:
    """The covariates ``names`` over the conditions of ``table``: products listed twice once, no tissue."""
    values = {factors(name): covariate(name, table) for name in names}
    return {name: x for name, x in values.items() if x is not None}


def select_forward(response: pd.Series, known: dict[tuple[str, ...], np.ndarray]) -> list[tuple[str, ...]]:
    """Forward selection: enter the candidate with the smallest p-value while that is below ``ALPHA``.

    The p-value is that of the candidate's t in the least-squares fit with all entered before it
    (Draper and Smith, Applied Regression Analysis, section 15.2). Returns the names in order of entry.
    """
    entered: list[tuple[str, ...]] = []
    while len(entered) < min(len(known), len(response) - 3):
        p = {
            name: _p_of_last(response, [known[old] for old in (*entered, name)])
            for name in known
            if name not in entered
        }
        best = min(p, key=p.__getitem__)
        if not p[best] < ALPHA:
            break
        entered.append(best)
    return entered


def regression_lines(published: PublishedTables) -> list[Line]:
    """Coefficients and R² of both equations, fitted to the averages of the nine conditions."""
    lines = []
    for quantity in QUANTITIES:
        printed = published.regressions.query("quantity == @quantity")
        recomputed = _equation(conditions(published, quantity), printed)
        lines += [
            line(f"equation of {quantity}", row, f"coefficient of {term}", text, recomputed[term])
            for row, (term, text) in enumerate(
                zip(printed["term"], printed["coefficient_text"], strict=True), start=1
            )
            if term in recomputed
        ]
        text = printed["r_squared_text"].iloc[0]
        lines.append(line(f"equation of {quantity}", len(printed) + 1, "R²", text, recomputed["R²"]))
    return lines


def stepwise_lines(published: PublishedTables) -> list[Line]:
    """Which variables enter, by forward selection at 0.05 on the averages, without skin and muscle."""
    lines = []
    for quantity in QUANTITIES:
        rows = published.stepwise.query("quantity == @quantity")
        table = conditions(published, quantity)
        known = candidates(rows["variable"], table)
        entered = select_forward(table["average"], known)
        lines += [_stepwise_line(row, known, entered) for _, row in rows.iterrows()]
    return lines


@dataclass(frozen=True)
class MassFigure:
    """What figures 5.5 (K) and 5.6 (C) show.

    Attributes:
        impacts: the impacts that remain: ``trial``, ``subject``, ``mass_kg``, ``value``.
        averages: one row per trial: ``trial``, ``mass_kg``, ``average``, ``sd``, ``from_rows`` (false where
            the impacts are lost and the printed average and standard deviation stand in).
        constant, slope: least squares of the averages on mass; slope per kg.
        printed_constant, printed_slope: the thesis's equation without its skin fold term.
    """

    impacts: pd.DataFrame
    averages: pd.DataFrame
    constant: float
    slope: float
    printed_constant: float
    printed_slope: float


def mass_figure(published: PublishedTables, quantity: Quantity) -> MassFigure:
    """K or C against the mass of the pendulum (kg): figures 5.5 and 5.6."""
    table = conditions(published, quantity)
    fit = straight_line(table)
    rows = published.estimates
    printed = published.regressions.query("quantity == @quantity").set_index("term")["coefficient"]
    return MassFigure(
        impacts=rows[["trial", "subject", "mass_kg"]].assign(value=rows[quantity]),
        averages=table.reset_index()[["trial", "mass_kg", "average", "sd", "from_rows"]],
        constant=float(fit.params["const"]),
        slope=float(fit.params["Mass"]),
        printed_constant=float(printed.get("constant", float("nan"))),
        printed_slope=float(printed.get("Mass", float("nan"))),
    )


def _equation(table: pd.DataFrame, printed: pd.DataFrame) -> dict[str, Recomputed]:
    fit, mass, average = straight_line(table), table["mass_kg"], table["average"]
    error = float(np.linalg.norm(table["average_rounding"]))
    spread = float(np.linalg.norm(mass - mass.mean()))
    angle = float(np.arcsin(min(1.0, error / np.linalg.norm(average - average.mean()))))
    extra = [term for term in printed["term"] if term not in ("constant", "Mass")]
    without = f"fitted without {', '.join(extra)}: {NEVER_TABULATED}" if extra else ""
    full = unrounded_mass(table)
    unrounded = None if full is None else straight_line(table, full).params

    def hint(term: str) -> str:
        return "" if unrounded is None else f"{unrounded[term]:.5g} with masses not cut to three decimals"

    of_constant = error * float(np.sqrt(1 / len(mass) + (mass.mean() / spread) ** 2))
    coefficients = {
        "constant": Recomputed(fit.params["const"], of_constant, without, hint("const")),
        "Mass": Recomputed(fit.params["Mass"], error / spread, without, hint("Mass")),
        "R²": Recomputed(fit.rsquared, 2 * angle, without),
    }
    return coefficients | {term: Recomputed(None, note=NEVER_TABULATED) for term in extra}


def _stepwise_line(row: pd.Series, known: dict[tuple[str, ...], Any], entered: list[Any]) -> Line:
    name = f"{row['variable']} in the stepwise regression of {row['quantity']}"
    key = factors(row["variable"])
    if key not in known:
        return Line(row["table"], row["row"], name, row["status"], "", None, NEVER_TABULATED)
    status = "entered" if key in entered else "not entered"
    agreed = status == row["status"]
    note = "" if agreed else f"forward selection at {ALPHA} on the averages, without skin and muscle"
    return Line(row["table"], row["row"], name, row["status"], status, agreed, note)


def _p_of_last(response: pd.Series, columns: list[np.ndarray]) -> float:
    fit = sm.OLS(response.to_numpy(), sm.add_constant(np.column_stack(columns), has_constant="add")).fit()
    return float(fit.pvalues[-1])
