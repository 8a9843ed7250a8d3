"""What an audit looks at, and what its checks report: both kinds of subject, and findings."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Float

from bayestissue.base.declarations import declared
from bayestissue.base.results.tables import table_of_rows
from bayestissue.recordings.dataset.published import PublishedTables
from bayestissue.thesis.reproduction import reproduce_published
from bayestissue.thesis.reproduction.agreement import decimals
from bayestissue.thesis.reproduction.conditions import Quantity, conditions

# How serious a finding is, and what it puts in doubt: worst first.
SEVERITIES = ("major", "minor", "note")
BEARINGS = ("tissue", "physics", "inputs", "method", "conclusions", "tables", "wording")


type Numbers = Mapping[str, Any]
"""What a check yields of a thing that it does not believe, by the names in its texts in
``inconsistencies.toml``.

A ``severity`` among them, unless None, stands instead of the check's.
"""
type Check[Subject] = Callable[[Subject], Iterable[Numbers]]
"""A function that yields the numbers of everything it does not believe, and says how serious that is."""


TEXTS = declared(__package__, "inconsistencies.toml")


def findings[Subject](
    checks: Iterable[Check[Subject]], subject: Subject, where: str = ""
) -> Iterator[dict[str, str]]:
    """What checks find in ``subject``, in words: rows of `audit.csv`, each with its ``bearing``.

    ``where`` is the table or section of a finding that names none. The explanation holds without the other
    columns.
    """
    for check in checks:
        texts = dict(TEXTS[check.__name__])
        severity, bearing = texts.pop("severity"), texts.pop("bearing")
        for numbers in check(subject):
            words = {name: text.format(**numbers) for name, text in texts.items()}
            graded = {"severity": numbers.get("severity") or severity, "bearing": bearing}
            yield {"where": where, **words, **graded}


def as_table(found: Iterable[dict[str, str]]) -> pd.DataFrame:
    """The table ``audit.csv``, worst first: by severity, what is at stake, then in the order found."""
    grades = {"severity": SEVERITIES, "bearing": BEARINGS}
    ranked = sorted(found, key=lambda row: [order.index(row[name]) for name, order in grades.items()])
    return table_of_rows("audit", ranked).astype("str")


@dataclass(frozen=True)
class AuditedImpacts:
    """Estimates with what was measured beside them.

    Attributes:
        rows: columns subject, trial, energy_J, velocity_m_s, mass_kg, K (N/m) and C (N s/m); all positive.
        conditions: the trials' energy_J, velocity_m_s and mass_kg; may name trials without rows.
        tissue_m: greatest thickness of the tissue, in m.
        digits: number of decimals that K and C were printed with.
    """

    rows: pd.DataFrame
    conditions: pd.DataFrame
    tissue_m: float
    digits: int

    @cached_property
    def omega_n(self) -> Float[np.ndarray, " impact"]:
        """ω_n = √(K/M), rad/s (thesis 2.12)."""
        return np.sqrt(self.rows["K"].to_numpy() / self.rows["mass_kg"].to_numpy())

    @cached_property
    def zeta(self) -> Float[np.ndarray, " impact"]:
        """ζ = C / (2√(KM)) (thesis 2.12)."""
        rows = self.rows
        return rows["C"].to_numpy() / (2 * np.sqrt(rows["K"].to_numpy() * rows["mass_kg"].to_numpy()))


def published_impacts(tables: PublishedTables) -> AuditedImpacts:
    """The impacts whose estimates were published."""
    claims = tables.claims
    layers = claims["quantity"].str.endswith("thickness") & claims["statistic"].eq("maximum (mm)")
    return AuditedImpacts(
        tables.estimates,
        conditions=tables.averages.drop_duplicates("trial").set_index("trial"),
        tissue_m=float(claims.loc[layers, "value"].sum()) / 1000,
        digits=int(tables.estimates["K_text"].map(decimals).max()),
    )


def named_rows(frame: pd.DataFrame) -> Iterator[Any]:
    """The rows of ``frame`` as named tuples, whose fields no type checker knows."""
    return iter(frame.itertuples())


def number_list(values: Iterable[float]) -> str:
    """``1.5, 1.75``: numbers as a finding names them."""
    return ", ".join(f"{value:g}" for value in values)


@dataclass(frozen=True)
class Publication:
    """The published tables, claims of the text among them, and what follows from them."""

    tables: PublishedTables

    @cached_property
    def reproduction(self) -> pd.DataFrame:
        """Every printed number beside the recomputed one; see `reproduce_published`."""
        return reproduce_published(self.tables)

    def equation(self, quantity: Quantity) -> tuple[pd.DataFrame, pd.DataFrame]:
        """The printed terms of the equation of K or C, and the conditions that it was fitted to."""
        terms = self.tables.regressions.query("quantity == @quantity")
        return terms, conditions(self.tables, quantity)
