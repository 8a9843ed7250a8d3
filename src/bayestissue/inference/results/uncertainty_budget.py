"""Uncertainty budget: the share of each source in the posterior variance of log K and log C.

The sources are noise, measuring chain, mass, element, people, conditions and impacts. Everything is normal on
the log scale once the standard deviations are given. A posterior variance V is then homogeneous of degree one
in the variances v_s that make it, so that V = sum_s v_s dV/dv_s: what each source makes, by the derivative,
adds up to the whole, and is what a small change of that source alone would change. Of an impact this takes N
and its parts, of the population's means those of all impacts.

N is the Laplace covariance of an impact's parameters given its trace alone: N = P^-1 with the expected
information P = J' W J of u, J being what a unit of each parameter adds to the trace in units of its noise,
W = (1 + A A')^-1, and A what one standard deviation of each error adds. An estimate is off by
N J' W (A e + noise): error a has the part v_a v_a' of N with v_a = N J' W A_a, which is dN / d log s_a^2, and
the noise has what is left.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from jax import Array
from jaxtyping import Float

from bayestissue.base.impact_arrays import JaxPerParameter, PerParameter
from bayestissue.base.results.tables import joined, table_of_rows
from bayestissue.inference.execution.compiling import compiled_quickly, padded
from bayestissue.inference.execution.kept import some_of
from bayestissue.inference.quantities.quantity_draws import MASS_FACTOR, Draws
from bayestissue.model.hierarchy.derived import typical_covariates, typical_logs
from bayestissue.model.hierarchy.formulas.group_terms import SUBJECT, TRIAL
from bayestissue.model.hierarchy.gaussian.arrangement import PopulationDesign, expected_by_cell
from bayestissue.model.hierarchy.gaussian.effects import Covariances
from bayestissue.model.hierarchy.population import MASS_ERROR, Hyperparameters
from bayestissue.model.hierarchy.responses import RESPONSES, intercept
from bayestissue.model.hierarchy.trace_data import Prepared
from bayestissue.model.hierarchy.trace_models import (
    GAIN,
    TraceData,
    TraceModel,
    impact_likelihood,
    trace_likelihood,
    with_contact_at,
)
from bayestissue.model.likelihood.channels import whitened

# By source, its part of the variances of log K and log C.
type Account = Mapping[str, Float[np.ndarray, "*impact response"]]

# By source of error, what it adds to N: they add up to that.
Parts = dict[str, Float[np.ndarray, "impact parameter parameter"]]

NOISE, ELEMENT = "noise", "element"
# What the mean of a trace does not depend on: told apart from K and C, and as small as to be nothing.
_OF_NOISE = ("noise", "atanh_theta1", "discrepancy", "noise_force")
IMPACT, TYPICAL_PERSON, NEW_PERSON = "impact", "typical person", "new person"
TRACE = "trace alone"
MASS, SHAPE = "mass", "element's parameters"
COMMON_GAIN = "gain of all impacts"
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
    GAIN: COMMON_GAIN,
    "discrepancy": ELEMENT,
    "noise_force": NOISE,
    "log_force_ratio": NOISE,
}
# Parts of b that are errors which impacts share.
_SHARED = {MASS_ERROR: MASS, intercept(GAIN): COMMON_GAIN}


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
    middle = _variances(part, draws, np.median)
    errors = trace_errors(part, u, _RIDGE * np.linalg.inv(sum(middle.scatter.values())))
    own_mass = part.model.own_mass_sd**2 * np.pad(np.ones((2, 2)), (0, u.shape[1] - 2))
    measured = {**errors, MASS: np.broadcast_to(own_mass, errors[NOISE].shape)}
    drawn = np.stack([np.var(np.log(draws.impacts[q][:, :, rows]), axis=(0, 1)) for q in RESPONSES], axis=-1)
    if many and part.model.gain:
        # Of what the population leaves open the gain alone counts then, as the draws have it.
        drawn_gain = np.var(draws.population[intercept(GAIN)])
        of_gain = np.where(middle.effects[COMMON_GAIN] > 0, drawn_gain, 0.0)
        middle = middle._replace(effects={**middle.effects, COMMON_GAIN: of_gain})
    of_impacts = _of_impacts(middle._replace(measured=measured), float(not many))
    known = [*measured, *middle.scatter, *[PERSON_AND_CONDITION] * (not many)]
    tables = [
        _shares(IMPACT, _with_masses({name: np.asarray(of_impacts[name]) for name in known}, draws), drawn),
        _shares(TRACE, _of_traces(part.model, measured)),
    ]
    typical = np.array([np.var(typical_logs(prepared.design, draws.population, q)) for q in RESPONSES])
    means: Account = {PERSON_AND_CONDITION: typical}
    if not many:
        # Variances of means are linear in those of the hyperparameters, whose posteriors have long tails.
        middle = _variances(part, draws, lambda sd: np.sqrt(np.mean(sd**2)))
        of_means = _of_means(middle._replace(measured=measured), _means(part))
        names = [*measured, *middle.scatter, *middle.effects]
        means = _with_masses({name: np.asarray(of_means[name]) for name in names}, draws)
        tables.append(_shares(TYPICAL_PERSON, means, typical))
    added = _new_levels(prepared, draws)
    of_new = {**means, **{name: means.get(name, 0.0) + variance for name, variance in added.items()}}
    tables.append(_shares(NEW_PERSON, of_new, typical + sum(added.values())))
    return joined("interval_sources", tables)


def _with_masses(account: Account, draws: Draws) -> Account:
    """With the variance of what all declared masses are to be multiplied by, where a force tells of it."""
    if MASS_FACTOR not in draws.population:
        return account
    return {**account, MASS: account[MASS] + np.var(np.log(draws.population[MASS_FACTOR]))}


def _scatter(
    prepared: Prepared, covariances: Covariances
) -> dict[str, Float[np.ndarray, "parameter parameter"]]:
    """Covariance of u about X b by source, an error of mass left out."""
    model = prepared.model
    kk, kc, cc = covariances.pair
    size = len(model.parameters)
    scatter = {IMPACTS: np.zeros((size, size))}
    # The traces' own error of mass is a source by itself.
    scatter[IMPACTS][:2, :2] = np.array([[kk, kc], [kc, cc]]) - model.own_mass_sd**2
    for number, (name, sd) in enumerate(zip(model.nuisance, covariances.nuisance, strict=True), start=2):
        source = _NUISANCE.get(name, SHAPE)
        scatter.setdefault(source, np.zeros((size, size)))[number, number] = float(sd) ** 2
    return scatter


class _Variances(NamedTuple):
    """What makes the posterior variances, every table by source.

    Attributes:
        scatter: covariance of u about X b.
        effects: prior variances of b's elements.
        columns: X.
        measured: covariance of what the traces tell of u.
    """

    scatter: Mapping[str, Float[Array | np.ndarray, "parameter parameter"]]
    effects: Mapping[str, Float[Array | np.ndarray, " location"]]
    columns: Float[Array, "impact parameter location"]
    measured: Mapping[str, Float[Array | np.ndarray, "impact parameter parameter"]]

    def at(self, factor: dict[str, Array]) -> tuple[Array, Array, Array]:
        """Measured, scatter and effects, all sources together, the variances of each times its factor."""
        tables = (self.measured, self.scatter, self.effects)
        measured, scatter, effects = (
            sum((factor[name] * part for name, part in table.items()), jnp.zeros(())) for table in tables
        )
        return measured, scatter, effects

    def as_they_are(self) -> dict[str, Array]:
        """Factors of 1."""
        return dict.fromkeys({**self.measured, **self.scatter, **self.effects}, jnp.ones(()))


def _variances(prepared: Prepared, draws: Draws, middle: Callable[[np.ndarray], np.floating]) -> _Variances:
    """The hierarchy without traces, at the middle of the standard deviations and the median correlation."""
    hyperparameters = {name: middle(draws.population[name]) for name in prepared.model.hyperparameters}
    if "residual_correlation" in hyperparameters:
        hyperparameters["residual_correlation"] = np.median(draws.population["residual_correlation"])
    design, locations = prepared.data.design, prepared.model.locations
    # What each unknown standard deviation of effects is a source by.
    sources = {
        term.sd(q): _TERMS.get(term, f"{term.slope and f'{term.slope} by '}{term.grouping}")
        for q, part in prepared.design.responses.items()
        for term in part.terms
    }
    arrays = _dense(prepared.model, design._replace(cell=np.zeros(0, int)), hyperparameters)
    covariances, columns = jax.device_get(arrays)
    names = (*_SHARED.values(), PEOPLE, CONDITIONS, *sources.values(), PRIORS)
    effects = {name: np.zeros(locations.size) for name in names}
    for part in locations.blocks:
        source = sources.get(part.spread, _SHARED.get(part.name, PRIORS))
        rows = locations.parts[part.name]
        effects[source][rows] = covariances.locations[rows] ** 2
    columns = columns[..., np.asarray(design.cell)].transpose(2, 0, 1)
    return _Variances(_scatter(prepared, covariances), effects, columns, {})


@compiled_quickly
def _dense(
    model: TraceModel, design: PopulationDesign, hyperparameters: Hyperparameters
) -> tuple[Covariances, Float[Array, "parameter location entry"]]:
    """The hierarchy's covariances, and columns of X."""
    return model.covariances(hyperparameters), expected_by_cell(design, jnp.eye(model.locations.size))


