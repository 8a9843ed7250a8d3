"""The Bayesian re-analysis of published estimates, from model file and tables to labelled results."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import numpy as np
import pandas as pd
import xarray as xr
from jax import Array
from jaxtyping import Float

from bayestissue.base.result import Say
from bayestissue.base.results.tables import table_of_rows
from bayestissue.inference.chain.ending import r_hat_limit
from bayestissue.inference.execution.compiling import compiled_quickly
from bayestissue.inference.results.cross_validation import prior_sensitivity
from bayestissue.inference.results.labels import (
    Variable,
    design_variables,
    labelled,
    variables,
)
from bayestissue.inference.results.summary import diagnose, summarise
from bayestissue.model.hierarchy import derived
from bayestissue.model.hierarchy.derived import effects_by_name
from bayestissue.model.hierarchy.design import Design
from bayestissue.model.hierarchy.responses import RESPONSES
from bayestissue.model.hierarchy.specification import Formulas, ModelSpecification
from bayestissue.thesis.reanalysis.competing_explanations import compare_explanations
from bayestissue.thesis.reanalysis.observations import PublishedObservations, average_and_sd, published_design
from bayestissue.thesis.reanalysis.table_chain import EstimatesPosterior, sample_posterior
from bayestissue.thesis.reanalysis.table_model import EstimatesModel, common_effects, estimates_data

PRIOR_DRAWS = 1000


def predictive_checks(
    observed: np.ndarray, replicates: np.ndarray, trial: np.ndarray, mass_kg: np.ndarray
) -> pd.DataFrame:
    """Observed statistics of (log K, log C) beside their posterior predictive distribution.

    ``observed`` [impact, 2], ``replicates`` [replicate, impact, 2], ``trial`` and ``mass_kg`` [impact].
    ``p_value`` is the share of replicates at or above the observed statistic: near 0 or 1, the model does
    not make such data (Gelman, Meng and Stern 1996).
    """
    predicted, rows = _statistics(replicates, trial, mass_kg), []
    for (name, quantity), value in _statistics(observed, trial, mass_kg).items():
        low, median, high = np.quantile(predicted[name, quantity], [0.05, 0.5, 0.95])
        p = np.mean(predicted[name, quantity] >= value)
        rows.append((name, quantity, value, median, low, high, p))
    return table_of_rows("predictive_checks", rows)


def _statistics(
    logs: Float[np.ndarray, "*replicate impact 2"], trial: np.ndarray, mass_kg: np.ndarray
) -> dict[tuple[str, str], Float[np.ndarray, "*replicate"]]:
    """Statistics of (log K, log C), by their name and what they are of."""
    member = trial[:, None] == np.unique(trial)
    heavy, mass = mass_kg > np.median(mass_kg), mass_kg - mass_kg.mean()
    logs = logs.swapaxes(-1, -2)
    deviation, values = logs - (logs @ member / member.sum(0)) @ member.T, np.exp(logs)
    squares, centred = deviation**2, values - values.mean(-1, keepdims=True)
    light_to_heavy = squares[..., ~heavy].mean(-1) / squares[..., heavy].mean(-1)
    size = np.sqrt((centred**2).sum(-1) * (mass @ mass))
    statistics = {
        "smallest value": values.min(-1),
        "largest value": values.max(-1),
        "standard deviation of the log within trials": deviation.std(-1),
        "skewness of the log within trials": (deviation**3).mean(-1) / squares.mean(-1) ** 1.5,
        "scatter at light masses over scatter at heavy ones": np.sqrt(light_to_heavy),
        "correlation with mass": (centred @ mass) / size,
    }
    correlation = deviation.prod(-2).mean(-1) / np.sqrt(squares.mean(-1).prod(-1))
    return {
        **{(name, q): values[..., i] for i, q in enumerate(RESPONSES) for name, values in statistics.items()},
        ("correlation of K and C within trials", "K, C"): correlation,
    }


@dataclass(frozen=True)
class PublishedAnalysis:
    """Every result of the re-analysis, labelled; ``tables`` are files of a finished run, by their names."""

    tree: xr.DataTree
    diagnostics: dict[str, Any]
    tables: dict[str, pd.DataFrame]


def competing_designs(
    observations: PublishedObservations, specification: ModelSpecification, source: str
) -> dict[str, Design]:
    """The designs of the explanations to compare; each is checked like the model's own.

    Raises:
        InputError: see `build_design`.
    """
    designed = partial(published_design, observations, specification, source=source)
    formulas = specification.comparison.formulas
    return {name: designed(formulas=Formulas(K=formula, C=formula)) for name, formula in formulas.items()}


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
    settings = specification.sampler
    data = estimates_data(design, observations, model)
    sampled = sample_posterior(model, data, settings, seed, say)
    say("predicting", 0, 1)
    results = _Results(model, design, observations)
    rng = np.random.default_rng(seed)
    groups = results.posterior_groups(sampled, rng) | results.prior_groups(seed, rng)
    tree = xr.DataTree.from_dict(groups)
    posterior = tree["posterior"].dataset
    exponents = {
        q: posterior[f"mass_exponent_{q}"].to_numpy() for q in RESPONSES if f"mass_exponent_{q}" in posterior
    }
    summary = summarise(posterior)
    explanations = {name: estimates_data(rival, observations, model) for name, rival in competing.items()}
    cells = [*observations.averaged_cells[:, 0], *observations.impact_cell]
    trial = observations.cells["trial"].to_numpy(str)[cells]
    progress = partial(say, "comparing explanations")
    tables = {
        "summary": summary,
        "hypotheses": derived.hypotheses(exponents, specification.practical_equivalence.mass_exponent),
        "comparison": compare_explanations(model, explanations, trial, settings, seed, progress),
        "sensitivity": prior_sensitivity(tree),
        "predictive_checks": _checks(tree, observations),
    }
    diagnostics = diagnose(summary, r_hat_limit(len(summary), *sampled.y.shape[:2]))
    return PublishedAnalysis(tree, diagnostics, tables)


def _checks(tree: xr.DataTree, observations: PublishedObservations) -> pd.DataFrame:
    predicted = tree["posterior_predictive"].dataset
    logs = np.log(np.stack([predicted[f"{q}_observed"].to_numpy() for q in RESPONSES], axis=-1))
    cells = observations.cells.loc[observations.impact_cell]
    trial, mass = cells["trial"].to_numpy(str), cells["mass_kg"].to_numpy(float)
    return predictive_checks(observations.log_estimates, logs.reshape(-1, *logs.shape[2:]), trial, mass)


_CONDITION = ("mass_kg", "velocity_m_s", "energy_J")
# Of what no fit of traces has, or has of each impact.
_DIMENSIONS = {"estimates": "impact", "averages": "averaged_trial", **dict.fromkeys(_CONDITION, "trial")}


@dataclass(frozen=True)
class _Results:
    """What draws of the hierarchy say of the design and of what was published, as labelled groups."""

    model: EstimatesModel
    design: Design
    observations: PublishedObservations

    def _labelled(self, values: Mapping[str, np.ndarray], *, sampled: bool = True) -> xr.Dataset:
        published, known = self.observations, variables()
        further = {
            name: Variable(known[name].attrs if name in known else {"unit": "1"}, (dimension,))
            for name, dimension in _DIMENSIONS.items()
        }
        return labelled(
            values,
            {
                "impact": published.impacts,
                **self.design.levels(),
                "averaged_trial": published.averaged_trials,
            },
            further | design_variables(self.design),
            sampled=sampled,
        )

    def posterior_groups(
        self, sampled: EstimatesPosterior, rng: np.random.Generator
    ) -> dict[str, xr.Dataset]:
        """The posterior, what goes with its draws, and the data."""
        effects = effects_by_name(self.model.locations, self.design, sampled.b)
        population = sampled.hyperparameters | effects
        quantities = self._quantities(population, rng)
        in_formulas = {name: values for name, values in population.items() if name in quantities}
        priors = compiled_quickly(self.model.priors.log_densities)(in_formulas)
        published = self.observations
        lost = len(published.averages)
        densities = {"estimates": sampled.rows[..., lost:], "averages": sampled.rows[..., :lost]}
        tables = average_and_sd(published.averages[:, :2], published.averages[:, 2:])
        return {
            "posterior": self._labelled(quantities),
            "sample_stats": self._labelled({"lp": sampled.rows.sum(-1)}),
            "log_likelihood": self._labelled(densities),
            "log_prior": self._labelled({name: np.asarray(values) for name, values in priors.items()}),
            "posterior_predictive": self._labelled(self._replicates(population, rng)),
            "observed_data": self._labelled(
                _published(np.exp(published.log_estimates), *tables), sampled=False
            ),
            "constant_data": self._labelled(self._constants(), sampled=False),
        }

    def prior_groups(self, seed: int, rng: np.random.Generator) -> dict[str, xr.Dataset]:
        """The same quantities, and what would be published, before the data are known."""
        model, effects = self.model, self.model.locations
        keys = jax.random.split(jax.random.fold_in(jax.random.key(seed), 2), len(model.hyperparameters))

        @jax.jit
        def drawn(keys: Array) -> dict[str, Array]:
            pairs = zip(model.hyperparameters, keys, strict=True)
            return {name: model.prior_of(name).sample(key, (1, PRIOR_DRAWS)) for name, key in pairs}

        hyperparameters = {name: np.asarray(values) for name, values in drawn(keys).items()}
        sd = [
            hyperparameters[name] if name else np.full((1, PRIOR_DRAWS), known)
            for name, known in zip(effects.spread, effects.sd, strict=True)
        ]
        b = effects.mean + np.stack(sd, axis=-1) * rng.standard_normal((1, PRIOR_DRAWS, effects.size))
        population = hyperparameters | effects_by_name(effects, self.design, b)
        return {
            "prior": self._labelled(self._quantities(population, rng)),
            "prior_predictive": self._labelled(self._replicates(population, rng)),
        }

    def _quantities(self, population: derived.Draws, rng: np.random.Generator) -> dict[str, np.ndarray]:
        design, published = self.design, self.observations
        values = derived.formula_quantities(design, population)
        levels = derived.level_quantities(design, values)
        cell = np.full((len(design.subjects), len(design.trials)), -1)
        cell[design.subject, design.trial] = np.arange(len(design.subject))
        for q in RESPONSES:
            row = np.exp(derived.row_logs(design, population, q))
            values |= {q: row[..., published.impact_cell], f"{q}_cell": row[..., cell]}
        values |= levels | derived.new_impact(design, population, levels, rng)
        return values | derived.lines_of_means(design, population, published.cells["mass_kg"].to_numpy(float))

    def _replicates(self, population: derived.Draws, rng: np.random.Generator) -> dict[str, np.ndarray]:
        """Published quantities as the model makes them: an estimate a row, and averages of whole tables."""
        expected = np.stack([derived.row_logs(self.design, population, q) for q in RESPONSES], axis=-1)
        sd = np.stack([population[f"sd_impact_{q}"] for q in RESPONSES], axis=-1)[..., None, :]
        r = np.asarray(population.get("residual_correlation", np.zeros(expected.shape[:-2])))[..., None]

        def replicated(cells: np.ndarray) -> np.ndarray:
            noise = rng.standard_normal((*expected.shape[:-2], cells.size, 2))
            noise[..., 1] = r * noise[..., 0] + np.sqrt(1 - r**2) * noise[..., 1]
            values = np.exp(expected[..., cells.ravel(), :] + sd * noise)
            return values.reshape(*expected.shape[:-2], *cells.shape, 2)

        estimates = replicated(self.observations.impact_cell)
        tables = replicated(self.observations.averaged_cells)
        return _published(estimates, tables.mean(-2), tables.std(-2, ddof=1))

    def _constants(self) -> dict[str, np.ndarray]:
        conditions = self.observations.cells.drop_duplicates("trial")
        return {name: conditions[name].to_numpy(float) for name in _CONDITION} | {
            "reference_mass_kg": np.asarray(self.design.reference_mass_kg),
            "impact_subject": self.design.subject[self.observations.impact_cell],
            "impact_trial": self.design.trial[self.observations.impact_cell],
        }


def _published(
    estimates: Float[np.ndarray, "*draw impact 2"],
    average: Float[np.ndarray, "*draw trial 2"],
    sd: Float[np.ndarray, "*draw trial 2"],
) -> dict[str, np.ndarray]:
    """What was published of K and of C, or the model makes of it, by name."""
    values = {"observed": estimates, "average": average, "sd": sd}
    return {f"{q}_{name}": pair[..., i] for name, pair in values.items() for i, q in enumerate(RESPONSES)}
