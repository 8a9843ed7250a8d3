"""The Bayesian re-analysis of published estimates, from model file and tables to labelled results."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import numpyro.distributions as dist
import pandas as pd
import xarray as xr
from numpyro.infer import Predictive
from scipy.special import logsumexp

from bayestissue.hierarchy import derived
from bayestissue.hierarchy.design import Design
from bayestissue.hierarchy.effects import RESPONSES, cholesky_factor, design_arrays
from bayestissue.hierarchy.formula import GROUPS
from bayestissue.hierarchy.published import (
    PublishedObservations,
    log_density_of_averages,
    log_density_of_estimates,
    observed_arrays,
    published_design,
    published_model,
)
from bayestissue.hierarchy.specification import Formulas, ModelSpecification, Sampler
from bayestissue.inference.comparing import stacking as comparison
from bayestissue.inference.results.labels import labelled, labelled_statistics, statistics_of_transitions
from bayestissue.inference.results.predictive_checks import predictive_checks
from bayestissue.inference.results.summary import summarise
from bayestissue.inference.samplers.diagnostics import diagnose
from bayestissue.inference.samplers.sampling import Draws, PosteriorSampler
from bayestissue.likelihood.averages import AveragesOfLognormals, average_and_sd

Say = Callable[[str, int, int], None]
PRIOR_DRAWS = 1000
COMPARISON_SAMPLER = {"chains": 2, "warmup": 400, "draws": 500, "target_accept": 0.9}


@dataclass(frozen=True)
class PublishedAnalysis:
    """Every result of the re-analysis, labelled; the tables are the files of a finished run."""

    tree: xr.DataTree
    summary: pd.DataFrame
    diagnostics: dict[str, Any]
    hypotheses: pd.DataFrame
    comparison: pd.DataFrame
    sensitivity: pd.DataFrame
    predictive_checks: pd.DataFrame


def competing_designs(
    observations: PublishedObservations, specification: ModelSpecification, source: str
) -> dict[str, Design]:
    """The designs of the explanations to compare; each is checked like the model's own.

    Raises:
        InputError: see `build_design`.
    """
    return {
        name: published_design(
            observations, specification, formulas=Formulas(K=formula, C=formula), source=source
        )
        for name, formula in specification.comparison.formulas.items()
    }


def analyse(
    observations: PublishedObservations,
    design: Design,
    competing: dict[str, Design],
    specification: ModelSpecification,
    seed: int,
    say: Say,
) -> PublishedAnalysis:
    """Sample the posterior, check it, compare the explanations, and label everything.

    ``say`` is told the stage, how much of it is done, and its total.
    """
    model = _model(design, specification)
    room = max(len(part.names) for d in (design, *competing.values()) for part in d.responses.values())
    arguments = (design_arrays(design, room), observed_arrays(observations))
    sampler = PosteriorSampler(model, specification.sampler)
    (draws,) = sampler.run(seed, [arguments], progress=partial(say, "sampling the posterior"))
    say("predicting", 0, 1)
    rng = np.random.default_rng(seed)
    tree = _tree(design, observations, draws, specification, seed, rng)
    tree = tree.assign(_prior_groups(model, arguments, design, observations, seed, rng))
    posterior = tree["posterior"].dataset
    exponents = {
        q: posterior[f"mass_exponent_{q}"].to_numpy() for q in RESPONSES if f"mass_exponent_{q}" in posterior
    }
    summary = summarise(posterior)
    return PublishedAnalysis(
        tree,
        summary,
        diagnose(summary, statistics_of_transitions(draws)),
        derived.hypotheses(exponents, specification.practical_equivalence.mass_exponent),
        _comparison(observations, competing, specification, seed, say, room),
        _sensitivity(tree),
        _checks(tree, observations),
    )


def _model(design: Design, specification: ModelSpecification) -> Callable[..., None]:
    return partial(
        published_model,
        priors=specification.priors,
        subjects=len(design.subjects),
        trials=len(design.trials),
        correlated=specification.residual_correlation,
    )


def _scale(sites: derived.Draws) -> np.ndarray:
    sd_K, sd_C = jnp.asarray(sites["sd_impact_K"]), jnp.asarray(sites["sd_impact_C"])
    return np.asarray(cholesky_factor(sd_K, sd_C, jnp.asarray(sites.get("residual_correlation", 0.0))))


def _distributions(
    design: Design, observations: PublishedObservations, sites: derived.Draws
) -> tuple[dist.Distribution, dist.Distribution]:
    """The distributions of the estimates and of the averages, batched over chain and draw."""
    expected = np.stack([derived.row_logs(design, sites, q) for q in RESPONSES], axis=-1)
    scale = _scale(sites)[..., None, :, :]
    return (
        dist.MultivariateNormal(expected[..., observations.impact_cell, :], scale_tril=scale),
        AveragesOfLognormals(jnp.asarray(expected[..., observations.averaged_cells, :]), jnp.asarray(scale)),
    )


def _coordinates(design: Design, observations: PublishedObservations) -> dict[str, list[str]]:
    return {
        "impact": observations.impacts,
        "subject": list(design.subjects),
        "trial": list(design.trials),
        "averaged_trial": observations.averaged_trials,
    }


DIMENSIONS: dict[str, tuple[str, ...]] = {
    **dict.fromkeys(RESPONSES, ("impact",)),
    **{f"{q}_cell": ("subject", "trial") for q in RESPONSES},
    **{f"{q}_{group}": (group,) for q in RESPONSES for group in GROUPS},
    **{f"{group}_effect_{q}": (group,) for q in RESPONSES for group in GROUPS},
    **{f"{q}_observed": ("impact",) for q in RESPONSES},
    **{f"{q}_{name}": ("averaged_trial",) for q in RESPONSES for name in ("average", "sd")},
    "estimates": ("impact",),
    "averages": ("averaged_trial",),
    "mass_kg": ("trial",),
    "velocity_m_s": ("trial",),
    "energy_J": ("trial",),
    "impact_subject": ("impact",),
    "impact_trial": ("impact",),
}


def _quantities(
    design: Design, observations: PublishedObservations, sites: derived.Draws, rng: np.random.Generator
) -> dict[str, np.ndarray]:
    values = derived.reported_sites(design, sites)
    made = derived.stiffness_and_damping(design, sites)
    cell = np.full((len(design.subjects), len(design.trials)), -1)
    cell[design.subject, design.trial] = np.arange(len(design.subject))
    for q in RESPONSES:
        row = made.pop(f"{q}_row")
        values[q] = row[..., observations.impact_cell]
        values[f"{q}_cell"] = row[..., cell]
    mass = observations.cells["mass_kg"].to_numpy(float)
    return (
        values | made | derived.new_impact(design, sites, rng) | derived.straight_lines(design, sites, mass)
    )


def _predicted(estimates: np.ndarray, averages: np.ndarray) -> dict[str, np.ndarray]:
    """Published quantities, on their own scale, from the events of the two distributions."""
    values = {f"{q}_observed": np.exp(estimates[..., i]) for i, q in enumerate(RESPONSES)}
    for i, q in enumerate(RESPONSES):
        average, sd = average_and_sd(jnp.asarray(averages[..., i]), jnp.asarray(averages[..., i + 2]))
        values |= {f"{q}_average": np.asarray(average), f"{q}_sd": np.asarray(sd)}
    return values


def _tree(
    design: Design,
    observations: PublishedObservations,
    draws: Draws,
    specification: ModelSpecification,
    seed: int,
    rng: np.random.Generator,
) -> xr.DataTree:
    coordinates = _coordinates(design, observations)
    label = partial(labelled, dimensions=DIMENSIONS, coordinates=coordinates)
    estimates, averages = _distributions(design, observations, draws.sites)
    keys = jax.random.split(jax.random.fold_in(jax.random.key(seed), 1), 2)
    quantities = _quantities(design, observations, draws.sites, rng)
    priors = specification.priors.log_densities(draws.sites)
    statistics = labelled_statistics(draws)
    conditions = observations.cells.drop_duplicates("trial")
    constants = {name: conditions[name].to_numpy(float) for name in ("mass_kg", "velocity_m_s", "energy_J")}
    constants |= {
        "reference_mass_kg": np.asarray(design.reference_mass_kg),
        "impact_subject": design.subject[observations.impact_cell],
        "impact_trial": design.trial[observations.impact_cell],
    }
    return xr.DataTree.from_dict(
        {
            "posterior": label(quantities),
            "sample_stats": statistics,
            "log_likelihood": label(
                {
                    "estimates": np.asarray(estimates.log_prob(observations.log_estimates)),
                    "averages": np.asarray(averages.log_prob(observations.averages)),
                }
            ),
            "log_prior": label({name: priors[name] for name in priors if name in quantities}),
            "posterior_predictive": label(
                _predicted(np.asarray(estimates.sample(keys[0])), np.asarray(averages.sample(keys[1])))
            ),
            "observed_data": label(
                _predicted(observations.log_estimates, observations.averages), sampled=False
            ),
            "constant_data": label(constants, sampled=False),
        }
    )


def _prior_groups(
    model: Callable[..., None],
    arguments: tuple[Any, ...],
    design: Design,
    observations: PublishedObservations,
    seed: int,
    rng: np.random.Generator,
) -> dict[str, xr.DataTree]:
    key = jax.random.fold_in(jax.random.key(seed), 2)
    predictive = Predictive(partial(model, conditioned=False), num_samples=PRIOR_DRAWS)
    sites = {name: np.asarray(values)[None] for name, values in predictive(key, *arguments).items()}
    label = partial(labelled, dimensions=DIMENSIONS, coordinates=_coordinates(design, observations))
    return {
        "prior": xr.DataTree(label(_quantities(design, observations, sites, rng))),
        "prior_predictive": xr.DataTree(label(_predicted(sites["estimates"], sites["averages"]))),
    }


def _comparison(
    observations: PublishedObservations,
    competing: dict[str, Design],
    specification: ModelSpecification,
    seed: int,
    say: Say,
    room: int,
) -> pd.DataFrame:
    if not competing:
        return pd.DataFrame(columns=comparison.COLUMNS)
    settings = Sampler.model_validate(specification.sampler.model_dump() | COMPARISON_SAMPLER)
    any_design = next(iter(competing.values()))
    sampler = PosteriorSampler(_model(any_design, specification), settings)

    def fit(cases: list[tuple[str, str | None]], stage: str) -> list[Draws]:
        data_sets = [
            (design_arrays(competing[name], room), observed_arrays(observations, held_out=held_out))
            for name, held_out in cases
        ]
        return sampler.run(seed, data_sets, progress=partial(say, stage))

    full = dict(
        zip(competing, fit([(name, None) for name in competing], "comparing explanations"), strict=True)
    )
    trees = {name: _scored(competing[name], observations, draws) for name, draws in full.items()}
    scores = comparison.importance_scores(trees, "trials")
    cases = [
        (name, trial)
        for name, score in scores.items()
        for trial in np.array(any_design.trials)[score.high].tolist()
    ]
    if cases:
        for (name, trial), draws in zip(cases, fit([*cases], "refitting without a trial"), strict=True):
            density = _trial_density(competing[name], observations, draws, trial).ravel()
            place = any_design.trials.index(trial)
            scores[name].elpd[place] = float(logsumexp(density) - np.log(len(density)))
    return pd.concat(
        [
            comparison.by_impact(trees, "estimates"),
            comparison.by_trial({name: score.elpd for name, score in scores.items()}),
        ],
        ignore_index=True,
    )


def _scored(design: Design, observations: PublishedObservations, draws: Draws) -> xr.DataTree:
    """The log predictive densities of single impacts and of whole trials, for cross-validation."""
    estimates, _ = _distributions(design, observations, draws.sites)
    trials = [_trial_density(design, observations, draws, trial) for trial in design.trials]
    log_likelihood = labelled(
        {
            "estimates": np.asarray(estimates.log_prob(observations.log_estimates)),
            "trials": np.stack(trials, axis=-1),
        },
        DIMENSIONS | {"trials": ("trial",)},
        _coordinates(design, observations),
    )
    parameters = labelled({"intercept_K": draws.sites["intercept_K"]}, {}, {})
    return xr.DataTree.from_dict({"posterior": parameters, "log_likelihood": log_likelihood})


def _trial_density(
    design: Design, observations: PublishedObservations, draws: Draws, held_out: str
) -> np.ndarray:
    """Log density of a whole trial's data, its trial effect integrated out, [chain, draw]."""
    sites = draws.sites
    expected = np.stack(
        [
            derived.common_logs(design, sites, q)
            + derived.group_effect(design, sites, "subject", q)[..., design.subject]
            for q in RESPONSES
        ],
        axis=-1,
    )
    present = [float("trial" in design.responses[q].groups) for q in RESPONSES]
    sd_trial = np.stack([sites[f"sd_trial_{q}"] for q in RESPONSES], axis=-1) * present
    trial_of = observations.cells["trial"].to_numpy(str)
    impacts = np.flatnonzero(trial_of[observations.impact_cell] == held_out)
    if len(impacts):
        cells = observations.impact_cell[impacts]
        density = partial(
            log_density_of_estimates, log_estimates=jnp.asarray(observations.log_estimates[impacts])
        )
    else:
        number = observations.averaged_trials.index(held_out)
        cells = observations.averaged_cells[number]
        density = partial(log_density_of_averages, averages=jnp.asarray(observations.averages[number]))
    flat = [x.reshape(-1, *x.shape[2:]) for x in (expected[..., cells, :], _scale(sites), sd_trial)]
    return np.asarray(jax.jit(jax.vmap(density))(*flat)).reshape(sd_trial.shape[:2])


def _sensitivity(tree: xr.DataTree) -> pd.DataFrame:
    """Power-scaling sensitivity to the priors and to the data (Kallioinen et al. 2024)."""
    import arviz as az

    posterior = tree["posterior"].dataset
    names = [name for name, array in posterior.data_vars.items() if array.ndim == 2]
    table = az.psense_summary(tree, var_names=names, round_to=4)
    return table.rename_axis("variable").reset_index()[["variable", "prior", "likelihood", "diagnosis"]]


def _checks(tree: xr.DataTree, observations: PublishedObservations) -> pd.DataFrame:
    predicted = tree["posterior_predictive"].dataset
    logs = np.log(np.stack([predicted[f"{q}_observed"].to_numpy() for q in RESPONSES], axis=-1))
    cells = observations.cells.loc[observations.impact_cell]
    return predictive_checks(
        observations.log_estimates,
        logs.reshape(-1, *logs.shape[2:]),
        cells["trial"].to_numpy(str),
        cells["mass_kg"].to_numpy(float),
    )