@compiled_quickly
def _of_means(
    variances: _Variances, means: Float[Array, "response location"]
) -> dict[str, Float[Array, " response"]]:
    """Each source's part of the variance of such means of b's elements."""

    def variance(factor: dict[str, Array]) -> Array:
        measured, scatter, effects = variances.at(factor)
        covariance = jnp.linalg.inv(_told(variances, measured + scatter) + jnp.diag(1 / effects))
        return jnp.einsum("rl,lm,rm->r", means, covariance, means)

    return jax.jacfwd(variance)(variances.as_they_are())


@compiled_quickly
def _of_impacts(variances: _Variances, whole: Float[Array, ""]) -> dict[str, Float[Array, "impact response"]]:
    """Each source's part of the variances of the impacts' log K and log C.

    Of what is not known of b that of errors that impacts share counts by itself, the rest is
    `PERSON_AND_CONDITION`. Where the data are not ``whole`` but 0 that rest counts as known, and of errors of
    masses that impacts share all that the dataset declares is left.
    """
    one = variances.as_they_are()
    measured, scatter, _ = variances.at(one)
    precision = whole * _told(variances, measured + scatter)
    of_gain = variances.effects[COMMON_GAIN] > 0
    counts = jnp.where(of_gain, 1.0, whole)
    left_open = measured @ jnp.linalg.inv(measured + scatter) @ (counts * variances.columns)
    # K and C are those at the true mass: what is recorded, and its error.
    pulled = left_open - jnp.where(variances.effects[MASS] > 0, variances.columns, 0.0)

    def variance(factor: dict[str, Array]) -> Array:
        measured, scatter, _ = variances.at(factor)
        given_means = jnp.linalg.inv(jnp.linalg.inv(scatter) + jnp.linalg.inv(measured))
        _, _, effects = variances.at(one | {name: factor[name] for name in _SHARED.values()})
        covariance = jnp.linalg.inv(precision + jnp.diag(1 / effects))
        of_all = jnp.diagonal(given_means, axis1=1, axis2=2) + ((pulled @ covariance) * pulled).sum(-1)
        return of_all[:, : len(RESPONSES)]

    parts = jax.jacfwd(variance)(one)
    return parts | {PERSON_AND_CONDITION: variance(one) - sum(parts.values())}


