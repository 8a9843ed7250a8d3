"""The table `impacts.csv`: one row per impact, checked cell by cell."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd

from bayestissue.base.declarations import declared
from bayestissue.base.errors import Problem, has_control_characters
from bayestissue.recordings.dataset.cells import FILE, is_height, number_in
from bayestissue.recordings.dataset.plausible import PLAUSIBLE
from bayestissue.recordings.dataset.ragged_traces import BoolPerImpact
from bayestissue.recordings.dataset.recordings import CROP

RESERVED = ("impact", "subject", "trial", "mass_kg", "velocity_m_s", "trace", "sampling_rate_hz", *CROP)
# Of a spring or phantom whose stiffness is known.
REFERENCE = ("reference_K_N_per_m", "reference_K_sd_N_per_m")
# Columns that tell days apart, as labs call them.
SESSIONS = ("session", "day", "date", "visit", "week", "occasion", "sitzung", "tag", "datum", "termin")
_GROUPS = ("subject", "trial")
# Columns whose levels are people of their own, and those that a person goes through, besides sessions.
_BETWEEN = ("group", "arm", "cohort", "sex", "gender", "gruppe", "kohorte", "geschlecht")
WITHIN = ("condition", "side", "leg", "foot", "seite", "impact", "n", "file")
_NUMBERED = re.compile(r"\D{0,8}\d+")


_DECLARED = declared(__package__, "columns.toml")
# What each column is, for the manual; any other is a covariate.
COLUMNS = {name: column["meaning"] + column.get("remark", "") for name, column in _DECLARED.items()}
_WHOLE_NUMBER = re.compile(r"(?<![\d.])(\d+)\.0+(?![\d.])")


@dataclass(frozen=True, eq=False)
class ImpactTable:
    """What ``impacts.csv`` says.

    Attributes:
        table: one row per impact, typed; numbers that were wrong are nan.
        row: for every impact its row in the file.
        problems: what is wrong.
        warnings: what looks odd.
    """

    table: pd.DataFrame
    row: np.ndarray
    problems: list[Problem]
    warnings: list[Problem]


def of_phantoms(impacts: pd.DataFrame) -> BoolPerImpact:
    """Which impacts of a checked table are of a spring or phantom of known stiffness, and so of no person."""
    if REFERENCE[0] not in impacts:
        return np.zeros(len(impacts), bool)
    known: np.ndarray = np.isfinite(impacts[REFERENCE[0]].to_numpy(float))
    return known


def session_column(impacts: pd.DataFrame) -> str | None:
    """The first column of a checked table that is called one of `SESSIONS`; None where there is none."""
    return next((str(name) for name in impacts if str(name).lower() in SESSIONS), None)


def in_two_levels(impacts: pd.DataFrame, most: int = 6) -> Iterator[tuple[str, str, list[str]]]:
    """Of each factor that seems to be of whole people the first person in several of its levels, and these.

    People who are numbered anew in each group count as one otherwise. A factor of whole people is called a
    group or the like, or has words, and one of them for most people; each is somebody's only one.

    Args:
        impacts: one a row, with ``subject``.
        most: levels of a factor.
    """
    for name in impacts.columns.difference([*RESERVED, *REFERENCE, *SESSIONS, *WITHIN], sort=False):
        rows = impacts.loc[impacts[name].notna() & (impacts[name] != ""), ["subject", name]]
        if str(name).lower() in (*SESSIONS, *WITHIN) or str(name) in _DECLARED or rows[name].nunique() > most:
            continue
        levels = rows.groupby("subject", sort=False)[name].unique()
        several = levels[levels.map(len) > 1]
        constant = {level for of_person in levels[levels.map(len) == 1] for level in of_person}
        if str(name).lower() in _BETWEEN:
            several = several[[bool(_NUMBERED.fullmatch(str(person))) for person in several.index]]
        elif (
            pd.api.types.is_numeric_dtype(impacts[name])
            or 2 * len(several) >= len(levels)
            or not all(constant.issuperset(many) for many in several)
        ):
            continue
        for person, many in several.head(1).items():
            words = [f"{level:g}" if isinstance(level, float) else level for level in many]
            yield str(name), str(person), words


def counts(impacts: pd.DataFrame) -> str:
    """How many impacts, people and conditions a checked table has, and how many impacts of phantoms."""
    known = of_phantoms(impacts)
    people, trials = impacts.loc[~known, "subject"].nunique(), impacts["trial"].nunique()
    phantoms = f"; of known springs or phantoms: {known.sum()}" if known.any() else ""
    return f"{len(impacts)}; subjects: {people}, trials: {trials}{phantoms}"


def required_columns(*, needs_velocity: bool = True) -> list[str]:
    """The columns that a table of impacts must have."""
    return ["impact", "subject", "mass_kg", *(["velocity_m_s"] if needs_velocity else [])]


def impact_table(cells: pd.DataFrame, rows: np.ndarray, *, needs_velocity: bool) -> ImpactTable:
    """The table of impacts from cells of `read_cells`; without ``trial`` masses and velocities name it."""
    if "trial" not in cells:
        cells = cells.assign(trial=_conditions(cells))
    columns = {
        name: _CheckedColumn(name, cells[name].tolist(), rows, cells["impact"].tolist())
        for name in map(str, cells)
    }
    problems: list[Problem] = []
    for column in (columns[name] for name in ("impact", *_GROUPS)):
        problems += column.wrong(column.empty, "empty-cell")
    named = columns["impact"]
    first = dict(zip(reversed(named.texts), reversed(rows), strict=True))
    again = np.flatnonzero(pd.Index(named.texts).duplicated() & ~named.empty)
    problems += [named.problem(at, "impact-twice", first=first[named.texts[at]]) for at in again]
    for column in columns.values():
        # What a terminal would obey, or runs over several lines.
        problems += column.wrong(
            np.array(list(map(has_control_characters, column.texts))), "control-characters"
        )
    warnings: list[Problem] = []
    content: dict[str, object] = {}
    for name, column in columns.items():
        content[name] = column.texts
        if "unit" in _DECLARED.get(name, {}):
            optional = name not in required_columns(needs_velocity=needs_velocity)
            content[name], wrong = column.measured(optional=optional)
            problems += wrong
        elif name in CROP:
            content[name] = column.numbers
            problems += column.wrong(~np.isfinite(column.numbers) & ~column.empty, "crop.time")
        elif name not in RESERVED:
            content[name], odd = column.covariate()
            warnings += odd
            most = PLAUSIBLE.largest_covariate
            too_large = np.abs(column.numbers) >= most
            problems += column.wrong(too_large, "impossible-value.covariate", limit=most)
    problems += _known_stiffness(columns)
    for name in ("mass_kg", "velocity_m_s"):
        content.setdefault(name, np.full(len(rows), np.nan))
    table = pd.DataFrame(content)
    if set(CROP) <= set(table):
        problems += _reversed(table, columns)
    warnings += [*_unlikely(table, columns), *_alike_names(table, columns)]
    for name, person, levels in in_two_levels(table):
        index = columns["subject"].texts.index(person)
        words = {"name": name, "levels": " and in ".join(levels), "first": levels[0]}
        warnings.append(columns["subject"].problem(index, "one-person-or-two", **words))
    return ImpactTable(table, rows, problems, warnings)


@dataclass(frozen=True, eq=False)
class _CheckedColumn:
    """The cells of one column, and of each its row in the file and its impact."""

    name: str
    texts: list[str]
    rows: np.ndarray
    impacts: list[str]

    @cached_property
    def numbers(self) -> np.ndarray:
        """Not a number (nan) where a cell holds none."""
        return np.array([number_in(text) for text in self.texts])

    @cached_property
    def empty(self) -> np.ndarray:
        """Where a cell holds nothing."""
        return np.array([not text for text in self.texts], dtype=bool)

    def wrong(self, where: np.ndarray, key: str, **numbers: Any) -> list[Problem]:
        """A problem with the message ``key`` for each cell where there is something wrong."""
        return [self.problem(index, key, **numbers) for index in np.flatnonzero(where)]

    def problem(self, index: int | np.integer, key: str, **numbers: Any) -> Problem:
        """The problem of one cell, with its text unless another ``value`` stands in the message."""
        text, impact = self.texts[index] or "an empty cell", self.impacts[index]
        return Problem.stated(key, FILE, self.rows[index], self.name, text, impact=impact, **numbers)

    def measured(self, *, optional: bool) -> tuple[np.ndarray, list[Problem]]:
        """The numbers within the limits of this column, nan elsewhere, and what is wrong with the others."""
        values, limits = self.numbers, _DECLARED[self.name]
        good = (limits["low"] <= values) & (values <= limits["high"])
        problems = [
            self.problem(index, f"impossible-value.{'limits' if values[index] > 0 else 'positive'}", **limits)
            for index in np.flatnonzero(~good & ~(self.empty & optional))
        ]
        return np.where(good, values, np.nan), problems

    def covariate(self) -> tuple[np.ndarray | list[str], list[Problem]]:
        """Numbers or names, whichever most cells hold, and a warning where some don't."""
        numeric, filled = np.isfinite(self.numbers), ~self.empty
        content: np.ndarray | list[str]
        if numeric.sum() * 2 <= filled.sum() or not filled.any():
            content, odd, kind = self.texts, ~filled, "category"
        elif (numeric == filled).all():
            content, odd, kind = self.numbers, ~numeric, "number"
        else:
            # Numbers with one slip among them must not quietly become categories.
            content, odd, kind = self.texts, filled & ~numeric, "not-a-number"
        counts = {"count": int(odd.sum()), "total": len(self.texts)}
        first = np.flatnonzero(odd)[:1]
        return content, [self.problem(index, f"unusual-value.{kind}", **counts) for index in first]


