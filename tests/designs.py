"""A design with two sides a person, sessions, operators and a covariate, and its matrices by hand."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import pandas as pd
import xarray as xr

from bayestissue.inference.answers.contrasts import Contrasts, contrasts_table
from bayestissue.inference.answers.law import Law
from bayestissue.inference.answers.study import Study
from bayestissue.inference.results.labels import design_variables, labelled
from bayestissue.model.hierarchy import derived
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


def normal_draws(
    seed: int,
    sd: float,
    values: Mapping[str, float | Sequence[float]],
    shape: tuple[int, int] = (2, 500),
    **levels: tuple[str, Sequence[str]],
) -> xr.Dataset:
    """Independent normal draws about ``values``, those of a list along the dimension of ``levels``."""
    rng, found = np.random.default_rng(seed), {}
    for name, value in values.items():
        at = np.asarray(value, float)
        dims = ("chain", "draw", *([levels[name][0]] if name in levels else []))
        found[name] = (dims, at + sd * rng.standard_normal((*shape, *at.shape)))
    return xr.Dataset(found, {"chain": range(shape[0]), "draw": range(shape[1]), **dict(levels.values())})


def labelled_draws(design: Design, population: Mapping[str, np.ndarray]) -> xr.Dataset:
    """What follows from draws of coefficients, spreads and effects, with its names, levels and units."""
    values = derived.formula_quantities(design, population)
    values |= derived.level_quantities(design, values)
    return labelled(values, design.levels(), design_variables(design))


def any_draws(design: Design, rng: np.random.Generator, shape: tuple[int, int]) -> xr.Dataset:
    """Such draws from standard normals; impacts do not scatter, so that a predicted one is expected."""
    population: dict[str, np.ndarray] = {"residual_correlation": np.zeros(shape)}
    for q, part in design.responses.items():
        population |= {name: rng.normal(size=shape) for name in (f"intercept_{q}", f"mass_exponent_{q}")}
        population[f"covariate_effect_{q}"] = rng.normal(size=(*shape, len(part.names)))
        population[f"sd_impact_{q}"] = np.zeros(shape)
        for term in part.terms:
            levels = len(design.groupings[term.grouping].levels)
            population[term.sd(q)] = rng.uniform(size=shape)
            population[term.effect(q)] = rng.normal(size=(*shape, levels))
    return labelled_draws(design, population)
