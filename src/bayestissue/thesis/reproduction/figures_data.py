"""The numbers behind figures 5.1 to 5.6, so that they can be drawn anew."""

from __future__ import annotations

from dataclasses import dataclass

import pandas as pd

from bayestissue.dataset.published import PublishedTables
from bayestissue.thesis.reproduction.conditions import Quantity, conditions
from bayestissue.thesis.reproduction.correlations import (
    correlation_of_averages,
    correlation_of_impacts,
    variables_of_all_impacts,
)
from bayestissue.thesis.reproduction.covariates import factors
from bayestissue.thesis.reproduction.regressions import straight_line

AVERAGED_TABLES: dict[Quantity, str] = {"K": "5.14", "C": "5.15"}


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


def correlation_figure(published: PublishedTables, quantity: Quantity, *, averages: bool) -> pd.DataFrame:
    """Absolute correlations in falling order: figures 5.1 (K), 5.2 (C), with averages 5.3 (K), 5.4 (C).

    Columns: ``variable`` as the thesis writes it, ``correlation`` recomputed (NaN for skin and muscle, which
    were never tabulated), ``published`` (NaN where the cell is lost), and ``absolute``, which is that of the
    recomputed number, or else of the published one. Variables with neither are left out, and a product that
    the thesis lists twice is shown once.
    """
    table = conditions(published, quantity)
    if averages:
        rows = published.correlations.query("table == @AVERAGED_TABLES[@quantity]")
        found = [correlation_of_averages(name, table) for name in rows["variable"]]
    else:
        rows = variables_of_all_impacts(published, quantity)
        found = [correlation_of_impacts(name, table) for name in rows["variable"]]
    figure = pd.DataFrame(
        {
            "variable": rows["variable"].to_numpy(),
            "correlation": pd.Series([one.value for one in found], dtype="float64"),
            "published": pd.to_numeric(rows["correlation_text"], errors="coerce").to_numpy(),
        }
    )
    figure["absolute"] = figure["correlation"].fillna(figure["published"]).abs()
    repeated = figure["variable"].map(factors).duplicated()
    shown = figure[~repeated].dropna(subset="absolute")
    return shown.sort_values("absolute", ascending=False, kind="stable", ignore_index=True)


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
