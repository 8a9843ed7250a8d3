"""A design with two sides a person, sessions, operators and a covariate, and its matrices by hand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pandas as pd
import xarray as xr

from bayestissue.inference.answers.contrasts import Contrasts, contrasts_table
from bayestissue.inference.answers.law import Law
from bayestissue.inference.answers.study import Study
from bayestissue.model.hierarchy.design import Design, build_design
from bayestissue.model.hierarchy.recorded import Recorded
from bayestissue.model.hierarchy.specification import Formulas

REFERENCE = 0.8
EVERYTHING = "log(mass_kg) + (log(mass_kg)|subject) + (1|subject:side) + (1|session) + (1|operator)"


def impacts(people: int = 4, repeats: int = 2) -> pd.DataFrame:
    """People hit on both sides in three conditions, in sessions and by operators drawn at random."""
    rows = pd.DataFrame(
        [
            (f"s{person}", f"t{trial}", side, mass, 20.0 + 3 * person)
            for person in range(people)
            for trial, mass in enumerate([0.5, 0.8, 1.2])
            for side in ("left", "right")
            for _ in range(repeats)
        ],
        columns=["subject", "trial", "side", "mass_kg", "age"],
    )
    rng = np.random.default_rng(people)
    return rows.assign(
        impact=[f"i{number}" for number in range(len(rows))],
        session=rng.permutation(np.resize([1, 2, 3], len(rows))),
        operator=rng.permutation(np.resize(["x", "y"], len(rows))),
        room=rng.uniform(15, 25, len(rows)),
    )


def design_of(K: str, C: str | None = None, rows: pd.DataFrame | None = None, **further: str) -> Design:
    """The design of one formula, or of two, and of further parameters'."""
    table = impacts() if rows is None else rows
    formulas = Formulas(K=K, C=K if C is None else C, **further)
    return build_design(formulas, table, reference_mass_kg=REFERENCE, source="m.toml")


def indicator(rows: pd.DataFrame, *columns: str) -> np.ndarray:
    """A column of 0 and 1 for each combination of columns, in order of appearance."""
    keys = [tuple(row) for row in rows[list(columns)].itertuples(index=False)]
    return np.array([[float(key == level) for level in dict.fromkeys(keys)] for key in keys])


def contrasts(
    draws: xr.Dataset, of: Recorded, responses: Sequence[str], equivalence: float, law: Law | None = None
) -> pd.DataFrame:
    """Every contrast of what was recorded."""
    of = replace(of, formulas={q: of.formulas[q] for q in responses})
    return contrasts_table(Contrasts(Study(draws, of, law or Law(described=False))), equivalence)
