"""What the hierarchy's draws say of K, C and what else has a formula: of people, conditions, a new person."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
import xarray as xr
from jaxtyping import Float

from bayestissue.model.hierarchy.design import Design
from bayestissue.model.hierarchy.formulas.group_terms import SUBJECT, TRIAL, common_coefficient, stem_of
from bayestissue.model.hierarchy.levels import design_at
from bayestissue.model.hierarchy.population import MASS_ERROR, EffectParts
from bayestissue.model.hierarchy.recorded import Condition
from bayestissue.model.hierarchy.responses import RESPONSES, intercept, sd_impact

# Hyperparameters and effects, or quantities, by name, each [chain, draw, ...].
type Draws = Mapping[str, np.ndarray]


def effects_by_name(
    parts: EffectParts, design: Design, b: Float[np.ndarray, "chain draw location"]
) -> dict[str, np.ndarray]:
    """Fixed and group effects by name, [chain, draw, ...], without the levels that only fill up."""
    levels = {
        term.effect(response): len(design.groupings[term.grouping].levels)
        for response, part in design.responses.items()
        for term in part.terms
    }
    effects = {}
    for block in parts.blocks:
        part = parts.parts[block.name]
        several = block.spread or block.name == MASS_ERROR or block.name.startswith("covariate_effect")
        effects[block.name] = b[..., part][..., : levels.get(block.name)] if several else b[..., part.start]
    return effects


def formula_quantities(design: Design, population: Draws) -> dict[str, np.ndarray]:
    """The hyperparameters and effects that the model's formulas really use, each [chain, draw, ...].

    Coefficients of covariates are given per unit of the covariate, not per standard deviation.
    """
    quantities: dict[str, np.ndarray] = {}
    for response, part in design.responses.items():
        quantities[intercept(part.parameter)] = population[intercept(part.parameter)]
        if part.log_mass is not None:
            quantities[f"mass_exponent_{response}"] = population[f"mass_exponent_{response}"]
        for number, name in enumerate(part.names):
            column = population[f"covariate_effect_{response}"][..., number]
            quantities[common_coefficient(name, response)] = column / part.scale[number]
        for term, group in part.terms.items():
            quantities[term.sd(response)] = population[term.sd(response)] / group.scale
            if not term.slope:
                quantities[term.effect(response)] = population[term.effect(response)]
                continue
            deviation = population[term.effect(response)] / group.scale
            # 0 where the formula has no coefficient but the levels' own.
            shared = quantities.get(common_coefficient(term.slope, response), 0.0)
            quantities[term.coefficient(response)] = deviation + np.asarray(shared)[..., None]
        quantities[sd_impact(part.parameter)] = population[sd_impact(part.parameter)]
    if "residual_correlation" in population:
        quantities["residual_correlation"] = population["residual_correlation"]
    return quantities


def row_logs(design: Design, population: Draws, response: str) -> np.ndarray:
    """The expected log of a response in every row, [chain, draw, row]."""
    part = design.responses[response]
    expected: np.ndarray = np.zeros(())
    for name, columns in part.fixed.items():
        effects = np.reshape(population[name], (*population[intercept(part.parameter)].shape, -1))
        expected = expected + effects[..., : columns.shape[1]] @ columns.T
    for term, column in part.terms.items():
        code = design.groupings[term.grouping].code
        expected = expected + population[term.effect(response)][..., code] * column.covariate
    return expected


def level_quantities(design: Design, quantities: Draws) -> dict[str, np.ndarray]:
    """Every response of every level, [chain, draw, level]: see `bayestissue.model.hierarchy.levels`.

    A response stands by its name and what it is of: ``K_subject``, ``K_subject_side``, ``K_side`` of a
    covariate with categories, and ``K_typical_person`` [chain, draw]. All are at the reference mass, but a
    condition's at its own mass and velocity; all are medians over the impact's own scatter.
    """
    draws, recorded = labelled_draws(design, quantities), design.recorded
    values = {}
    for response in design.responses:
        conditions_of: dict[str, list[Condition]] = {
            stem_of(name): recorded.conditions_of(grouping) for name, grouping in design.groupings.items()
        }
        for name in recorded.response(response).named_by:
            conditions_of[stem_of(name)] = [{name: level} for level in recorded.rows[name].drop_duplicates()]
        for stem, conditions in conditions_of.items():
            values[f"{response}_{stem}"] = np.exp(design_at(recorded, response, conditions).log(draws))
        typical = design_at(recorded, response, [{}]).log(draws)
        values[f"{response}_typical_person"] = np.exp(typical[..., 0])
    return values


def typical_covariates(design: Design, response: str) -> np.ndarray:
    """The covariates of a typical person, as the design has them, [covariate]: means over categories."""
    part = design.responses[response]
    typical = design_at(design.recorded, response, [{}])
    return np.array([typical.covariates[name][0] for name in part.names]) / part.scale


def typical_logs(design: Design, population: Draws, response: str) -> np.ndarray:
    """The log of a typical person's response at the reference mass, [chain, draw]."""
    draws = labelled_draws(design, formula_quantities(design, population))
    return design_at(design.recorded, response, [{}]).log(draws)[..., 0]