def _known_stiffness(columns: dict[str, _CheckedColumn]) -> Iterator[Problem]:
    """Cells of a known stiffness without its standard deviation, or the other way round, or with one so wide.

    A standard deviation above half of the stiffness is of another unit: N/mm of the one and N/m of the other.
    """
    empty = {name: columns[name].empty for name in REFERENCE if name in columns}
    for name, partner in (REFERENCE, REFERENCE[::-1]):
        if name in empty:
            lacking = ~empty[name] & empty.get(partner, np.ones_like(empty[name]))
            yield from columns[name].wrong(lacking, "reference-unfit.half", other=partner)
    if len(empty) == len(REFERENCE):
        stiffness, sd = (columns[name].numbers for name in REFERENCE)
        for index in np.flatnonzero(sd >= PLAUSIBLE.most_sd * stiffness):
            yield columns[REFERENCE[1]].problem(index, "reference-unfit.wide", stiffness=stiffness[index])


def _conditions(cells: pd.DataFrame) -> list[str]:
    """A name for each mass and velocity: those of either that vary, and come with two impacts on average."""
    names = pd.Series("all", index=cells.index)
    for column, unit in (("mass_kg", "kg"), ("velocity_m_s", "m/s")):
        if column in cells and len(set(cells[column])) > 1:
            numbers = pd.to_numeric(cells[column], errors="coerce")
            finer = numbers.map(lambda value, unit=unit: f"{value:.4g} {unit}")
            finer = finer if (names == "all").all() else names + ", " + finer
            names = finer if 2 * finer.nunique() <= len(cells) else names
    return names.tolist()


