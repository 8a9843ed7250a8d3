"""What an audit looks at, and what its checks report: both kinds of subject, lists of checks, findings."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, get_args

import numpy as np
import pandas as pd
from jaxtyping import Float

from bayestissue.dataset.published import PublishedTables
from bayestissue.declarations import declared
from bayestissue.errors import InputError, Problem, refuse
from bayestissue.thesis.reproduction import reproduce_published
from bayestissue.thesis.reproduction.conditions import Quantity, conditions

Severity = Literal["major", "minor", "note"]
Bearing = Literal["tissue", "physics", "inputs", "method", "conclusions", "tables", "wording"]

SEVERITIES: tuple[Severity, ...] = get_args(Severity)
BEARINGS: tuple[Bearing, ...] = get_args(Bearing)
COLUMNS = ("where", "what", "published", "implied", "severity", "explanation")


@dataclass(frozen=True)
class Finding:
    """One thing that does not hold together.

    Attributes:
        where: the table or section.
        what: the quantity, in a few words.
        published: the figure as it stands there.
        implied: the figure that follows from something else.
        severity: how serious it is (`SEVERITIES`, worst first).
        explanation: one or two sentences that hold without the other columns.
        bearing: what it puts in doubt (`BEARINGS`, most damaging first).
    """

    where: str
    what: str
    published: str
    implied: str
    severity: Severity
    explanation: str
    bearing: Bearing


def as_table(graded: Iterable[Finding]) -> pd.DataFrame:
    """A table with `COLUMNS`, worst first: by severity, then by what is at stake, then in the order found."""
    ranked = sorted(graded, key=lambda one: (SEVERITIES.index(one.severity), BEARINGS.index(one.bearing)))
    rows = [[getattr(one, name) for name in COLUMNS] for one in ranked]
    return pd.DataFrame(rows, columns=list(COLUMNS), dtype="str")


type Numbers = Mapping[str, Any]
"""What a check yields of a thing that it does not believe, by the names in its texts in ``findings.toml``.