def labelled_draws(design: Design, quantities: Draws) -> xr.Dataset:
    """What `formula_quantities` has, with the levels of each group term's effects."""
    levels = {term.variable(q): term.grouping for q, part in design.responses.items() for term in part.terms}
    coords = {name: list(design.groupings[name].levels) for name in set(levels.values())}
    return xr.Dataset(
        {k: (("chain", "draw", *([levels[k]] if k in levels else [])), v) for k, v in quantities.items()},
        coords,
    )


def new_impact(
    design: Design, population: Draws, typical: Mapping[str, np.ndarray], rng: np.random.Generator
) -> dict[str, np.ndarray]:
    """K and C of one new impact at the reference mass, [chain, draw].

    Every grouping has a new level: a new person, a new condition. A covariate whose coefficient differs
    between levels is zero there. ``typical`` has the K and C of a typical person, ``K_typical_person``.
    """
    shape = typical["K_typical_person"].shape
    scatter = rng.standard_normal((2, *shape))
    r = population.get("residual_correlation", np.zeros(shape))
    scatter[1] = r * scatter[0] + np.sqrt(1 - r**2) * scatter[1]
    values = {}
    for number, response in enumerate(RESPONSES):
        log = (
            np.log(typical[f"{response}_typical_person"])
            + population[f"sd_impact_{response}"] * scatter[number]
        )
        terms = [term for term in design.responses[response].terms if not term.slope]
        # Numbers of both are drawn whether a formula has them or not, so that the others stay the same.
        for term in dict.fromkeys((SUBJECT, TRIAL, *terms)):
            standard = rng.standard_normal(shape)
            if term in terms:
                log = log + population[term.sd(response)] * standard
        values[f"{response}_new"] = np.exp(log)
    return values


def lines_of_means(design: Design, population: Draws, mass_kg: np.ndarray) -> dict[str, np.ndarray]:
    """The least-squares line through the conditions' mean K (and C) against mass, for each draw.

    A condition's mean is over its people and over the impact's lognormal scatter, as an average of
    estimates is: the straight line that the thesis fitted, with its uncertainty. ``mass_kg`` [row].
    """
    trials = len(design.trials)
    counts = np.bincount(design.trial, minlength=trials)
    mass = np.bincount(design.trial, weights=mass_kg, minlength=trials) / counts
    membership = (design.trial[:, None] == np.arange(trials)) / counts
    values = {}
    for response in RESPONSES:
        half_variance = population[f"sd_impact_{response}"][..., None] ** 2 / 2
        means = np.exp(row_logs(design, population, response) + half_variance) @ membership
        slope = (means @ (mass - mass.mean())) / np.sum((mass - mass.mean()) ** 2)
        values[f"linear_slope_{response}"] = slope
        values[f"linear_intercept_{response}"] = means.mean(-1) - slope * mass.mean()
    return values


def hypotheses(exponents: Mapping[str, np.ndarray], half_width: float) -> pd.DataFrame:
    """Posterior probabilities that a mass exponent equals 0 or 1 in practice.

    0 is a tissue of fixed stiffness; 1 a natural frequency that mass does not change. Each stands for
    the region within ``half_width`` of it; the rest is named, so that the probabilities add up to 1.
    """
    infinite = np.inf
    regions = [
        ("below both", np.nan, -infinite, -half_width),
        ("fixed stiffness", 0.0, -half_width, half_width),
        ("between", np.nan, half_width, 1 - half_width),
        ("constant natural frequency", 1.0, 1 - half_width, 1 + half_width),
        ("above both", np.nan, 1 + half_width, infinite),
    ]
    rows = [
        (response, name, value, low, high, float(np.mean((draws >= low) & (draws < high))))
        for response, draws in exponents.items()
        for name, value, low, high in regions
    ]
    return pd.DataFrame(
        rows, columns=["quantity", "hypothesis", "value", "rope_low", "rope_high", "probability"]
    )
