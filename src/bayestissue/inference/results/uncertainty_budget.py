"""Uncertainty budget: the share of each source in the posterior variance of log K and log C.

The sources are noise, measuring chain, mass, element, people, conditions and impacts. Everything is normal on
the log scale once the standard deviations are given. A posterior variance V is then homogeneous of degree one
in the variances v_s that make it, so that V = sum_s v_s dV/dv_s: what each source makes, by the derivative,
adds up to the whole, and is what a small change of that source alone would change. Of an impact this takes N
and its parts of `bayestissue.inference.results.errors`; of the population's means, those of all impacts.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from jax import Array
from jaxtyping import Float

from bayestissue.hierarchy.derived import typical_covariates, typical_logs
from bayestissue.hierarchy.effects import RESPONSES
from bayestissue.hierarchy.formulas.group_terms import SUBJECT, TRIAL
from bayestissue.hierarchy.gaussian.arrangement import PopulationDesign, expected_by_cell
from bayestissue.hierarchy.gaussian.covariances import Covariances
from bayestissue.hierarchy.population import MASS_ERROR, Hyperparameters
from bayestissue.hierarchy.trace_data import Prepared
from bayestissue.hierarchy.traces import TraceModel
from bayestissue.inference.execution.compiling import compiled_quickly
from bayestissue.inference.execution.kept import some_of
from bayestissue.inference.quantities.draws import Draws
from bayestissue.inference.quantities.masses import MASS_FACTOR
from bayestissue.inference.results.errors import (
    ELEMENT,
    NOISE,
    Matrices,
    TraceErrors,
    trace_errors,
)
from bayestissue.results.tables import joined, table_of_rows

type Variance = float | Float[np.ndarray, " impact"]

IMPACT, TYPICAL_PERSON, NEW_PERSON = "impact", "typical person", "new person"
TRACE = "trace alone"
MASS, SHAPE = "mass", "element's parameters"
IMPACTS, PEOPLE, CONDITIONS, PRIORS = "impacts", "people", "conditions", "priors"
PERSON_AND_CONDITION = "person and condition"
ALL, DRAWN = "all", "as drawn"
MOST_IMPACTS = 100
# Of what the population says of a parameter: enough where a trace says nothing of it.
_RIDGE = 1e-6
_TERMS = {SUBJECT: PEOPLE, TRIAL: CONDITIONS}
_NUISANCE = {
    "noise": NOISE,
    "atanh_theta1": NOISE,
    "contact": "contact moment",
    "discrepancy": ELEMENT,
    "noise_force": NOISE,
    "log_force_ratio": NOISE,
}


def uncertainty_budget(prepared: Prepared, draws: Draws) -> pd.DataFrame:
    """What each source makes of the posterior variance of log K and log C.

    Args:
        prepared: the model and its data.
        draws: of everything, of which medians are taken.

    Returns:
        ``interval_sources.csv``. ``level`` is `IMPACT` (shares are means over the recorded impacts, or a
        hundred evenly spaced ones), `TYPICAL_PERSON` (the population's K and C at the reference mass; not
        where impacts are many), `NEW_PERSON` (a new impact on a new person) or `TRACE` (an impact from its
        trace alone, without what the population tells). ``share`` is of the variance, and ``sd`` what the
        source alone would make the standard deviation of the log, the median over impacts. The shares add up
        to that of `ALL`, 1; `DRAWN` has the variance of the draws relative to it. K is the
        element's own, beside a discrepancy too.
    """
    many = draws.kept_numbers is not None
    rows = np.arange(len(prepared.impacts))
    if many:
        rows = np.unique(np.linspace(0, rows[-1], MOST_IMPACTS).astype(int))
    part = some_of(prepared, rows)
    u = np.median(draws.impacts["parameters"][:, :, rows].astype(float), axis=(0, 1))
    middle = _Hierarchy.of(part, _middle(part, draws, np.median))
    errors = trace_errors(part, u, _RIDGE * np.linalg.inv(middle.omega))
    drawn = {q: np.var(np.log(draws.impacts[q][:, :, rows]), axis=(0, 1)) for q in RESPONSES}
    tables = [
        _shares(IMPACT, _with_masses(middle.of_impacts(errors, not many), draws), drawn),
        _shares(TRACE, middle.of_traces(errors)),
    ]
    typical = {q: float(np.var(typical_logs(prepared.design, draws.population, q))) for q in RESPONSES}
    means = {q: {PERSON_AND_CONDITION: variance} for q, variance in typical.items()}
    if not many:
        # Variances of means are linear in those of the hyperparameters, whose posteriors have long tails.
        means = _Hierarchy.of(part, _middle(part, draws, _root_mean_square)).of_means(errors)
        means = _with_masses(means, draws)
        tables.append(_shares(TYPICAL_PERSON, means, typical))
    added = {q: _new_levels(prepared, draws, q) for q in RESPONSES}
    of_new = {q: _summed(means[q], {PEOPLE: 0.0, CONDITIONS: 0.0}, added[q]) for q in RESPONSES}
    whole = {q: typical[q] + sum(added[q].values()) for q in RESPONSES}
    tables.append(_shares(NEW_PERSON, of_new, whole))
    return joined("interval_sources", tables)


def _summed[Value](*parts: Mapping[str, Value]) -> dict[str, Value]:
    """What several accounts by source have of each source together."""
    total: dict[str, Any] = {}
    for source, value in (item for part in parts for item in part.items()):
        total[source] = total[source] + value if source in total else value
    return total


def _with_masses[Value](
    by_response: Mapping[str, Mapping[str, Value]], draws: Draws
) -> dict[str, dict[str, Value]]:
    """With the variance of what all declared masses are to be multiplied by, where a force tells of it."""
    if MASS_FACTOR not in draws.population:
        return {q: dict(by_source) for q, by_source in by_response.items()}
    variance: Any = float(np.var(np.log(draws.population[MASS_FACTOR])))
    return {q: _summed(by_source, {MASS: variance}) for q, by_source in by_response.items()}


def _middle(prepared: Prepared, draws: Draws, middle: Callable[[np.ndarray], np.floating]) -> Hyperparameters:
    """The standard deviations at the middle of their draws, and the median correlation."""
    hyperparameters = {name: middle(draws.population[name]) for name in prepared.model.hyperparameters}
    if "residual_correlation" in hyperparameters:
        hyperparameters["residual_correlation"] = np.median(draws.population["residual_correlation"])
    return hyperparameters


def _root_mean_square(values: np.ndarray) -> np.floating:
    return np.sqrt(np.mean(values**2))


def _scatter(
    prepared: Prepared, covariances: Covariances
) -> dict[str, Float[np.ndarray, "parameter parameter"]]:
    """Covariance of u about X b by source, an error of mass left out."""
    model = prepared.model
    kk, kc, cc = covariances.pair
    size = 2 + len(model.nuisance)
    scatter = {IMPACTS: np.zeros((size, size))}
    # The traces' own error of mass is a source by itself.
    scatter[IMPACTS][:2, :2] = np.array([[kk, kc], [kc, cc]]) - model.own_mass_sd**2
    for number, (name, sd) in enumerate(zip(model.nuisance, covariances.nuisance, strict=True), start=2):
        source = _NUISANCE.get(name, SHAPE)
        scatter.setdefault(source, np.zeros((size, size)))[number, number] = float(sd) ** 2
    return scatter


@compiled_quickly
def _dense(
    model: TraceModel, design: PopulationDesign, hyperparameters: Hyperparameters
) -> tuple[Covariances, Float[Array, "parameter location entry"]]:
    """The hierarchy at these standard deviations: covariances, and columns of X."""
    return model.covariances(hyperparameters), expected_by_cell(design, jnp.eye(model.locations.size))


class _Variances(NamedTuple):
    """What makes the posterior variances, by source along the first axis.

    Attributes:
        measured: covariance of what the traces tell of u.
        scatter: covariance of u about X b.
        effects: prior variances of b's elements.
        columns: X.
    """

    measured: Float[Array, "source impact parameter parameter"]
    scatter: Float[Array, "source parameter parameter"]
    effects: Float[Array, "source location"]
    columns: Float[Array, "impact parameter location"]

    def at(self, factor: Float[Array, " source"]) -> tuple[Array, Array, Array]:
        """All sources' together, the variances of each multiplied by a factor."""
        measured, scatter, effects = (
            jnp.tensordot(factor, parts, axes=1) for parts in (self.measured, self.scatter, self.effects)
        )
        return measured, scatter, effects

    def precision(self, measured: Array, scatter: Array) -> Float[Array, "location location"]:
        """Of b, by the traces alone."""
        weight = jnp.linalg.inv(scatter + measured)
        return jnp.einsum("ial,iab,ibm->lm", self.columns, weight, self.columns)


