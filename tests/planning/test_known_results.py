"""Planned studies against what is known of designs: published assurances, powers and sizes.

All of it goes the general way: impacts of log K and log C on a design, effects and spreads estimated by the
engine, questions asked of draws. Measurement errors are tiny, and what a formula takes as known is known.
Bounds are three Monte Carlo standard errors of the studies.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest

from bayestissue.inference.answers.law import Law
from bayestissue.model.hierarchy.design import Design, build_design
from bayestissue.model.hierarchy.specification import specification_of
from bayestissue.studies.planning.assurance import Goal, Planner
from bayestissue.studies.planning.design_prior import BLOCK, Streams, Truths
from bayestissue.studies.planning.information import Information
from bayestissue.studies.planning.studies import Arrangement
from bayestissue.studies.planning.study_posterior import PlannedModel, planned_model

pytestmark = pytest.mark.slow

FLAT = 1e7
TINY = 1e-4


@dataclass(frozen=True)
class Stated:
    """Truths that a test states: spreads that are known, and fixed effects drawn by ``effects``."""

    spreads: Mapping[str, float]
    effects: Callable[[Streams, Design], dict[str, np.ndarray]]

    def truths(self, model: PlannedModel, design: Design, streams: Streams) -> Truths:
        spreads = {name: np.full(BLOCK, self.spreads.get(name, TINY)) for name in model.hyperparameters}
        if "residual_correlation" in spreads:
            spreads["residual_correlation"] = np.zeros(BLOCK)
        return Truths(spreads, self.effects(streams, design))


@dataclass(frozen=True)
class KnownModel(PlannedModel):
    """An analysis that knows its standard deviations; of its one coordinate nothing depends."""

    known: tuple[tuple[str, float], ...] = ()

    def at(self, y: jax.Array) -> tuple[dict[str, jax.Array], jax.Array]:
        return {name: jnp.asarray(value) for name, value in self.known}, -(y**2).sum() / 2

    def unconstrained(self, values: Mapping[str, Any]) -> np.ndarray:
        return np.zeros((BLOCK, 1))


def study(
    rows: pd.DataFrame,
    formula: str,
    spreads: Mapping[str, float],
    effects: Callable[[Streams, Design], dict[str, np.ndarray]],
    *,
    on_C: str = "1",
    known: bool = True,
) -> Planner:
    flat = {"distribution": "normal", "mean": 0.0, "sd": FLAT}
    wide = {"distribution": "half-normal", "scale": 5.0}
    content = {
        "likelihood": "impact",
        "formula": {"K": formula, "C": on_C},
        "residual_correlation": False,
        "priors": {
            "intercept": {"K": flat, "C": flat},
            "covariate": {"K": flat, "C": flat},
            "sd_subject": {"K": wide, "C": wide},
            "sd_impact": {"K": wide, "C": wide},
        },
    }
    specification = specification_of(content, "known")
    design = build_design(specification.formula, rows, reference_mass_kg=1.0, source="known")
    model, columns = planned_model(specification, design)
    if known:
        stated = tuple((name, float(spreads.get(name, TINY))) for name in model.hyperparameters)
        model = KnownModel(**vars(model), known=stated)
    precision = np.broadcast_to(1e10 * np.eye(2), (len(rows), 2, 2))
    conditions = rows[["mass_kg", "velocity_m_s"]].drop_duplicates(ignore_index=True)
    present = np.ones((1, len(rows)), bool)
    arrangement = Arrangement((0,), rows, present, design, model, columns, precision, np.zeros((0, 2)))
    information = Information(conditions, precision[:1, None], 1.0)
    return Planner([arrangement], information, Stated(spreads, effects), 3, Law())


def impacts(people: int, repeats: int = 1, **columns: Any) -> pd.DataFrame:
    subject = np.repeat([f"s{number:03d}" for number in range(people)], repeats)
    return pd.DataFrame({"subject": subject, "trial": "t", "mass_kg": 1.0, "velocity_m_s": 1.0, **columns})


def within(share: float, expected: float, studies: int) -> bool:
    return abs(share - expected) < 3 * np.sqrt(expected * (1 - expected) / studies)


@pytest.mark.parametrize(
    ("probability", "expected"), [(0.975, 0.70026), pytest.param(0.95, 0.72509, marks=pytest.mark.long)]
)
def test_two_arms_cost_effectiveness(probability: float, expected: float) -> None:
    # O'Hagan and Stevens (2001): effects are log K here, and costs log C.
    mean = np.array([5.0, 6000.0, 6.5, 7200.0])
    V = np.array([[4, 0, 3, 0], [0, 1e7, 0, 0], [3, 0, 4, 0], [0, 0, 0, 1e7]])

    def effects(streams: Streams, design: Design) -> dict[str, np.ndarray]:
        drawn = mean + streams.normal("means", 4) @ np.linalg.cholesky(V).T
        (scale,) = design.responses["K"].scale
        return {
            "intercept_K": drawn[:, :1],
            "intercept_C": drawn[:, 1:2],
            "covariate_effect_K": scale * (drawn[:, 2:3] - drawn[:, :1]),
            "covariate_effect_C": scale * (drawn[:, 3:] - drawn[:, 1:2]),
        }

    rows = impacts(570, arm=np.repeat(["a", "b"], 285))
    planner = study(rows, "arm", {"sd_impact_K": 4.04, "sd_impact_C": 8700.0}, effects, on_C="arm")
    goal = Goal("goal", "20000 * `effect_of_arm[b]_K` > `effect_of_arm[b]_C`")
    ((assessment,),) = planner.assess([goal], range(3000 // BLOCK), probability=probability)
    assert within(float(assessment.yes.mean()), expected, 3000)
    # With however many people no more can be said than is true.
    assert within(float(assessment.table["true"].mean()), 0.84273, 3000)


def power_by_grid(people: int, repeats: int, icc: float, least: float, prior: str, studies: int) -> float:
    """How often P(ICC > least) is above 0.95, each posterior summed over a grid of the two spreads.

    A study tells the spreads by its sums of squares, within and between people, which are drawn.
    """
    random = np.random.default_rng(8)
    within_df, between_df = people * (repeats - 1), people - 1
    squares = (1 - icc) * random.chisquare(within_df, studies)
    between = (1 - icc + repeats * icc) * random.chisquare(between_df, studies)
    grid = np.geomspace(0.02, 4.0, 400)
    impact, person = (axis.ravel() for axis in np.meshgrid(grid, grid, indexing="ij"))
    w, m = impact**2, impact**2 + repeats * person**2
    # Cells are as wide as their place.
    log_prior = np.log(impact * person) - (impact**2 + person**2) / (2 * 5.0**2)
    if prior == "matching":
        # Flat in the logs of the two mean squares, as the F test is: 1 / (w m) of the variances.
        log_prior = np.log(impact**2 * person**2) - np.log(w) - np.log(m)
    fixed = log_prior - within_df / 2 * np.log(w) - between_df / 2 * np.log(m)
    above = person**2 / (person**2 + w) > least
    yes = 0
    for x, y in zip(squares, between, strict=True):
        log_density = fixed - x / (2 * w) - y / (2 * m)
        density = np.exp(log_density - log_density.max())
        yes += density[above].sum() > 0.95 * density.sum()
    return yes / studies


def test_the_power_to_tell_intraclass_correlations_apart() -> None:
    """Walter, Eliasziw and Donner (1998): 39 people twice, to tell 0.8 from 0.6 by an F test at 5 %: 0.8.

    The analysis of a fit has priors that are flat in each standard deviation, not in the logs of the mean
    squares, and so is more careful: it answers less often, as a sum over a grid does with either prior.
    """
    spreads = {"sd_subject_K": np.sqrt(0.8), "sd_impact_K": np.sqrt(0.2)}
    nothing = {f"intercept_{q}": np.zeros((BLOCK, 1)) for q in "KC"}
    planner = study(impacts(39, 2), "(1|subject)", spreads, lambda *_: nothing, known=False)
    ((assessment,),) = planner.assess([Goal("icc", "ICC_C1_K > 0.6")], range(10))
    by_grid = {prior: power_by_grid(39, 2, 0.8, 0.6, prior, 1000) for prior in ("flat", "matching")}
    assert within(by_grid["matching"], 0.8, 1000)
    # Both shares are of a thousand studies.
    assert abs(assessment.yes.mean() - by_grid["flat"]) < 3 * np.sqrt(2 * 0.7 * 0.3 / 1000)
