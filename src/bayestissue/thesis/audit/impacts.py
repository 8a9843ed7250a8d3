"""A table of estimates, one row per impact: the subject of every general check."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pandas as pd
from jaxtyping import Float

from bayestissue.errors import InputError, Problem
from bayestissue.thesis.audit.findings import Finding
from bayestissue.thesis.audit.registry import Registry

_SAME = {"K": "K_N_per_m", "C": "C_N_s_per_m"}
_NEEDED = ("subject", "trial", "mass_kg", "velocity_m_s", "K", "C")
_OPTIONAL = ("energy_J", "peak_displacement_m", "time_to_peak_s")

GENERAL: Registry[Impacts] = Registry()
"""Checks that any laboratory's estimates can be put to."""


@dataclass(frozen=True, eq=False)
class Impacts:
    """Estimates with what was measured beside them.

    Attributes:
        rows: columns subject, trial, mass_kg, velocity_m_s, K (N/m), C (N s/m), and those of energy_J,
            peak_displacement_m and time_to_peak_s that are known; finite and positive throughout.
        where: how findings name the table.
        conditions: the trials' energy_J (if known), velocity_m_s and mass_kg; may name trials without rows.
        left_out: rows dropped because K, C, mass or velocity was missing or not above zero.
        below_zero: those among them that have all four, but a K or C that is not above zero.
        tissue_m: greatest thickness of the tissue, in m, where it is known.
        digits: number of decimals that K and C were printed with; None if they were not rounded.
    """

    rows: pd.DataFrame
    conditions: pd.DataFrame
    where: str = "estimates"
    left_out: int = 0
    tissue_m: float | None = None
    digits: int | None = None
    below_zero: int = 0

    @cached_property
    def omega_n(self) -> Float[np.ndarray, " impact"]:
        """ω_n = √(K/M), rad/s (thesis 2.12)."""
        return np.sqrt(self.rows["K"].to_numpy() / self.rows["mass_kg"].to_numpy())

    @cached_property
    def zeta(self) -> Float[np.ndarray, " impact"]:
        """ζ = C / (2√(KM)) (thesis 2.12)."""
        rows = self.rows
        return rows["C"].to_numpy() / (2 * np.sqrt(rows["K"].to_numpy() * rows["mass_kg"].to_numpy()))


def read_impacts(
    frame: pd.DataFrame,
    *,
    conditions: pd.DataFrame | None = None,
    where: str = "estimates",
    tissue_m: float | None = None,
    digits: int | None = None,
) -> Impacts:
    """Take what the checks need from a table such as `estimates.csv`.

    K and C may also be called K_N_per_m and C_N_s_per_m. ``conditions``, one row per trial, is made from
    the rows unless given.

    Raises:
        InputError: a column is missing, or fewer than two rows are usable.
    """
    frame = frame.rename(columns={long: short for short, long in _SAME.items() if short not in frame})
    missing = [column for column in _NEEDED if column not in frame]
    if missing:
        remedy = f"Add it: the audit needs {', '.join(_NEEDED)}."
        other = {column: f" (or {long})" for column, long in _SAME.items()}
        raise InputError(
            Problem(where, f"this column{other.get(name, '')}", remedy, column=name, code="published-table")
            for name in missing
        )
    rows = frame[[column for column in (*_NEEDED, *_OPTIONAL) if column in frame]].copy()
    numbers = list(_NEEDED[2:])
    rows[numbers] = rows[numbers].apply(pd.to_numeric, errors="coerce")
    usable = np.isfinite(rows[numbers]).all(axis=1) & (rows[numbers] > 0).all(axis=1)
    if usable.sum() < 2:
        expected = "at least two rows whose mass, velocity, K and C are above zero"
        remedy, found = (
            "Check the estimates that the table comes from.",
            f"{usable.sum()} of {len(rows)} rows",
        )
        raise InputError(Problem(where, expected, remedy, value=found, code="published-table"))
    below = np.isfinite(rows[numbers]).all(axis=1) & (rows[["K", "C"]] <= 0).any(axis=1)
    rows, left_out = rows[usable].reset_index(drop=True), int((~usable).sum())
    if conditions is None:
        columns = [column for column in ("energy_J", "velocity_m_s", "mass_kg") if column in rows]
        conditions = rows.groupby("trial")[columns].mean()
    return Impacts(rows, conditions, where, left_out, tissue_m, digits, int(below.sum()))


@GENERAL.check(severity="note", bearing="tables", reason="what is left out can't be judged")
def rows_left_out(impacts: Impacts) -> Iterator[Finding]:
    """Rows without a usable K, C, mass or velocity."""
    if impacts.left_out:
        total = impacts.left_out + len(impacts.rows)
        yield Finding(
            impacts.where,
            "rows without a usable estimate",
            str(total),
            str(len(impacts.rows)),
            f"{impacts.left_out} of {total} rows have no K, C, mass or velocity above zero; "
            "everything below is about the others.",
        )