@compiled_quickly
def _of_means(
    variances: _Variances, means: Float[Array, "response location"]
) -> Float[Array, "response source"]:
    """Parts of the variance of such means of b's elements."""

    def variance(factor: Array) -> Array:
        measured, scatter, effects = variances.at(factor)
        covariance = jnp.linalg.inv(variances.precision(measured, scatter) + jnp.diag(1 / effects))
        return jnp.einsum("rl,lm,rm->r", means, covariance, means)

    return jax.jacfwd(variance)(jnp.ones(len(variances.effects)))


@compiled_quickly
def _of_impacts(
    variances: _Variances, masses: Float[Array, " source"], whole: Float[Array, ""]
) -> tuple[Float[Array, "impact parameter"], Float[Array, "impact parameter source"]]:
    """The variance of each impact's parameters, and what traces, scatter and errors of masses make of it.

    The rest is what is not known of persons and conditions.

    Args:
        variances: what makes it.
        masses: 1 of the source that errors of masses are, else 0.
        whole: 0 where b counts as known but for such errors, else 1.
    """
    one = jnp.ones(len(variances.effects))
    measured, scatter, _ = variances.at(one)
    precision = whole * variances.precision(measured, scatter)
    left_open = whole * measured @ jnp.linalg.inv(scatter + measured) @ variances.columns
    # K and C are those at the true mass: what is recorded, and its error.
    pulled = left_open - jnp.where(masses @ variances.effects > 0, variances.columns, 0.0)

    def variance(factor: Array) -> Array:
        measured, scatter, _ = variances.at(factor)
        given_means = jnp.linalg.inv(jnp.linalg.inv(scatter) + jnp.linalg.inv(measured))
        effects = variances.at(jnp.where(masses > 0, factor, 1.0))[2]
        covariance = jnp.linalg.inv(precision + jnp.diag(1 / effects))
        return jnp.diagonal(given_means, axis1=1, axis2=2) + ((pulled @ covariance) * pulled).sum(-1)

    return variance(one), jax.jacfwd(variance)(one)


