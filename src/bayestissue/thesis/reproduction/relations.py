"""How K and C go with the conditions: Tables 5.12 to 5.17, figures 5.1 to 5.6 and the equations of 5.4."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
from scipy import stats
from statsmodels.regression.linear_model import OLS
from statsmodels.tools.tools import add_constant

from bayestissue.recordings.dataset.published import PublishedTables
from bayestissue.thesis.reproduction.agreement import PublishedNumber, Recomputed, half_unit, line, line_of
from bayestissue.thesis.reproduction.conditions import (
    NEVER_TABULATED,
    QUANTITIES,
    Quantity,
    conditions,
    covariate,
    factors,
    rounding_norm,
    sum_of_squares,
    unrounded_mass,
)

ALPHA = 0.05  # the level below which a variable enters
ALL_IMPACTS: dict[str, Quantity] = {"5.12": "K", "5.13": "C"}
AVERAGED_TABLES: dict[Quantity, str] = {"K": "5.14", "C": "5.15"}
_LOST_TABLE = "the body of Table 5.13 is lost"


def correlation_of_averages(name: str, table: pd.DataFrame) -> Recomputed:
    """Pearson's r between a covariate and the averages of the conditions (Tables 5.14 and 5.15).

    The averages are taken as the only impact of their condition each; see `correlation_of_impacts`.
    """
    r = correlation_of_impacts(name, table.assign(impacts=1))
    if r.value is not None:
        return r
    # The same ten people were hit in every condition, so their average thickness can't vary.
    return replace(
        r, note=f"{NEVER_TABULATED}; over the same ten people their averages can't differ between trials"
    )


def correlation_of_impacts(name: str, table: pd.DataFrame) -> Recomputed:
    """Pearson's r between a covariate and all impacts, lost ones included (Tables 5.12 and 5.13).

    Within a condition the covariate is constant, so impacts enter through their averages and through the
    sum of squares within the conditions only:
    r = Σ n (x - x̄)(average - ȳ) / √(Σ n (x - x̄)² · (SS_between + SS_within)).

    r is the cosine of the angle between the two centred vectors. Moving one by an error of norm e turns it
    by at most arcsin(e / its norm), and a cosine changes no faster than its angle: this is ``rounding``.
    """
    x = covariate(name, table)
    if x is None:
        return Recomputed(None, note=NEVER_TABULATED)
    n, y = table["impacts"].to_numpy(float), table["average"].to_numpy()
    deviation = x - np.average(x, weights=n)
    total = sum_of_squares(table)
    r = float((n * deviation * (y - np.average(y, weights=n))).sum())
    r /= float(np.sqrt((n * deviation**2).sum() * total))
    return Recomputed(r, rounding=_angle(rounding_norm(table), float(np.sqrt(total))))


def correlations_of_impacts(published: PublishedTables, table: pd.DataFrame) -> pd.DataFrame:
    """``r`` of all impacts with each variable of Table 5.12 that can be recomputed, and its p-value ``p``.

    By variable, the greatest |r| first; see `correlation_of_impacts`.
    """
    rows, n = published.correlations, float(table["impacts"].sum())
    names = rows.loc[rows["table"] == "5.12", "variable"]
    recomputed = {name: correlation_of_impacts(name, table).value for name in names}
    r = pd.Series(recomputed, dtype="float64").dropna()
    falling = r.abs().sort_values(ascending=False).index
    return pd.DataFrame({"r": r, "p": [p_value(value, n) for value in r]}).loc[falling]


def p_value(r: float, n: float) -> float:
    """Two-sided p-value of Pearson's ``r`` of ``n`` pairs: t = r √((n-2)/(1-r²)) with n - 2 degrees."""
    if abs(r) >= 1:
        return 0.0
    return float(2 * stats.t.sf(abs(r) * np.sqrt((n - 2) / (1 - r * r)), n - 2))


