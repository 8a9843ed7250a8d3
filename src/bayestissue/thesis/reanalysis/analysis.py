"""The Bayesian re-analysis of published estimates, from model file and tables to labelled results."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import xarray as xr

from bayestissue.hierarchy import derived
from bayestissue.hierarchy.derived import named_sites
from bayestissue.hierarchy.design import Design
from bayestissue.hierarchy.effects import RESPONSES
from bayestissue.hierarchy.specification import Formulas, ModelSpecification
from bayestissue.inference.execution.compiling import compiled_quickly
from bayestissue.inference.results.cross_validation import prior_sensitivity
from bayestissue.inference.results.labels import (
    design_attributes,
    design_dimensions,
    labelled,
    labelled_statistics,
)
from bayestissue.inference.results.summary import summarise
from bayestissue.inference.samplers.diagnostics import diagnose
from bayestissue.thesis.reanalysis.explanations import compare_explanations
from bayestissue.thesis.reanalysis.model import EstimatesModel, common_effects, estimates_data
from bayestissue.thesis.reanalysis.observations import PublishedObservations, average_and_sd, published_design
from bayestissue.thesis.reanalysis.posterior import EstimatesPosterior, sample_posterior

Statistic = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]


def predictive_checks(
    observed: np.ndarray, replicates: np.ndarray, trial: np.ndarray, mass_kg: np.ndarray
) -> pd.DataFrame:
    """Observed statistics of (log K, log C) beside their posterior predictive distribution.

    ``observed`` [impact, 2], ``replicates`` [replicate, impact, 2], ``trial`` and ``mass_kg`` [impact].
    ``p_value`` is the share of replicates at or above the observed statistic: near 0 or 1, the model does
    not make such data (Gelman, Meng and Stern 1996).
    """
    rows = []
    for column, quantity in enumerate("KC"):
        for name, statistic in _STATISTICS.items():
            observed_value = float(statistic(observed[..., column], trial, mass_kg))
            predicted = statistic(replicates[..., column], trial, mass_kg)
            rows.append(_row(name, quantity, observed_value, predicted))
    observed_correlation = float(_correlation_within(observed, trial))
    rows.append(
        _row(
            "correlation of K and C within trials",
            "K, C",
            observed_correlation,
            _correlation_within(replicates, trial),
        )
    )
    return pd.DataFrame(rows)


def _row(name: str, quantity: str, observed: float, predicted: np.ndarray) -> dict[str, object]:
    low, median, high = np.quantile(predicted, [0.05, 0.5, 0.95])
    return {
        "statistic": name,
        "quantity": quantity,
        "observed": observed,
        "predicted_median": float(median),
        "predicted_low": float(low),
        "predicted_high": float(high),
        "p_value": float(np.mean(predicted >= observed)),
    }


def _within(logs: np.ndarray, trial: np.ndarray) -> np.ndarray:
    membership = trial[:, None] == np.unique(trial)
    means = (logs @ membership) / membership.sum(0)
    return logs - means @ membership.T


def _correlation_within(logs: np.ndarray, trial: np.ndarray) -> np.ndarray:
    K, C = _within(logs[..., 0], trial), _within(logs[..., 1], trial)
    return (K * C).mean(-1) / np.sqrt((K**2).mean(-1) * (C**2).mean(-1))


def _skewness_within(logs: np.ndarray, trial: np.ndarray, mass: np.ndarray) -> np.ndarray:
    deviation = _within(logs, trial)
    return (deviation**3).mean(-1) / (deviation**2).mean(-1) ** 1.5


def _light_to_heavy(logs: np.ndarray, trial: np.ndarray, mass: np.ndarray) -> np.ndarray:
    squares = _within(logs, trial) ** 2
    heavy = mass > np.median(mass)
    return np.sqrt(squares[..., ~heavy].mean(-1) / squares[..., heavy].mean(-1))


def _mass_correlation(logs: np.ndarray, trial: np.ndarray, mass: np.ndarray) -> np.ndarray:
    values, m = np.exp(logs), mass - mass.mean()
    centred = values - values.mean(-1, keepdims=True)
    return (centred @ m) / np.sqrt((centred**2).sum(-1) * (m @ m))


_STATISTICS: dict[str, Statistic] = {
    "smallest value": lambda logs, trial, mass: np.exp(logs.min(-1)),
    "largest value": lambda logs, trial, mass: np.exp(logs.max(-1)),
    "standard deviation of the log within trials": lambda logs, trial, mass: _within(logs, trial).std(-1),
    "skewness of the log within trials": _skewness_within,
    "scatter at light masses over scatter at heavy ones": _light_to_heavy,
    "correlation with mass": _mass_correlation,
}


Say = Callable[[str, int, int], None]
PRIOR_DRAWS = 1000


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
    priors = specification.complete_priors()
    effects = common_effects([design, *competing.values()], priors)
    model = EstimatesModel(effects, priors, specification.residual_correlation)
    data = estimates_data(design, observations, model)
    settings = specification.sampler
    sampled = sample_posterior(model, data, settings, seed, partial(say, "sampling the posterior"))
    say("predicting", 0, 1)
    rng = np.random.default_rng(seed)
    sites = named_sites(model.locations, design, sampled.draws.sites, sampled.b)
    tree = _tree(design, observations, specification, sites, sampled, rng)
    tree = tree.assign(_prior_groups(model, design, observations, seed, rng))
    posterior = tree["posterior"].dataset
    exponents = {
        q: posterior[f"mass_exponent_{q}"].to_numpy() for q in RESPONSES if f"mass_exponent_{q}" in posterior
    }
    summary = summarise(posterior)
    further = () if sampled.correction is None else sampled.correction.checks()
    explanations = {name: estimates_data(rival, observations, model) for name, rival in competing.items()}
    cells = [*observations.averaged_cells[:, 0], *observations.impact_cell]
    trial = observations.cells["trial"].to_numpy(str)[cells]
    progress = partial(say, "comparing explanations")
    return PublishedAnalysis(
        tree,
        summary,
        diagnose(summary, labelled_statistics(sampled.draws, of_transitions=True), further),
        derived.hypotheses(exponents, specification.practical_equivalence.mass_exponent),
        compare_explanations(model, explanations, trial, settings, seed, progress),
        prior_sensitivity(tree),
        _checks(tree, observations),
    )


def _coordinates(design: Design, observations: PublishedObservations) -> dict[str, list[str]]:
    return {"impact": observations.impacts, **design.levels(), "averaged_trial": observations.averaged_trials}


_DIMENSIONS: dict[str, tuple[str, ...]] = {
    **dict.fromkeys(RESPONSES, ("impact",)),
    **{f"{q}_cell": ("subject", "trial") for q in RESPONSES},
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


def _labelling(design: Design, observations: PublishedObservations) -> Callable[..., xr.Dataset]:
    """`labelled` with the names of the design and of what was published."""
    return partial(
        labelled,
        dimensions=_DIMENSIONS | design_dimensions(design),
        coordinates=_coordinates(design, observations),
        attributes=design_attributes(design),
    )


def _quantities(
    design: Design, observations: PublishedObservations, sites: derived.Draws, rng: np.random.Generator
) -> dict[str, np.ndarray]:
    values = derived.reported_sites(design, sites)
    levels = derived.values_at_levels(design, values)
    cell = np.full((len(design.subjects), len(design.trials)), -1)
    cell[design.subject, design.trial] = np.arange(len(design.subject))
    for q in RESPONSES:
        row = np.exp(derived.row_logs(design, sites, q))
        values[q] = row[..., observations.impact_cell]
        values[f"{q}_cell"] = row[..., cell]
    mass = observations.cells["mass_kg"].to_numpy(float)
    values |= levels | derived.new_impact(design, sites, levels, rng)
    return values | derived.straight_lines(design, sites, mass)


def _replicates(
    design: Design, observations: PublishedObservations, sites: derived.Draws, rng: np.random.Generator
) -> dict[str, np.ndarray]:
    """Published quantities as the model makes them: an estimate a row, and the averages of whole tables."""
    expected = np.stack([derived.row_logs(design, sites, q) for q in RESPONSES], axis=-1)
    sd = np.stack([sites[f"sd_impact_{q}"] for q in RESPONSES], axis=-1)[..., None, :]
    r = np.asarray(sites.get("residual_correlation", np.zeros(expected.shape[:-2])))[..., None]

    def replicated(cells: np.ndarray) -> np.ndarray:
        noise = rng.standard_normal((*expected.shape[:-2], cells.size, 2))
        noise[..., 1] = r * noise[..., 0] + np.sqrt(1 - r**2) * noise[..., 1]
        values = np.exp(expected[..., cells.ravel(), :] + sd * noise)
        return values.reshape(*expected.shape[:-2], *cells.shape, 2)

    estimates, tables = replicated(observations.impact_cell), replicated(observations.averaged_cells)
    replicates = {f"{q}_observed": estimates[..., i] for i, q in enumerate(RESPONSES)}
    for i, q in enumerate(RESPONSES):
        replicates |= {f"{q}_average": tables[..., i].mean(-1), f"{q}_sd": tables[..., i].std(-1, ddof=1)}
    return replicates


def _observed(observations: PublishedObservations) -> dict[str, np.ndarray]:
    """The published quantities themselves."""
    observed = {f"{q}_observed": np.exp(observations.log_estimates[:, i]) for i, q in enumerate(RESPONSES)}
    for i, q in enumerate(RESPONSES):
        average, sd = average_and_sd(*(jnp.asarray(observations.averages[:, a]) for a in (i, i + 2)))
        observed |= {f"{q}_average": np.asarray(average), f"{q}_sd": np.asarray(sd)}
    return observed


def _tree(
    design: Design,
    observations: PublishedObservations,
    specification: ModelSpecification,
    sites: derived.Draws,
    sampled: EstimatesPosterior,
    rng: np.random.Generator,
) -> xr.DataTree:
    label = _labelling(design, observations)
    quantities = _quantities(design, observations, sites, rng)
    priors = compiled_quickly()(specification.complete_priors().log_densities)(
        {name: values for name, values in sites.items() if name in quantities}
    )
    conditions = observations.cells.drop_duplicates("trial")
    constants = {name: conditions[name].to_numpy(float) for name in ("mass_kg", "velocity_m_s", "energy_J")}
    constants |= {
        "reference_mass_kg": np.asarray(design.reference_mass_kg),
        "impact_subject": design.subject[observations.impact_cell],
        "impact_trial": design.trial[observations.impact_cell],
    }
    tables = len(observations.averages)
    densities = {"estimates": sampled.rows[..., tables:], "averages": sampled.rows[..., :tables]}
    return xr.DataTree.from_dict(
        {
            "posterior": label(quantities),
            "sample_stats": labelled_statistics(sampled.draws),
            "log_likelihood": label(densities),
            "log_prior": label({name: np.asarray(values) for name, values in priors.items()}),
            "posterior_predictive": label(_replicates(design, observations, sites, rng)),
            "observed_data": label(_observed(observations), sampled=False),
            "constant_data": label(constants, sampled=False),
        }
    )


def _prior_groups(
    model: EstimatesModel,
    design: Design,
    observations: PublishedObservations,
    seed: int,
    rng: np.random.Generator,
) -> dict[str, xr.DataTree]:
    keys = jax.random.split(jax.random.fold_in(jax.random.key(seed), 2), len(model.hyperparameters))
    spreads = {
        name: np.asarray(model.prior_of(name).sample(key, (1, PRIOR_DRAWS)))
        for name, key in zip(model.hyperparameters, keys, strict=True)
    }
    effects = model.locations
    sd = [
        spreads[name] if name else np.full((1, PRIOR_DRAWS), known)
        for name, known in zip(effects.spread, effects.sd, strict=True)
    ]
    b = effects.mean + np.stack(sd, axis=-1) * rng.standard_normal((1, PRIOR_DRAWS, effects.size))
    sites = named_sites(model.locations, design, spreads, b)
    label = _labelling(design, observations)
    return {
        "prior": xr.DataTree(label(_quantities(design, observations, sites, rng))),
        "prior_predictive": xr.DataTree(label(_replicates(design, observations, sites, rng))),
    }


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