class _Hierarchy(NamedTuple):
    """The normal hierarchy with its standard deviations given, every covariance by source."""

    prepared: Prepared
    scatter: dict[str, Float[np.ndarray, "parameter parameter"]]
    effects: dict[str, Float[np.ndarray, " location"]]
    columns: Float[np.ndarray, "impact parameter location"]

    @classmethod
    def of(cls, prepared: Prepared, hyperparameters: Hyperparameters) -> _Hierarchy:
        """At these standard deviations."""
        design, locations = prepared.data.design, prepared.model.locations
        arrays = _dense(prepared.model, design._replace(cell=np.zeros(0, int)), hyperparameters)
        covariances, columns = jax.device_get(arrays)
        sources = _sources(prepared)
        names = (MASS, PEOPLE, CONDITIONS, *sources.values(), PRIORS)
        effects = {name: np.zeros(locations.size) for name in names}
        for part in locations.blocks:
            source = MASS if part.name == MASS_ERROR else sources[part.spread] if part.spread else PRIORS
            rows = locations.parts[part.name]
            effects[source][rows] = np.asarray(covariances.locations)[rows] ** 2
        columns = columns[..., np.asarray(design.cell)].transpose(2, 0, 1)
        return cls(prepared, _scatter(prepared, covariances), effects, columns)

    @property
    def omega(self) -> Float[np.ndarray, "parameter parameter"]:
        """Covariance of u about X b."""
        return np.sum(list(self.scatter.values()), axis=0)

    def _measured(self, errors: TraceErrors) -> dict[str, Matrices]:
        """What the traces' errors add, and the mass's that every impact has by itself."""
        both = (np.arange(len(self.omega)) < 2).astype(float)
        of_mass = self.prepared.model.own_mass_sd**2 * np.multiply.outer(both, both)
        return {**errors.parts, MASS: np.broadcast_to(of_mass, errors.total.shape)}

    def _variances(self, errors: TraceErrors) -> tuple[list[str], _Variances]:
        """Names of all sources, and their variances."""
        tables = (self._measured(errors), self.scatter, self.effects)
        names = list(dict.fromkeys(name for table in tables for name in table))
        parts = (
            np.stack([table.get(name, np.zeros_like(table[next(iter(table))])) for name in names])
            for table in tables
        )
        return names, _Variances(*parts, self.columns)

    def of_traces(self, errors: TraceErrors) -> dict[str, dict[str, np.ndarray]]:
        """By response and source: the variance of each impact's log given its trace alone, [impact]."""
        measured = self._measured(errors)
        return {q: {name: v[:, at, at] for name, v in measured.items()} for at, q in enumerate(RESPONSES)}

    def of_means(self, errors: TraceErrors) -> dict[str, dict[str, float]]:
        """By response and source: the variance of the population's mean log at the reference mass."""
        locations = self.prepared.model.locations
        means = np.zeros((len(RESPONSES), locations.size))
        for row, q in zip(means, RESPONSES, strict=True):
            row[locations.parts[f"intercept_{q}"].start] = 1.0
            if len(covariates := typical_covariates(self.prepared.design, q)):
                row[locations.parts[f"covariate_effect_{q}"]] = covariates
        names, variances = self._variances(errors)
        parts = np.asarray(_of_means(variances, means))
        return {
            q: dict(zip(names, of_response.tolist(), strict=True))
            for q, of_response in zip(RESPONSES, parts, strict=True)
        }

    def of_impacts(self, errors: TraceErrors, whole: bool) -> dict[str, dict[str, np.ndarray]]:
        """By response and source: the variance of each impact's log, [impact].

        Where the data are not ``whole``, the means of person and condition count as known, and of errors of
        masses that impacts share all that the dataset declares is left.
        """
        names, variances = self._variances(errors)
        masses = np.array([name == MASS for name in names], float)
        total, parts = (np.asarray(part) for part in _of_impacts(variances, masses, float(whole)))
        own = dict.fromkeys([*self._measured(errors), *self.scatter])
        table: dict[str, dict[str, np.ndarray]] = {}
        for number, q in enumerate(RESPONSES):
            by_source = dict(zip(names, parts[:, number].T, strict=True))
            table[q] = {name: by_source[name] for name in own}
            if whole:
                table[q][PERSON_AND_CONDITION] = total[:, number] - parts[:, number].sum(1)
        return table