def correlation_lines(published: PublishedTables) -> Iterator[PublishedNumber]:
    """Every correlation and p-value of Tables 5.12 to 5.15; the lost Table 5.13 is filled in."""
    tables: dict[str, pd.DataFrame] = {quantity: conditions(published, quantity) for quantity in QUANTITIES}
    for quantity in ALL_IMPACTS.values():
        for _, row in variables_of_all_impacts(published, quantity).iterrows():
            yield from _impact_lines(row, tables[quantity])
    averaged = published.correlations[~published.correlations["table"].isin(ALL_IMPACTS)]
    for _, row in averaged.iterrows():
        name = f"correlation of {row['quantity']} with {row['variable']}, averages"
        recomputed = correlation_of_averages(row["variable"], tables[row["quantity"]])
        yield line_of(row, "correlation", name, recomputed)


def variables_of_all_impacts(published: PublishedTables, quantity: Quantity) -> pd.DataFrame:
    """The rows of Table 5.12, or those that the lost Table 5.13 must have had.

    The latter are the variables of Table 5.12; printed text is empty but for the correlations that the
    running text of section 5.3 gives.
    """
    rows = published.correlations
    variables = rows[(rows["table"] == "5.12") & (rows["quantity"] == "K")]
    if quantity == "K":
        return variables
    claims = published.claims.query("section == '5.3' and quantity == @quantity")
    said = dict(zip(claims["statistic"], claims["value_text"], strict=True))
    return variables.assign(
        table="5.13",
        quantity=quantity,
        correlation_text=[said.get(f"correlation with {name}", "") for name in variables["variable"]],
        p_value_text="",
    )


def correlation_figure(published: PublishedTables, quantity: Quantity, *, averages: bool) -> pd.DataFrame:
    """Absolute correlations in falling order: figures 5.1 (K), 5.2 (C), with averages 5.3 (K), 5.4 (C).

    Columns: ``variable`` as the thesis writes it, ``correlation`` recomputed (NaN for skin and muscle, which
    were never tabulated), ``published`` (NaN where the cell is lost), and ``absolute``, which is that of the
    recomputed number, or else of the published one. Variables with neither are left out, and a product that
    the thesis lists twice is shown once.
    """
    table = conditions(published, quantity)
    rows, correlation = variables_of_all_impacts(published, quantity), correlation_of_impacts
    if averages:
        rows = published.correlations.query("table == @AVERAGED_TABLES[@quantity]")
        correlation = correlation_of_averages
    recomputed = [correlation(name, table).value for name in rows["variable"]]
    figure = pd.DataFrame(
        {
            "variable": rows["variable"].to_numpy(),
            "correlation": pd.Series(recomputed, dtype="float64"),
            "published": pd.to_numeric(rows["correlation_text"], errors="coerce").to_numpy(),
        }
    )
    figure["absolute"] = figure["correlation"].fillna(figure["published"]).abs()
    repeated = figure["variable"].map(factors).duplicated()
    shown = figure[~repeated].dropna(subset="absolute")
    return shown.sort_values("absolute", ascending=False, kind="stable", ignore_index=True)


def _impact_lines(row: pd.Series, table: pd.DataFrame) -> Iterator[PublishedNumber]:
    """A correlation over all impacts, and its p-value."""
    r, n, lost = correlation_of_impacts(row["variable"], table), float(table["impacts"].sum()), ""
    if row["table"] == "5.13":
        said, lost = row["correlation_text"], _LOST_TABLE
        source = f"{lost}; {'section 5.3 prints this number' if said else 'no number is printed'}"
        r = replace(r, note="; ".join(filter(None, [source, r.note])))
    if r.value is None:
        p = Recomputed(None, note=_p_note(row, r, n))
    else:
        # p falls as |r| grows, so the ends of r's interval give the ends of p's.
        value, highest = p_value(r.value, n), p_value(max(abs(r.value) - r.rounding, 0.0), n)
        p = Recomputed(value, rounding=highest - value, note=lost)
    name = f"of {row['quantity']} with {row['variable']}, all impacts"
    yield line_of(row, "correlation", f"correlation {name}", r)
    yield line_of(row, "p_value", f"p-value {name}", p)


def _p_note(row: pd.Series, recomputed: Recomputed, n: float) -> str:
    """What a p-value may be when only the printed correlation is known."""
    if not row["p_value_text"]:
        return recomputed.note
    # Correlations of the thesis are cut off, so a printed one may stand for anything up to one unit more.
    low, unit = abs(float(row["correlation"])), 2 * half_unit(row["correlation_text"])
    least, most = p_value(low + unit, n), p_value(max(low - unit / 2, 0.0), n)
    printed = row["p_value"]
    verdict = "" if least <= printed <= most else f", not {row['p_value_text']}"
    return f"{recomputed.note}; the printed correlation allows {least:.3f} to {most:.3f}{verdict}"


