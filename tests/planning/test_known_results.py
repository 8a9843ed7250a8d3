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
from scipy.stats import norm

from bayestissue.inference.answers.law import Law
from bayestissue.model.hierarchy.design import Design, build_design
from bayestissue.model.hierarchy.specification import specification_of
from bayestissue.studies.planning.assurance import Assessment, Goal, Planner
from bayestissue.studies.planning.information import Information
from bayestissue.studies.planning.planned_population import BLOCK, Streams, Truths
from bayestissue.studies.planning.studies import Arrangement, draw_studies
from bayestissue.studies.planning.study_model import PlannedModel, planned_model
from bayestissue.studies.planning.study_posterior import PlannedSites, posteriors

pytestmark = pytest.mark.slow

FLAT = 1e4
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
    priors: Mapping[str, Any] | None = None,
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
            **(priors or {}),
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


def answered(planner: Planner, question: str, studies: int, probability: float) -> Assessment:
    goal = Goal("goal", question)
    ((assessment,),) = planner.assess([goal], range(studies // BLOCK), probability=probability)
    return assessment


def within(share: float, expected: float, studies: int) -> bool:
    return abs(share - expected) < 3 * np.sqrt(expected * (1 - expected) / studies)


def of_intercepts(K: float) -> Callable[[Streams, Design], dict[str, np.ndarray]]:
    return lambda *_: {"intercept_K": np.full((BLOCK, 1), K), "intercept_C": np.zeros((BLOCK, 1))}


LONG = pytest.mark.long


@pytest.mark.parametrize(
    ("probability", "expected"), [(0.975, 0.8730452), pytest.param(0.95, 0.9273056, marks=LONG)]
)
def test_of_a_normal_mean_assurance_is_power(probability: float, expected: float) -> None:
    # n = 100, variance 0.104, a design prior worth so many observations that it is a point.
    planner = study(impacts(100), "1", {"sd_impact_K": np.sqrt(0.104)}, of_intercepts(0.1))
    assessment = answered(planner, "intercept_K > 0", 6000, probability)
    assert within(float(assessment.yes.mean()), expected, 6000)


@pytest.mark.parametrize(
    ("probability", "expected"), [(0.975, 0.70026), pytest.param(0.95, 0.72509, marks=LONG)]
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
    flat = {"distribution": "normal", "mean": 0.0, "sd": 1e7}
    planner = study(
        rows,
        "arm",
        {"sd_impact_K": 4.04, "sd_impact_C": 8700.0},
        effects,
        on_C="arm",
        priors={"intercept": {"K": flat, "C": flat}, "covariate": {"K": flat, "C": flat}},
    )
    question = "20000 * `effect_of_arm[b]_K` > `effect_of_arm[b]_C`"
    assessment = answered(planner, question, 3000, probability)
    assert within(float(assessment.yes.mean()), expected, 3000)
    # With however many people no more can be said than is true.
    assert within(float(assessment.true.mean()), 0.84273, 3000)


@pytest.mark.parametrize(
    ("people", "expected"),
    [(20, 0.2346)]
    + [pytest.param(*row, marks=LONG) for row in ((40, 0.5247), (60, 0.8205), (80, 0.9667), (100, 0.9974))],
)
def test_adcock_precision(people: int, expected: float) -> None:
    """The probability that the sample's mean is within 0.2 of the parameter, with 95 % of the posterior."""
    variance, studies = 0.265, 2000
    sd = np.sqrt(variance)

    def effects(streams: Streams, _: Design) -> dict[str, np.ndarray]:
        mean = 0.9 + sd / np.sqrt(10) * streams.normal("mean", 1)
        return {"intercept_K": mean, "intercept_C": np.zeros((BLOCK, 1))}

    # What the analysis believes is worth 20 observations.
    prior = {"distribution": "normal", "mean": 0.64, "sd": sd / np.sqrt(20)}
    flat = {"distribution": "normal", "mean": 0.0, "sd": FLAT}
    planner = study(
        impacts(people),
        "1",
        {"sd_impact_K": sd},
        effects,
        priors={"intercept": {"K": prior, "C": flat}},
    )
    (arrangement,) = planner.arranged
    reached = []
    for block in range(studies // BLOCK):
        streams = Streams(3, block)
        truths = planner.prior.truths(arrangement.model, arrangement.design, streams)
        drawn = draw_studies(arrangement, truths, streams)
        sites = PlannedSites(
            arrangement.model,
            arrangement.columns,
            arrangement.precision,
            drawn.centre,
            np.ones(drawn.centre.shape[:2], bool),
        )
        b = posteriors(sites, np.zeros((BLOCK, 1))).b[..., 0]
        near = np.abs(b - drawn.centre[:, :, 0].mean(axis=1, keepdims=True)) <= 0.2
        reached.append(near.mean(axis=1) >= 0.95)
    assert within(float(np.mean(reached)), expected, studies)


def two_slopes(times: np.ndarray, spreads: Mapping[str, float], difference: float) -> Planner:
    """Two groups of ten whose means change over time by slopes that differ, and whose people's slopes do."""
    people, repeats = 20, len(times)
    group = np.repeat(["a", "b"], people * repeats // 2)
    rows = impacts(people, repeats, time=np.tile(times, people), group=group)

    def effects(_: Streams, design: Design) -> dict[str, np.ndarray]:
        part = design.responses["K"]
        values = np.zeros((BLOCK, len(part.names)))
        number = part.names.index("group[b]:time")
        values[:, number] = difference * part.scale[number]
        return {**of_intercepts(0.0)(_, design), "covariate_effect_K": values}

    # A slope's spread is per standard deviation of time.
    spread = spreads.get("slope", 0.0) * times.std()
    known = {"sd_subject_effect_of_time_K": spread} if spread else {}
    formula = f"group * time + ({'time' if spread else '1'}|subject)"
    return study(
        rows,
        formula,
        {"sd_subject_K": spreads["intercept"], "sd_impact_K": spreads["impact"], **known},
        effects,
    )


def power_of_slopes(planner: Planner, studies: int, probability: float) -> float:
    assessment = answered(planner, "`effect_of_group[b]:time_K` > 0", studies, probability)
    return float(assessment.yes.mean())


def test_slopes_of_each_person_in_two_groups() -> None:
    # Power of 0.8 at 207.31 people a group: ten a group tell as much of a difference that is as much
    # greater. Intercepts differ so much that they tell nothing of slopes.
    difference = 1.5 * np.sqrt(207.31 / 10)
    spreads = {"intercept": 1e3, "slope": np.sqrt(24), "impact": np.sqrt(10)}
    planner = two_slopes(np.arange(7) / 4, spreads, difference)
    assert within(power_of_slopes(planner, 1000, 0.975), 0.8, 1000)


@pytest.mark.parametrize(
    ("correlation", "variance", "people"),
    [
        pytest.param(
            correlation, variance, people, marks=[] if (correlation, variance) == (0.5, 100) else LONG
        )
        for correlation, row in ((0.2, (313, 625, 938)), (0.5, (196, 391, 586)), (0.8, (79, 157, 235)))
        for variance, people in zip((100, 200, 300), row, strict=True)
    ],
)
def test_slopes_of_correlated_measurements(correlation: float, variance: float, people: int) -> None:
    """Diggle's table: people a group for a power of 0.8, one-sided 5 %, of slopes that differ by 0.5."""
    spreads = {"intercept": np.sqrt(correlation * variance), "impact": np.sqrt((1 - correlation) * variance)}
    times = np.array([0.0, 2.0, 5.0])
    power = power_of_slopes(two_slopes(times, spreads, 0.5 * np.sqrt(people / 10)), 2000, 0.95)

    def exact(people: int) -> float:
        squares = np.square(times - times.mean()).sum()
        return float(
            norm.cdf(0.5 * np.sqrt(people * squares / (2 * (1 - correlation) * variance)) - norm.ppf(0.95))
        )

    # The table's numbers are rounded up, so that the power there is a little more.
    assert exact(people - 1) < 0.8 <= exact(people)
    assert within(power, exact(people), 2000)


@pytest.mark.parametrize(
    ("people", "repeats", "icc", "width"), [(19, 4, 0.85, 0.2), pytest.param(35, 3, 0.8, 0.2, marks=LONG)]
)
def test_the_width_of_an_intraclass_correlation(people: int, repeats: int, icc: float, width: float) -> None:
    """Bonett (2002): 19.15 people, and Shoukri and others (2004): 35, for a 95 % interval of 0.2.

    They approximate the expected width by that at the planned value. The interval here is of the posterior,
    and its width is averaged over studies, whose estimates scatter about that value: where the correlation
    comes out lower the interval is wider by more than it is narrower where it comes out higher.
    """
    spreads = {"sd_subject_K": np.sqrt(icc), "sd_impact_K": np.sqrt(1 - icc)}
    planner = study(impacts(people, repeats), "(1|subject)", spreads, of_intercepts(0.0), known=False)
    goal = Goal("icc", "ICC_C1_K", width=width / 2, level=0.95)
    ((assessment,),) = planner.assess([goal], range(4))
    mean = 2 * assessment.width.mean()
    assert 1.0 <= mean / width < 1.25
    assert abs(np.median(2 * assessment.width) / width - 1) < 0.15


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
    planner = study(impacts(39, 2), "(1|subject)", spreads, of_intercepts(0.0), known=False)
    ((assessment,),) = planner.assess([Goal("icc", "ICC_C1_K > 0.6")], range(10))
    by_grid = {prior: power_by_grid(39, 2, 0.8, 0.6, prior, 1000) for prior in ("flat", "matching")}
    assert within(by_grid["matching"], 0.8, 1000)
    # Both shares are of a thousand studies.
    assert abs(assessment.yes.mean() - by_grid["flat"]) < 3 * np.sqrt(2 * 0.7 * 0.3 / 1000)