def _reversed(table: pd.DataFrame, columns: dict[str, _CheckedColumn]) -> list[Problem]:
    """Crops that end before they begin; they are taken out of the table, for nothing lies in them."""
    start, stop = (table[name].to_numpy(copy=True) for name in CROP)
    table.loc[stop <= start, list(CROP)] = np.nan
    return [
        columns[CROP[1]].problem(index, "crop.reversed", start=start[index], value=float(stop[index]))
        for index in np.flatnonzero(stop <= start)
    ]


def _unlikely(table: pd.DataFrame, columns: dict[str, _CheckedColumn]) -> Iterator[Problem]:
    mass, velocity = table["mass_kg"].to_numpy(), table["velocity_m_s"].to_numpy()
    odd = {"mass_kg": (mass < 1e-3) | (mass > 200), "velocity_m_s": (velocity < 0.01) | (velocity > 50)}
    if "energy_J" in table:
        energy = 0.5 * mass * velocity**2
        odd["energy_J"] = np.abs(table["energy_J"].to_numpy() / energy - 1) > 0.05
    heights = filter(is_height, map(str, table.select_dtypes("number")))
    named = [(name, f"unusual-value.{name}", where) for name, where in odd.items()]
    named += [
        (name, "unusual-value.apart", _far_apart(table[name].to_numpy(float)))
        for name in ("mass_kg", "velocity_m_s", *heights)
        if name not in odd or not odd[name].any()
    ]
    for name, key, where in named:
        for first in np.flatnonzero(where)[:1]:
            counts = {"count": where.sum(), "total": len(table)}
            yield columns[name].problem(first, key, value=float(table[name].iloc[first]), **counts)


def _far_apart(values: np.ndarray) -> BoolPerImpact:
    """The fewer of two groups of numbers between which lies so wide a gap as a slip by a thousand leaves."""
    known = np.unique(values[values > 0])
    ratios = known[1:] / known[:-1]
    if not ratios.size or ratios.max() < PLAUSIBLE.apart:
        return np.zeros(values.size, bool)
    low = values <= known[np.argmax(ratios)]
    return low if 2 * low.sum() <= np.isfinite(values).sum() else ~low & np.isfinite(values)


def _alike_names(table: pd.DataFrame, columns: dict[str, _CheckedColumn]) -> Iterator[Problem]:
    """Names of people, conditions or categories that differ only in case, spaces, hyphens or leading zeros.

    A warning for each further way of writing a name: two people where there is one make the spread between
    people too small, and that within a person too large; two sides where there is one share its impacts.
    """
    for column in map(str, table.select_dtypes(exclude="number")):
        if column in RESERVED and column not in _GROUPS:
            continue
        first: dict[str, str] = {}
        for text in dict.fromkeys(table[column]):
            usual = first.setdefault(_plain(text), text)
            if usual != text:
                index = int(np.argmax(table[column] == text))
                yield columns[column].problem(index, "two-spellings", usual=usual)


def _plain(text: str) -> str:
    """A name without what people write in different ways: case, leading zeros, what stands after a word."""
    text = unicodedata.normalize("NFKC", text).casefold().strip()
    text = _WHOLE_NUMBER.sub(r"\1", text)
    # A sign or a separator between digits is part of a number: 1.5 is not 15, -5 is not 5, 1-1 is not 11.
    text = re.sub(r"(?<=[^\W\d_])[\s_\-]+", "", text)
    return re.sub(r"(?<![\d.,])0+(?=\d)", "", text)