def _sources(prepared: Prepared) -> dict[str, str]:
    """What each unknown standard deviation of effects is a source by."""
    return {
        term.sd(q): _TERMS.get(term, f"{term.slope and f'{term.slope} by '}{term.grouping}")
        for q, part in prepared.design.responses.items()
        for term in part.terms
    }


def _new_levels(prepared: Prepared, draws: Draws, response: str) -> dict[str, float]:
    """The variances that a new level of every grouping and a new impact add at the reference mass."""
    terms = prepared.design.responses[response].terms
    sd = {_TERMS.get(term, term.grouping): term.sd(response) for term in terms if not term.slope}
    sd[IMPACTS] = f"sd_impact_{response}"
    return {source: float(np.mean(draws.population[name] ** 2)) for source, name in sd.items()}


def _shares(
    level: str,
    by_response: Mapping[str, Mapping[str, Variance]],
    drawn: Mapping[str, Variance] = MappingProxyType({}),
) -> pd.DataFrame:
    """Rows of the variances by response and source; their sum is the total."""
    rows = []
    for response, by_source in by_response.items():
        total = sum(by_source.values())
        sources = {**by_source, ALL: total, **({DRAWN: drawn[response]} if drawn else {})}
        rows += [
            (level, response, name, float(np.mean(v / total)), float(np.sqrt(max(np.median(v), 0.0))))
            for name, v in sources.items()
        ]
    return table_of_rows("interval_sources", rows)


def measurement_sd(budget: pd.DataFrame, response: str) -> float:
    """Standard deviation of the log of K or C of the median impact, given its trace alone."""
    rows = (budget["level"] == TRACE) & (budget["quantity"] == response) & (budget["source"] == ALL)
    return float(budget.loc[rows, "sd"].iloc[0])
