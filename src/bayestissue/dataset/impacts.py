"""The table `impacts.csv`: one row per impact, checked cell by cell."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from bayestissue.dataset.crop import COLUMNS as CROP
from bayestissue.dataset.impact_cells import FILE, control_characters, read_cells
from bayestissue.dataset.twice import alike_names
from bayestissue.errors import Problem

RESERVED = ("impact", "subject", "trial", "mass_kg", "velocity_m_s", "trace", "sampling_rate_hz", *CROP)
_TEXT = ("impact", "subject", "trial")
_POSITIVE = {
    "mass_kg": "the impactor's mass in kg",
    "velocity_m_s": "the velocity at contact in m/s",
    "sampling_rate_hz": "the sampling rate in Hz",
    "energy_J": "the energy in J",
    "diameter_m": "the impactor's diameter in m",
}
# What each column is, for the manual; any other is a covariate.
COLUMNS = {
    "impact": "the impact's name, each once",
    "subject": "who was hit",
    "trial": "the condition; impacts at one mass and velocity share its name. It may be left out",
    "mass_kg": _POSITIVE["mass_kg"],
    "velocity_m_s": f"{_POSITIVE['velocity_m_s']}; of recorded displacements it may be left out",
    "trace": "the impact's file, relative to the folder and inside it; left out, one table has all samples",
    CROP[0]: "where the impact's stretch of the recording begins, in s on the recorder's clock, instead of "
    "signal.crop; several impacts may be stretches of one file that do not overlap",
    CROP[1]: "where the stretch ends",
    "sampling_rate_hz": f"{_POSITIVE['sampling_rate_hz']}, where there are no times; it must agree with the "
    "times within 1 % if there are any",
    "energy_J": f"{_POSITIVE['energy_J']}, M V²/2",
    "diameter_m": f"{_POSITIVE['diameter_m']}, for the element hunt_crossley",
}
# No impact on tissue lies outside, and no slip of a unit by a thousand lies far inside.
_POSSIBLE = {
    "mass_kg": (1e-5, 1e4, "kg"),
    "velocity_m_s": (1e-4, 1e3, "m/s"),
    "sampling_rate_hz": (1.0, 1e9, "Hz"),
    "energy_J": (1e-9, 1e7, "J"),
    "diameter_m": (1e-5, 10.0, "m"),
}
# A model squares what it is given.
_LARGEST_COVARIATE = 1e30
_MAY_BE_EMPTY = ("sampling_rate_hz", "energy_J", "diameter_m")
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)


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


def read_impacts(path: Path, *, needs_velocity: bool) -> ImpactTable:
    """Read and check ``impacts.csv``.

    Args:
        path: the file.
        needs_velocity: whether every impact must state its velocity at contact.

    Raises:
        InputError: the file as a whole can't be used: missing, not UTF-8, no table, columns missing.
    """
    return impact_table(
        *read_cells(path, wanted(needs_velocity=needs_velocity)), needs_velocity=needs_velocity
    )


def wanted(*, needs_velocity: bool) -> list[str]:
    """The columns that a table of impacts must have."""
    return ["impact", "subject", "mass_kg", *(["velocity_m_s"] if needs_velocity else [])]


def impact_table(cells: pd.DataFrame, rows: np.ndarray, *, needs_velocity: bool) -> ImpactTable:
    """The table of impacts from cells of `read_cells`; without ``trial`` masses and velocities name it."""
    if "trial" not in cells:
        cells = cells.assign(trial=_conditions(cells))
    problems = [*_name_problems(cells, rows), *control_characters(cells, rows)]
    warnings: list[Problem] = []
    columns: dict[str, object] = {}
    for name in cells.columns:
        texts = cells[name].tolist()
        if name in _POSITIVE:
            optional = name in _MAY_BE_EMPTY or (name == "velocity_m_s" and not needs_velocity)
            columns[name], wrong = _positive(name, texts, rows, cells["impact"], optional=optional)
            problems += wrong
        elif name in CROP:
            columns[name], wrong = _times(name, texts, rows, cells["impact"])
            problems += wrong
        elif name in RESERVED:
            columns[name] = texts
        else:
            columns[name], odd = _covariate(name, texts, rows, cells["impact"])
            warnings += odd
            problems += _too_large(name, texts, rows, cells["impact"])
    columns.setdefault("velocity_m_s", np.full(len(rows), np.nan))
    table = pd.DataFrame(columns)
    problems += _reversed(table, rows)
    warnings += [*_unlikely(table, rows), *alike_names(table, rows, FILE)]
    return ImpactTable(table, rows, problems, warnings)


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


def _name_problems(cells: pd.DataFrame, rows: np.ndarray) -> list[Problem]:
    problems = [
        Problem(
            FILE,
            f"a name for the {name}",
            "Fill the cell; any text will do.",
            row=int(row),
            column=name,
            value="an empty cell",
            impact=impact or None,
            code="empty-cell",
        )
        for name in _TEXT
        for text, row, impact in zip(cells[name], rows, cells["impact"], strict=True)
        if not text
    ]
    count = Counter(cells["impact"])
    first_rows: dict[str, int] = {}
    for impact, row in zip(cells["impact"], rows, strict=True):
        if impact and count[impact] > 1 and impact in first_rows:
            problems.append(
                Problem(
                    FILE,
                    "every impact once",
                    f"Rename it or remove it; row {first_rows[impact]} has the same name.",
                    row=int(row),
                    column="impact",
                    value=impact,
                    impact=impact,
                    code="impact-twice",
                )
            )
        first_rows.setdefault(impact, int(row))
    return problems


def _too_large(name: str, texts: list[str], rows: np.ndarray, impacts: pd.Series) -> list[Problem]:
    return [
        Problem(
            FILE,
            f"a number below {_LARGEST_COVARIATE:g}",
            "Correct the cell, or leave it empty.",
            row=int(rows[index]),
            column=name,
            value=texts[index],
            impact=impacts[index] or None,
            code="impossible-value",
        )
        for index in np.flatnonzero(np.abs(_numbers(texts)) >= _LARGEST_COVARIATE)
    ]


def _numbers(texts: list[str]) -> np.ndarray:
    return np.array([float(text) if _NUMBER.fullmatch(text) else np.nan for text in texts])


def _positive(
    name: str, texts: list[str], rows: np.ndarray, impacts: pd.Series, *, optional: bool
) -> tuple[np.ndarray, list[Problem]]:
    values = _numbers(texts)
    low, high, unit = _POSSIBLE[name]
    good = (low <= values) & (values <= high)
    problems = [
        Problem(
            FILE,
            f"{_POSITIVE[name]}, a number above 0"
            f"{f' and from {low:g} to {high:g}' if values[index] > 0 else ''}",
            f"{f'Is it in {unit}? ' if values[index] > 0 else ''}"
            "Correct the cell, or take the impact out of the dataset.",
            row=int(rows[index]),
            column=name,
            value=texts[index] or "an empty cell",
            impact=impacts[index] or None,
            code="impossible-value",
        )
        for index in np.flatnonzero(~good)
        if texts[index] or not optional
    ]
    return np.where(good, values, np.nan), problems


def _times(
    name: str, texts: list[str], rows: np.ndarray, impacts: pd.Series
) -> tuple[np.ndarray, list[Problem]]:
    values = _numbers(texts)
    problems = [
        Problem(
            FILE,
            "a time in s on the recorder's clock, a number",
            "Correct the cell, or leave it empty to read the recording from its beginning or to its end.",
            row=int(rows[index]),
            column=name,
            value=texts[index],
            impact=impacts[index] or None,
            code="crop",
        )
        for index in np.flatnonzero(~np.isfinite(values))
        if texts[index]
    ]
    return values, problems


def _reversed(table: pd.DataFrame, rows: np.ndarray) -> Iterator[Problem]:
    """Crops that end before they begin; they are taken out of the table, for nothing lies in them."""
    if not set(CROP) <= set(table):
        return
    start, stop = (table[name].to_numpy(copy=True) for name in CROP)
    backwards = stop <= start
    table.loc[backwards, list(CROP)] = np.nan
    for index in np.flatnonzero(backwards):
        yield Problem(
            FILE,
            f"a time after that in {CROP[0]} ({start[index]:.6g} s)",
            "Correct one of the two cells.",
            row=int(rows[index]),
            column=CROP[1],
            value=float(stop[index]),
            impact=table["impact"].iloc[index] or None,
            code="crop",
        )


def _covariate(
    name: str, texts: list[str], rows: np.ndarray, impacts: pd.Series
) -> tuple[np.ndarray | list[str], list[Problem]]:
    values = _numbers(texts)
    filled = np.array([bool(text) for text in texts])
    numeric = np.isfinite(values)
    odd = np.flatnonzero(~numeric)
    if numeric.sum() * 2 <= filled.sum() or not filled.any():
        values_or_names: np.ndarray | list[str] = texts
        odd, expected = np.flatnonzero(~filled), "a category in every cell"
    elif (numeric == filled).all():
        values_or_names, expected = values, "a number in every cell"
    else:
        # Numbers with one slip among them must not quietly become categories.
        values_or_names, expected = texts, "numbers only (the column is taken as categories)"
        odd = np.flatnonzero(filled & ~numeric)
    warnings = (
        [
            Problem(
                FILE,
                expected,
                f"Correct it if a model is to use {name}; {len(odd)} of {len(texts)} cells are like this.",
                row=int(rows[odd[0]]),
                column=name,
                value=texts[odd[0]] or "an empty cell",
                impact=impacts[odd[0]] or None,
                code="unusual-value",
            )
        ]
        if odd.size
        else []
    )
    return values_or_names, warnings


def _unlikely(table: pd.DataFrame, rows: np.ndarray) -> list[Problem]:
    mass, velocity = table["mass_kg"].to_numpy(), table["velocity_m_s"].to_numpy()
    odd = [
        ("mass_kg", (mass < 1e-3) | (mass > 200), "a mass between 0.001 and 200 kg", "Is it in kg?"),
        (
            "velocity_m_s",
            (velocity < 0.01) | (velocity > 50),
            "a velocity between 0.01 and 50 m/s",
            "Is it in m/s?",
        ),
    ]
    if "energy_J" in table:
        energy = 0.5 * mass * velocity**2
        off = np.abs(table["energy_J"].to_numpy() / energy - 1) > 0.05
        odd.append(
            (
                "energy_J",
                off,
                "the energy M V²/2 of the stated mass and velocity, within 5 %",
                "Which is right?",
            )
        )
    return [
        Problem(
            FILE,
            expected,
            f"{question} {where.sum()} of {len(rows)} impacts are like this.",
            row=int(rows[first]),
            column=name,
            value=float(table[name].iloc[first]),
            impact=str(table["impact"].iloc[first]) or None,
            code="unusual-value",
        )
        for name, where, expected, question in odd
        if where.any()
        for first in [int(np.argmax(where))]
    ]
