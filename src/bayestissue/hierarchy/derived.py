"""What the hierarchy's draws say of K and C: for impacts, people, conditions, and a new person."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd

from bayestissue.hierarchy.design import Design
from bayestissue.hierarchy.effects import RESPONSES
from bayestissue.hierarchy.formula import GROUPS

Draws = Mapping[str, np.ndarray]


def reported_sites(design: Design, sites: Draws) -> dict[str, np.ndarray]:
    """The sampled quantities that the model's formulas really use, each [chain, draw, ...].

    Coefficients of covariates are given per unit of the covariate, not per standard deviation.
    """
    kept: dict[str, np.ndarray] = {}
    for response in RESPONSES:
        part = design.responses[response]
        kept[f"intercept_{response}"] = sites[f"intercept_{response}"]
        if part.log_mass is not None:
            kept[f"mass_exponent_{response}"] = sites[f"mass_exponent_{response}"]
        for number, name in enumerate(part.names):
            column = sites[f"covariate_effect_{response}"][..., number]
            kept[f"effect_of_{name}_{response}"] = column / part.scale[number]
        for group in part.groups:
            kept[f"sd_{group}_{response}"] = sites[f"sd_{group}_{response}"]
            kept[f"{group}_effect_{response}"] = sites[f"{group}_effect_{response}"]
        kept[f"sd_impact_{response}"] = sites[f"sd_impact_{response}"]
    if "residual_correlation" in sites:
        kept["residual_correlation"] = sites["residual_correlation"]
    return kept


def group_effect(design: Design, sites: Draws, group: str, response: str) -> np.ndarray:
    """A group's effects [chain, draw, group]; zero where the formula has none."""
    effects = sites[f"{group}_effect_{response}"]
    return effects if group in design.responses[response].groups else np.zeros_like(effects)


def common_logs(
    design: Design, sites: Draws, response: str, rows: np.ndarray | slice = slice(None)
) -> np.ndarray:
    """Intercept, mass and covariates: the expected log of a typical person's K or C, [chain, draw, row]."""
    part = design.responses[response]
    expected = sites[f"intercept_{response}"][..., None] + np.zeros(len(design.subject[rows]))
    if part.log_mass is not None:
        expected = expected + sites[f"mass_exponent_{response}"][..., None] * part.log_mass[rows]
    if part.names:
        effects = sites[f"covariate_effect_{response}"][..., : len(part.names)]
        expected = expected + effects @ part.covariates[rows].T
    return expected


def row_logs(design: Design, sites: Draws, response: str) -> np.ndarray:
    """The expected log of K or C in every row, [chain, draw, row]."""
    return (
        common_logs(design, sites, response)
        + group_effect(design, sites, "subject", response)[..., design.subject]
        + group_effect(design, sites, "trial", response)[..., design.trial]
    )


def stiffness_and_damping(design: Design, sites: Draws) -> dict[str, np.ndarray]:
    """K and C of every row, person and condition; ``*_row`` [chain, draw, row] and so on.

    See `people_and_conditions`. All are medians over the impact's own scatter.
    """
    rows = {f"{response}_row": np.exp(row_logs(design, sites, response)) for response in RESPONSES}
    return rows | people_and_conditions(design, sites)


def people_and_conditions(design: Design, sites: Draws) -> dict[str, np.ndarray]:
    """K and C of every person and condition, ``*_subject`` [chain, draw, subject] and ``*_trial``.

    A person's value is at the reference mass, a condition's is a typical person's.
    """
    values = {}
    first = np.unique(design.trial, return_index=True)[1]
    for response in RESPONSES:
        intercept = sites[f"intercept_{response}"][..., None]
        values[f"{response}_subject"] = np.exp(intercept + group_effect(design, sites, "subject", response))
        typical = common_logs(design, sites, response, first)
        values[f"{response}_trial"] = np.exp(typical + group_effect(design, sites, "trial", response))
    return values


def new_impact(design: Design, sites: Draws, rng: np.random.Generator) -> dict[str, np.ndarray]:
    """K and C of one new impact, on a new person, in a new condition at the reference mass, [chain, draw]."""
    shape = sites["intercept_K"].shape
    scatter = rng.standard_normal((2, *shape))
    r = sites.get("residual_correlation", np.zeros(shape))
    scatter[1] = r * scatter[0] + np.sqrt(1 - r**2) * scatter[1]
    values = {}
    for number, response in enumerate(RESPONSES):
        log = sites[f"intercept_{response}"] + sites[f"sd_impact_{response}"] * scatter[number]
        for group in GROUPS:
            present = float(group in design.responses[response].groups)
            log = log + present * sites[f"sd_{group}_{response}"] * rng.standard_normal(shape)
        values[f"{response}_new"] = np.exp(log)
    return values


def straight_lines(design: Design, sites: Draws, mass_kg: np.ndarray) -> dict[str, np.ndarray]:
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
        half_variance = sites[f"sd_impact_{response}"][..., None] ** 2 / 2
        means = np.exp(row_logs(design, sites, response) + half_variance) @ membership
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
