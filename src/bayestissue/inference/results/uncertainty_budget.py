"""Uncertainty budget: the share of each source in the posterior variance of log K and log C.

The sources are noise, measuring chain, mass, element, people, conditions and impacts. Everything is normal on
the log scale once the standard deviations are given. A posterior variance V is then homogeneous of degree one
in the variances that make it, so that V = sum_s v_s dV/dv_s: what each source makes adds up to the whole, and
is what a small change of that source alone would change. Of an impact this takes N and its parts N_a of
`bayestissue.inference.results.errors`; of the population's means, those of all impacts.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

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
    middle = _Hierarchy(part, _middle(part, draws, np.median))
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
        means = _Hierarchy(part, _middle(part, draws, _root_mean_square)).of_means(errors)
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
) -> tuple[Covariances, Float[Array, "parameter location entry"], Float[Array, "location location"]]:
    """The hierarchy at these standard deviations: covariances, columns of X, prior precision of b."""
    covariances, unit = model.covariances(hyperparameters), jnp.eye(model.locations.size)
    precision = covariances.precision_among(jnp.arange(len(unit)))
    return covariances, expected_by_cell(design, unit), precision


class _Hierarchy:
    """The normal hierarchy with its standard deviations given, every covariance by source."""

    def __init__(self, prepared: Prepared, hyperparameters: Hyperparameters) -> None:
        self._prepared = prepared
        design = prepared.data.design
        arrays = _dense(prepared.model, design._replace(cell=np.zeros(0, int)), hyperparameters)
        self._covariances, columns, self._prior = jax.device_get(arrays)
        self._columns = columns[..., np.asarray(design.cell)].transpose(2, 0, 1)
        self._scatter = _scatter(prepared, self._covariances)
        self.omega = np.sum(list(self._scatter.values()), axis=0)
        self._both = (np.arange(len(self.omega)) < 2).astype(float)
        # Prior variances of b's elements, of those alone that are errors of masses.
        of_masses = np.zeros(len(self._covariances.locations), bool)
        of_masses[prepared.model.locations.parts.get(MASS_ERROR, slice(0))] = True
        self._masses_alone = np.where(of_masses, self._covariances.locations**2, 0.0)
        self._errors_of_masses = -np.where(of_masses, self._columns, 0.0)

    def _measured(self, errors: TraceErrors) -> tuple[Matrices, dict[str, Matrices]]:
        """What the traces' errors and the mass's add, all together and by source."""
        of_mass = self._prepared.model.own_mass_sd**2 * np.multiply.outer(self._both, self._both)
        by_source = {**errors.parts, MASS: np.broadcast_to(of_mass, errors.total.shape)}
        return errors.total + of_mass, by_source

    def of_traces(self, errors: TraceErrors) -> dict[str, dict[str, np.ndarray]]:
        """By response and source: the variance of each impact's log given its trace alone, [impact]."""
        _, measured = self._measured(errors)
        return {q: {name: v[:, at, at] for name, v in measured.items()} for at, q in enumerate(RESPONSES)}

    def of_means(self, errors: TraceErrors) -> dict[str, dict[str, float]]:
        """By response and source: the variance of the population's mean log at the reference mass."""
        noise, measured = self._measured(errors)
        weight = np.linalg.inv(self.omega + noise)
        covariance = self._covariance_of_means(weight)
        parts = self._prepared.model.locations.parts
        shares: dict[str, dict[str, float]] = {}
        for response in RESPONSES:
            v = covariance[:, parts[f"intercept_{response}"].start]
            covariates = typical_covariates(self._prepared.design, response)
            if len(covariates):
                v = v + covariance[:, parts[f"covariate_effect_{response}"]] @ covariates
            w = np.einsum("iab,ibl,l->ia", weight, self._columns, v)
            of_measured = {
                name: float(np.einsum("ia,iab,ib->", w, matrix, w)) for name, matrix in measured.items()
            }
            of_scatter = {
                name: float(np.einsum("ia,ab,ib->", w, matrix, w)) for name, matrix in self._scatter.items()
            }
            shares[response] = _summed(of_measured, of_scatter, self._of_effects(v))
        return shares

    def _covariance_of_means(self, weight: Matrices) -> Float[np.ndarray, "location location"]:
        precision = np.einsum("ial,iab,ibm->lm", self._columns, weight, self._columns, optimize=True)
        return np.linalg.inv(precision + self._prior)

    def _of_effects(self, v: Float[np.ndarray, " location"]) -> dict[str, float]:
        """What people, their masses, conditions and priors add, of v' (prior precision) v."""
        sources, locations = _sources(self._prepared), self._prepared.model.locations
        variances = (self._prior @ v) ** 2 * self._covariances.locations**2
        groups = dict.fromkeys((MASS, PEOPLE, CONDITIONS, *sources.values(), PRIORS), 0.0)
        for part in locations.blocks:
            source = MASS if part.name == MASS_ERROR else sources[part.spread] if part.spread else PRIORS
            groups[source] += float(variances[locations.parts[part.name]].sum())
        return groups

    def of_impacts(self, errors: TraceErrors, whole: bool) -> dict[str, dict[str, np.ndarray]]:
        """By response and source: the variance of each impact's log, [impact].

        Where the data are not ``whole``, the means of person and condition count as known, and of errors of
        masses that impacts share all that the dataset declares is left.
        """
        noise, measured = self._measured(errors)
        precision = np.linalg.inv(noise)
        V = np.linalg.inv(np.linalg.inv(self.omega) + precision)
        gain = V @ precision
        left = np.eye(gain.shape[1]) - gain
        by_source = _summed(
            {name: np.einsum("iab,ibc,iac->ia", gain, matrix, gain) for name, matrix in measured.items()},
            {name: np.einsum("iab,bc,iac->ia", left, matrix, left) for name, matrix in self._scatter.items()},
        )
        if whole:
            covariance = self._covariance_of_means(np.linalg.inv(self.omega + noise))
            # K and C are those at the true mass: what is recorded, and its error.
            pulled = left @ self._columns + self._errors_of_masses
            posterior = np.einsum("ial,lm->iam", pulled, covariance)
            of_mass = np.einsum("ial,l->ia", (posterior @ self._prior) ** 2, self._masses_alone)
            by_source[PERSON_AND_CONDITION] = np.einsum("ial,ial->ia", posterior, pulled) - of_mass
            by_source[MASS] = by_source[MASS] + of_mass
        else:
            of_mass = np.einsum("ial,l->ia", self._errors_of_masses**2, self._masses_alone)
            by_source[MASS] = by_source[MASS] + of_mass
        return {
            q: {name: v[:, number] for name, v in by_source.items()} for number, q in enumerate(RESPONSES)
        }


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