A ``severity`` among them, unless None, stands instead of the check's.
"""
type Look[Subject] = Callable[[Subject], Iterable[Numbers]]


_TEXTS = declared(__package__, "findings.toml")


@dataclass(frozen=True)
class Check[Subject]:
    """A function that yields the numbers of everything it does not believe, and what is said of them."""

    look: Look[Subject]
    severity: Severity
    bearing: Bearing
    texts: Mapping[str, str]

    def findings(self, subject: Subject) -> Iterator[Finding]:
        """What it finds in ``subject``."""
        for numbers in self.look(subject):
            known = {"where": getattr(subject, "where", ""), **numbers}
            texts = {name: text.format(**known) for name, text in self.texts.items()}
            severity = numbers.get("severity") or self.severity
            yield Finding(**{"where": known["where"], **texts}, severity=severity, bearing=self.bearing)


class Registry[Subject]:
    """Checks of one kind of subject by name, in the order in which they were registered."""

    def __init__(self) -> None:
        self.checks: dict[str, Check[Subject]] = {}

    def check(self, look: Look[Subject]) -> Look[Subject]:
        """Register a function, whose docstring says why its findings are that serious."""
        texts = dict(_TEXTS[look.__name__])
        severity, bearing = texts.pop("severity"), texts.pop("bearing")
        self.checks[look.__name__] = Check(look, severity, bearing, texts)
        return look

    def run(self, subject: Subject) -> Iterator[Finding]:
        """Every finding of every check on ``subject``."""
        for check in self.checks.values():
            yield from check.findings(subject)


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
    needed, problems = ", ".join(_NEEDED), []
    for column in (column for column in _NEEDED if column not in frame):
        key = "published-table.named" if column in _SAME else "published-table.column"
        problems.append(Problem.stated(key, where, column=column, other=_SAME.get(column), needed=needed))
    refuse(problems)
    rows = frame[[column for column in (*_NEEDED, *_OPTIONAL) if column in frame]].copy()
    numbers = list(_NEEDED[2:])
    rows[numbers] = rows[numbers].apply(pd.to_numeric, errors="coerce")
    known = np.isfinite(rows[numbers]).all(axis=1)
    usable = known & (rows[numbers] > 0).all(axis=1)
    if usable.sum() < 2:
        few = f"{usable.sum()} of {len(rows)} rows"
        raise InputError.stated("published-table.few", where, value=few)
    below_zero = int((known & (rows[["K", "C"]] <= 0).any(axis=1)).sum())
    rows, left_out = rows[usable].reset_index(drop=True), int((~usable).sum())
    if conditions is None:
        columns = [column for column in ("energy_J", "velocity_m_s", "mass_kg") if column in rows]
        conditions = rows.groupby("trial")[columns].mean()
    return Impacts(rows, conditions, where, left_out, tissue_m, digits, below_zero)


@GENERAL.check
def rows_left_out(impacts: Impacts) -> Iterator[Numbers]:
    """Rows without a usable K, C, mass or velocity.

    Note: what is left out can't be judged.
    """
    if impacts.left_out:
        used = len(impacts.rows)
        yield {"left_out": impacts.left_out, "used": used, "total": impacts.left_out + used}


_COLUMNS = ("topic", "place", "position", "weight", "sentence")

PUBLISHED: Registry[Publication] = Registry()
"""Checks of a publication: its tables against each other and against its text."""


def named_rows(frame: pd.DataFrame) -> Iterator[Any]:
    """The rows of ``frame`` as named tuples, whose fields no type checker knows."""
    return iter(frame.itertuples())


def number_list(values: Iterable[float]) -> str:
    """``1.5, 1.75``: numbers as a finding names them."""
    return ", ".join(f"{value:g}" for value in values)


@dataclass(frozen=True)
class Publication:
    """What a check of a publication gets to see.

    Attributes:
        tables: the published tables.
        statements: what the text says in words: topic, place, position (two positions on one topic
            contradict each other), weight (the severity of that) and sentence; may be empty.
    """

    tables: PublishedTables
    statements: pd.DataFrame

    @cached_property
    def reproduction(self) -> pd.DataFrame:
        """Every printed number beside the recomputed one; see `reproduce_published`."""
        return reproduce_published(self.tables)

    def claims(self, quantity: str, statistic: str) -> pd.DataFrame:
        """The claims of the text about one figure, in the order of the text."""
        claims = self.tables.claims
        return claims[(claims["quantity"] == quantity) & (claims["statistic"] == statistic)]

    def equation(self, quantity: Quantity) -> tuple[pd.DataFrame, pd.DataFrame]:
        """The printed terms of the equation of K or C, and the conditions that it was fitted to."""
        terms = self.tables.regressions.query("quantity == @quantity")
        return terms, conditions(self.tables, quantity)


def thickness(claims: pd.DataFrame) -> tuple[float, pd.DataFrame]:
    """The greatest skin and muscle thickness that the text states, together, in m, and the claims of it."""
    layers = claims[claims["quantity"].str.endswith("thickness") & claims["statistic"].eq("maximum (mm)")]
    return float(layers["value"].sum()) / 1000, layers


def read_publication(tables: PublishedTables) -> Publication:
    """Add ``statements.csv``, where it lies beside the tables.

    Raises:
        InputError: the file lacks a column.
    """
    path = tables.folder / "statements.csv"
    if not path.is_file():
        return Publication(tables, pd.DataFrame(columns=list(_COLUMNS)))
    statements = pd.read_csv(path, dtype=str, keep_default_na=False)
    if lacking := [column for column in _COLUMNS if column not in statements]:
        key, this = "published-table.other", "this column"
        raise InputError(Problem.stated(key, str(path), column=name, expected=this) for name in lacking)
    return Publication(tables, statements)
