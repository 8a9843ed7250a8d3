"""The importance ratios of few points are those of many, for all impacts together."""

from __future__ import annotations

from pathlib import Path
from tomllib import loads

import numpy as np

from bayestissue.hierarchy.specification import Sampler, read_specification
from bayestissue.hierarchy.trace_data import prepare
from bayestissue.inference.factors.conditional import ConditionalPrior, of_cells, standard_points
from bayestissue.inference.factors.importance_ratios import (
    importance_ratios,
    log_evidence_corrections,
    ratios_among,
)
from bayestissue.inference.factors.expansions import approximate
from bayestissue.inference.posterior.recipe import Problem, population_attempt
from bayestissue.simulation import simulate
from bayestissue.simulation.specification import Simulation
from campaigns import FOUR_BY_FOUR

MODEL = Path(__file__).parents[3] / "models" / "impact.toml"
SETTINGS, SEED, MANY = Sampler(chains=2, warmup=100, draws=100), 2, 2048
# Of a posterior standard deviation.
MOST_SHIFT = 0.1


def test_few_points_shift_no_posterior_mean() -> None:
    """A table that is off by little, and by the same for every impact, moves what the impacts share.

    With log weights that are off by d, no posterior mean moves by more than sd(d) of its standard deviation,
    by Cauchy and Schwarz.
    """
    specification = read_specification(MODEL)
    dataset = simulate(Simulation.model_validate(loads(FOUR_BY_FOUR))).dataset("few and many")
    prepared = prepare(dataset, specification, source="model")
    approximation = approximate(prepared)
    problem = Problem(prepared, SETTINGS, SEED, np.random.default_rng(SEED))
    draws = population_attempt(problem, approximation).draws
    design = prepared.data.design
    priors = of_cells(draws.priors(design), np.asarray(design.cell))
    where = prepared.model, prepared.data, approximation.sites
    again = np.resize(np.arange(len(priors.mean)), MANY)
    by_many = importance_ratios(
        *where,
        ConditionalPrior(*(part[again] for part in priors)),
        standard_points(approximation.sites.centre.shape[1], MANY),
        approximation.grid,
    )
    by_few = ratios_among(*where, priors, approximation.grid)
    few, many = (
        np.asarray(log_evidence_corrections(approximation.sites, ratios, priors)).sum(-1)
        for ratios in (by_few, by_many)
    )
    assert (few - many).std() < MOST_SHIFT