def _of_traces(
    model: TraceModel, measured: Mapping[str, Float[np.ndarray, "impact parameter parameter"]]
) -> Account:
    """Each source's part of the variances that the traces alone leave log K and log C.

    A trace tells a gain that all impacts share beside its own K and C, and declared is a standard deviation
    s: of the estimates e, and N their covariance, e - N_g / (N_gg + s^2) e_g is left.
    """
    if not model.gain:
        return {name: np.diagonal(part[:, :2, :2], axis1=1, axis2=2) for name, part in measured.items()}
    at, variance = model.parameters.index(GAIN), model.priors.log_gain.sd**2
    total = sum(measured.values(), np.zeros(()))
    taken = total[:, :2, at] / (total[:, at, at] + variance)[:, None]
    unit = np.eye(total.shape[-1])
    left = unit[:2] - taken[..., None] * unit[at]
    parts = {name: np.einsum("irp,ipq,irq->ir", left, part, left) for name, part in measured.items()}
    return parts | {COMMON_GAIN: taken**2 * variance}


def _told(variances: _Variances, covariance: Array) -> Float[Array, "location location"]:
    """Precision of b by what the traces tell of u, of such a covariance about X b."""
    weight, columns = jnp.linalg.inv(covariance), variances.columns
    return jnp.einsum("ial,iab,ibm->lm", columns, weight, columns)


def _means(prepared: Prepared) -> Float[np.ndarray, "response location"]:
    """The population's mean logs at the reference mass, as sums of b's elements."""
    parts = prepared.model.locations.parts
    means = np.zeros((len(RESPONSES), prepared.model.locations.size))
    for row, response in zip(means, RESPONSES, strict=True):
        row[parts[f"intercept_{response}"].start] = 1.0
        covariates = typical_covariates(prepared.design, response)
        if len(covariates):
            row[parts[f"covariate_effect_{response}"]] = covariates
    return means