def _angle(error: float, norm: float) -> float:
    return float(np.arcsin(min(1.0, error / norm))) if norm > 0 else 0.0


def straight_line(table: pd.DataFrame, mass: pd.Series | None = None) -> Any:
    """Least squares of the averages on mass: average = b0 + b1 M, as statsmodels' results.

    ``mass`` (kg, one per condition) is the printed one unless given.
    """
    mass = table["mass_kg"] if mass is None else mass
    return OLS(table["average"], add_constant(mass.rename("Mass"))).fit()


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
        p = {}
        for name in (variable for variable in known if variable not in entered):
            columns = np.column_stack([known[variable] for variable in (*entered, name)])
            fit = OLS(response.to_numpy(), add_constant(columns, has_constant="add")).fit()
            p[name] = float(fit.pvalues[-1])
        best = min(p, key=p.__getitem__)
        if not p[best] < ALPHA:
            break
        entered.append(best)
    return entered


def regression_lines(published: PublishedTables) -> Iterator[PublishedNumber]:
    """Coefficients and R² of both equations, fitted to the averages of the nine conditions."""
    for quantity in QUANTITIES:
        printed = published.regressions.query("quantity == @quantity")
        recomputed = _equation(conditions(published, quantity), printed)
        names = [*(f"coefficient of {term}" for term in printed["term"]), "R²"]
        texts = [*printed["coefficient_text"], printed["r_squared_text"].iloc[0]]
        for row, (name, text) in enumerate(zip(names, texts, strict=True), start=1):
            yield line(f"equation of {quantity}", row, name, text, recomputed[name])


def stepwise_lines(published: PublishedTables) -> Iterator[PublishedNumber]:
    """Which variables enter, by forward selection at 0.05 on the averages, without skin and muscle."""
    for quantity in QUANTITIES:
        rows = published.stepwise.query("quantity == @quantity")
        table = conditions(published, quantity)
        known = candidates(rows["variable"], table)
        entered = select_forward(table["average"], known)
        for _, row in rows.iterrows():
            key, status, agreed, note = factors(row["variable"]), "", None, NEVER_TABULATED
            if key in known:
                status = "entered" if key in entered else "not entered"
                agreed = status == row["status"]
                note = (
                    "" if agreed else f"forward selection at {ALPHA} on the averages, without skin and muscle"
                )
            name = f"{row['variable']} in the stepwise regression of {quantity}"
            yield PublishedNumber(row["table"], row["row"], name, row["status"], status, agreed, note)


def printed_line(published: PublishedTables, quantity: Quantity) -> tuple[float, float]:
    """The thesis's constant and slope over mass (section 5.4)."""
    terms = published.regressions.query("quantity == @quantity").set_index("term")["coefficient"]
    return float(terms["constant"]), float(terms["Mass"])


def _equation(table: pd.DataFrame, printed: pd.DataFrame) -> dict[str, Recomputed]:
    fit, mass, average = straight_line(table), table["mass_kg"], table["average"]
    error = float(np.linalg.norm(table["average_rounding"]))
    spread = float(np.linalg.norm(mass - mass.mean()))
    angle = _angle(error, float(np.linalg.norm(average - average.mean())))
    extra = [term for term in printed["term"] if term not in ("constant", "Mass")]
    without = f"fitted without {', '.join(extra)}: {NEVER_TABULATED}" if extra else ""
    unrounded = straight_line(table, unrounded_mass(table)).params

    def hint(term: str) -> str:
        return f"{unrounded[term]:.5g} with masses not cut to three decimals"

    of_constant = error * float(np.sqrt(1 / len(mass) + (mass.mean() / spread) ** 2))
    return {
        "coefficient of constant": Recomputed(fit.params["const"], of_constant, without, hint("const")),
        "coefficient of Mass": Recomputed(fit.params["Mass"], error / spread, without, hint("Mass")),
        **{f"coefficient of {term}": Recomputed(None, note=NEVER_TABULATED) for term in extra},
        "R²": Recomputed(fit.rsquared, 2 * angle, without),
    }