def _new_levels(prepared: Prepared, draws: Draws) -> Account:
    """The variances that a new level of every grouping and a new impact add at the reference mass."""
    added = {PEOPLE: np.zeros(len(RESPONSES)), CONDITIONS: np.zeros(len(RESPONSES))}
    for at, q in enumerate(RESPONSES):
        terms = prepared.design.responses[q].terms
        sd = {_TERMS.get(term, term.grouping): term.sd(q) for term in terms if not term.slope}
        for source, name in {**sd, IMPACTS: f"sd_impact_{q}"}.items():
            variances = added.setdefault(source, np.zeros(len(RESPONSES)))
            variances[at] = np.mean(draws.population[name] ** 2)
    return added


def _shares(
    level: str, account: Account, drawn: Float[np.ndarray, "*impact response"] | None = None
) -> pd.DataFrame:
    """Rows of the variances by response and source; their sum is the total."""
    total = sum(account.values(), np.zeros(()))
    sources = {**account, ALL: total, **({} if drawn is None else {DRAWN: drawn})}
    rows = []
    for at, q in enumerate(RESPONSES):
        for name, variance in sources.items():
            share, middle = np.mean((variance / total)[..., at]), np.median(variance[..., at])
            rows.append((level, q, name, float(share), float(np.sqrt(max(middle, 0.0)))))
    return table_of_rows("interval_sources", rows)


def measurement_sd(budget: pd.DataFrame, response: str) -> float:
    """Standard deviation of the log of K or C of the median impact, given its trace alone."""
    rows = (budget["level"] == TRACE) & (budget["quantity"] == response) & (budget["source"] == ALL)
    return float(budget.loc[rows, "sd"].iloc[0])


def trace_errors(
    prepared: Prepared, u: PerParameter, ridge: Float[np.ndarray, "parameter parameter"]
) -> Parts:
    """The parts of N.

    Args:
        prepared: the model and its data. A uniform error counts as a normal one of its standard deviation.
        u: where the likelihoods are expanded.
        ridge: a small precision, for parameters of which a trace says nothing.
    """
    slopes, shared = _over_noise(prepared.model, prepared.data, u)
    links = list(prepared.data.record.errors.values())
    of_noise = [0.0, 0.0, *(float(name in _OF_NOISE) for name in prepared.model.nuisance)]
    ridge = ridge + np.diag(of_noise)
    modes = shared.shape[1] - len(links)
    sources = [*links, *[ELEMENT] * modes]
    return by_source(slopes, np.roll(shared, -modes, axis=1), sources, ridge)


@padded(0)
@compiled_quickly
def _over_noise(
    model: TraceModel, data: TraceData, u: JaxPerParameter
) -> tuple[Float[Array, "impact parameter shock"], Float[Array, "impact error shock"]]:
    """J and A, contact being where the traces have it."""
    if model.kind == "impact":
        stated = impact_likelihood(model, data, list(u.T))
        data = with_contact_at(data, stated, stated.mean_first_time())

    white = whitened(lambda u: trace_likelihood(model, data, list(u.T)), u)
    return white.slopes, white.shared


def by_source(
    slopes: Float[np.ndarray, "impact parameter shock"],
    shared: Float[np.ndarray, "impact error shock"],
    sources: Sequence[str],
    ridge: Float[np.ndarray, "parameter parameter"] | float = 0.0,
) -> Parts:
    """The parts of N from J and A, whose columns have these sources; without those that have no error."""
    # J' W J = r' r, r being what least squares by A, an error costing its square, leave of J: no difference
    # of large numbers where errors are far above the noise.
    impacts, parameters, count = *slopes.shape[:2], shared.shape[1]
    errors = np.concatenate([shared.mT, np.broadcast_to(np.eye(count), (impacts, count, count))], axis=1)
    target = np.concatenate([slopes.mT, np.zeros((impacts, count, parameters))], axis=1)
    basis, triangle = np.linalg.qr(errors)
    along = basis.mT @ target
    gain, left = np.linalg.solve(triangle, along).mT, target - basis @ along
    covariance = np.linalg.inv(left.mT @ left + ridge)
    moved = covariance @ gain
    parts: Parts = {}
    for number, source in enumerate(sources):
        if shared[:, number].any():
            part = moved[:, :, None, number] * moved[:, None, :, number]
            parts[source] = parts.get(source, 0.0) + part
    others = sum(parts.values(), np.zeros_like(covariance))
    return {NOISE: covariance - others, **parts}
