"""The posterior of each impact's parameters given its own trace alone, under weak priors.

p(u | trace) is in proportion to p(trace | u) N(u; m, D^-1) and a prior of the damping ratio, u being log K,
log C and the parameters of the noise; the errors of the measuring chain are integrated out of the likelihood.
Importance sampling: points of a multivariate t about the Gaussian site times the prior, whose tails are
heavier than the posterior's, weighted by the posterior over their own density, the greatest weights
smoothed (Vehtari et al. 2024). Points fill the space evenly (Sobol's sequence) and are the same of every
impact, so that what is found of one depends on no other. What the impact came to is of some of them, drawn by
their weights, each with a draw of the chain's errors given the trace.
"""

from __future__ import annotations

from functools import cache, partial
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float
from scipy.special import ndtr, softmax
from scipy.stats import chi2, norm, qmc

from bayestissue.base.impact_arrays import (
    JaxPerParameter,
    JaxPerSample,
    MaskPerImpact,
    PerImpact,
    PerParameter,
    PerSample,
)
from bayestissue.base.result import Say, silent
from bayestissue.inference.execution.chunks import BLOCK, map_impacts
from bayestissue.inference.execution.compiling import compiled_quickly, padded
from bayestissue.inference.execution.workers import cluster
from bayestissue.inference.factors.conditional import ConditionalPrior, normals
from bayestissue.inference.factors.expansions import first_guess
from bayestissue.inference.factors.noise_left import noise_p
from bayestissue.inference.factors.sites import POINTS as AT_ONCE
from bayestissue.inference.factors.sites import laplace_sites, log_likelihoods
from bayestissue.inference.quantities.quantity_draws import DRAWS, recorded_outcomes
from bayestissue.inference.samplers.sampling import (
    k_threshold,
    pareto_smoothed,
    quantiles,
    weighted_quantiles,
)
from bayestissue.model.hierarchy.gaussian.factor import GaussianFactor
from bayestissue.model.hierarchy.trace_data import Prepared
from bayestissue.model.hierarchy.trace_models import (
    CONTACT,
    TraceData,
    TraceModel,
    impact_likelihood,
    physical,
    with_normal_errors,
)

POINTS = 1024
# Between two words of progress: as many as are computed at once.
_TOLD = AT_ONCE
# Degrees of freedom of the proposal.
_TAILS = 5.0
_ROUNDS = 4
# Of log K or log C: a search that ends nearer to its start has not begun.
_MOVES = 1e-9
# Cells of a skewed posterior's table, and standard deviations by which it goes beyond the prior's mean.
_CELLS, _REACH = 512, 4.0
# Of the points' dimensions, after those of the parameters: the t's common scale and the error of the mass.
_BESIDES = 2


class SinglePosteriors(NamedTuple):
    """What each trace by itself says of its impact.

    Attributes:
        quantities: of stiffness "K" [N/m], damping "C" [N s/m], natural frequency "omega_n" [rad/s], damping
            ratio "zeta", and "sigma", the standard deviation of the recorder's noise [m/s^2] or of a
            displacement's shocks [m]: ``median``, ``low`` and ``high``, the ends of the 90 % interval that
            leaves out as much probability on either side, and ``sd``. Of what the impact came to, by the
            names of `bayestissue.base.outcome_table.HEADFORM_OUTCOMES`, of a headform all of them,
            none of displacements: the same, but ``never``, the probability of what is infinite, for ``sd``.
        parameters: medians of log K, log C and the noise's parameters, K and C at the recorded mass.
        residuals: what the impact at the medians, and the chain's errors as the trace has them, leave of the
            trace [m/s^2]; 0 past its end; None of displacements.
        noise_p: p-value of what is left being the recorder's noise: see
            `bayestissue.inference.factors.noise_left`; None of displacements.
        moved: whether the search for the posterior's mode left the point that it started from.
        pareto_k: of the importance weights; above `bayestissue.inference.samplers.sampling.k_threshold`
            nothing vouches for the medians and intervals.
    """

    quantities: dict[str, dict[str, PerImpact]]
    parameters: PerParameter
    residuals: PerSample | None
    noise_p: PerImpact | None
    moved: MaskPerImpact
    pareto_k: PerImpact


def single_posteriors(prepared: Prepared, say: Say = silent) -> SinglePosteriors:
    """The posterior of every impact by itself, all of them in one chunked, compiled map.

    Args:
        prepared: recorded decelerations under the impact likelihood of a spring and damper with white noise,
            or displacements as ARMA(2,1); of its population the priors of the intercepts and of the noise
            alone are used.
        say: told the stage, how much of it is done, and its total: points of the posteriors, or blocks of
            impacts where there are many.
    """
    priors = prepared.model.priors
    # Contact's place has the prior of the recordings together, below.
    of_noise = (getattr(priors, name) for name in prepared.model.nuisance if name != CONTACT)
    normal = (priors.intercept.K, priors.intercept.C, *of_noise)
    mean, sd = (np.array([getattr(prior, name) for prior in normal], float) for name in ("mean", "sd"))
    if prepared.model.contact:
        phase = prepared.signal.phase
        mean, sd = np.append(mean, phase.mean), np.append(sd, phase.sd)
    say("each impact's first guess", 0, 1)
    start = first_guess(prepared)
    # Blocks may be others' work, who can't say anything here.
    alone = len(prepared.impacts) <= BLOCK and cluster() is None
    prior = ConditionalPrior(mean, np.diag(sd**-2.0))
    one = partial(_of_block, prepared.model, prior, say=say if alone else silent)
    progress = partial(say, "each impact's posterior")
    posteriors: SinglePosteriors = map_impacts(one, prepared.data, start, progress=progress)
    return posteriors


def _of_block(
    model: TraceModel, prior: ConditionalPrior, data: TraceData, start: PerParameter, *, say: Say
) -> SinglePosteriors:
    say("each impact's most probable values", 0, 1)
    prior = ConditionalPrior(np.broadcast_to(prior.mean, start.shape), prior.precision).of_each()
    sites = laplace_sites(model, with_normal_errors(data), start, prior)
    u, weight, pareto_k = _corrected(model, data, prior, sites, say)
    # A trace shows omega_n and zeta alone: of the mass, to which K and C are in proportion, it says nothing.
    of_mass = np.repeat(model.log_mass_sd * _standard(start.shape[1]).mass_error[:, None], u.shape[1], axis=1)
    by_mass = np.exp(of_mass)
    oscillator = physical(model, data, list(np.moveaxis(u, -1, 0)))
    middle = np.stack([_marginal(u[..., a], weight)["median"] for a in range(u.shape[-1])], axis=-1)
    drawn = {
        "K": np.exp(u[..., 0]) * by_mass,
        "C": np.exp(u[..., 1]) * by_mass,
        "omega_n": np.asarray(oscillator.omega_n),
        "zeta": np.asarray(oscillator.zeta),
        "sigma": np.exp(np.asarray(oscillator.log_sigma)),
    }
    quantities = {name: _marginal(values, weight) for name, values in drawn.items()}
    # The mass's error, as likely up as down, moves no median.
    quantities["K"]["median"], quantities["C"]["median"] = np.exp(middle[:, :2]).T
    recorded = model.kind == "impact"
    return SinglePosteriors(
        quantities | (_outcomes(model, data, u, of_mass, weight) if recorded else {}),
        middle,
        _residuals(model, data, middle)[:, : data.record.traces.shape[1]] if recorded else None,
        noise_p(model, data, middle) if recorded else None,
        np.any(np.abs(np.asarray(sites.centre) - start)[:, :2] > _MOVES, axis=1),
        pareto_k,
    )


def _corrected(
    model: TraceModel, data: TraceData, prior: ConditionalPrior, sites: GaussianFactor, say: Say
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points of each impact's posterior, their weights, which sum to 1, and Pareto k.

    Where the weights can't be trusted, the posterior being skewed, `_skewed` proposals follow, and then some
    with the mean and covariance of the weighted points (adaptive importance sampling); of an impact the best
    of them are kept.
    """
    even = _standard(sites.centre.shape[1])
    z, log_mass = even.normal * even.scale[:, None], np.asarray(data.log_mass)
    size, proposal = z.shape[1], normals(sites, prior)
    mean = proposal.at(np.zeros((len(sites.centre), size)))
    root = np.stack([proposal.at(np.broadcast_to(axis, mean.shape)) - mean for axis in np.eye(size)], axis=-1)
    # Points, weights and k of the best proposal of each impact.
    best = np.empty((len(z), *mean.shape)), np.empty((len(z), len(mean))), np.full(len(mean), np.inf)
    for turn in range(_ROUNDS):
        if turn == 1:
            u, log_density = _skewed(prior, sites, even, log_mass)
        else:
            u, log_density = mean + np.einsum("iab,pb->pia", root, z), _log_t(z)[:, None]
        stage, parts = f"each impact's posterior, turn {turn + 1} of at most {_ROUNDS}", []
        for begin in range(0, POINTS, _TOLD):
            say(stage, begin, POINTS)
            parts.append(log_likelihoods(model, data, u[begin : begin + _TOLD]))
        log_weight = np.concatenate(parts) + prior.log_density(u) + _of_damping(u, log_mass) - log_density
        smoothed = [pareto_smoothed(column) for column in log_weight.T]
        weight = np.exp(np.stack([log_share for log_share, _ in smoothed], axis=1))
        k = np.array([k for _, k in smoothed])
        # Where none has a finite k, the last.
        better = (k < best[2]) | np.isinf(best[2])
        for old, new, chosen in zip(best, (u, weight, k), (better[:, None], better, better), strict=True):
            np.copyto(old, new, where=chosen)
        bad = best[2] > k_threshold(POINTS)
        if not bad.any():
            break
        mean = np.where(bad[:, None], (weight[..., None] * u).sum(0), mean)
        deviation = u - mean
        covariance = np.einsum("pi,pia,pib->iab", weight, deviation, deviation, optimize=True)
        # A square root also where it is singular, all weight being a point's.
        values, axes = np.linalg.eigh(covariance)
        root = np.where(bad[:, None, None], axes * np.sqrt(np.maximum(values, 1e-300))[:, None], root)
    return best


def _of_damping(
    u: Float[np.ndarray, "*point impact parameter"], log_mass: Float[np.ndarray, "*#impact"]
) -> Float[np.ndarray, "*point impact"]:
    """Log prior 1 / (1 + 4 zeta^2) times 2 zeta / (1 + 2 zeta), 2 zeta being C / (K M)^1/2.

    A trace is linear in K where damping is strong, and in C where it is light. A prior level in their
    logarithms there puts most of itself where K, or C, is next to 0; this one is level in K, or C.
    """
    twice = u[..., 1] - (u[..., 0] + log_mass) / 2
    return -np.logaddexp(0.0, 2 * twice) - np.logaddexp(0.0, -twice)


def _skewed(
    prior: ConditionalPrior, sites: GaussianFactor, even: _Even, log_mass: PerImpact
) -> tuple[np.ndarray, np.ndarray]:
    """Points of a proposal for a posterior that is skewed along log K, or log C, and their log density.

    A trace that hardly tells K is linear in K itself: its log likelihood is then quadratic in
    r = K / K_m - 1, K_m being where the site is, and level where K tends to 0, which the prior alone bounds.
    The site's slope g and precision P in log K are g and P + g in r. The other parameters are normal given r,
    and integrated out for the density of log K, which is tabulated; a part of it is flattened, for its tails.
    """
    rows, size = np.arange(len(sites.centre)), sites.centre.shape[1]
    weak = np.diagonal(np.linalg.inv(sites.precision + prior.precision), axis1=1, axis2=2)[:, :2].argmax(1)
    # With the parameter that is hardly told in the first place; the same order puts it back.
    order = np.repeat(np.arange(size)[None], len(rows), axis=0)
    order[:, :2] = np.stack([weak, 1 - weak], axis=1)
    by_row, by_pair = (rows[:, None], order), (rows[:, None, None], order[:, :, None], order[:, None])
    centre, mean, shift = (part[by_row] for part in (np.asarray(sites.centre), prior.mean, sites.shift))
    precision, of_prior = np.asarray(sites.precision)[by_pair], prior.precision[by_pair]
    covariance, cross = np.linalg.inv((precision + of_prior)[:, 1:, 1:]), precision[:, 0, 1:]
    pull = shift - np.matvec(of_prior, centre - mean)
    toward, moved = np.matvec(covariance, cross), np.matvec(covariance, pull[:, 1:])
    slope, bend = shift[:, 0] - np.vecdot(cross, moved), precision[:, 0, 0] - np.vecdot(cross, toward)
    from_mean, sd = centre[:, 0] - mean[:, 0], of_prior[:, 0, 0] ** -0.5
    unit = 1 / np.sqrt(bend + sd**-2.0)
    reach = np.arcsinh((np.abs(from_mean) + _REACH * sd) / unit)
    ends = unit[:, None] * np.sinh(reach[:, None] * np.linspace(-1, 1, _CELLS + 1))
    middle, width = (ends[:, 1:] + ends[:, :-1]) / 2, np.diff(ends)
    r = np.expm1(middle)
    bent = np.maximum(bend + slope, 0.0)
    table = (slope[:, None] - bent[:, None] * r / 2) * r
    table -= np.square(from_mean[:, None] + middle) / (2 * np.square(sd)[:, None])
    along = np.repeat(np.asarray(sites.centre)[:, None], _CELLS, axis=1)
    along[rows, :, weak] += middle
    table += _of_damping(along, log_mass[:, None])
    mass = sum(
        part * softmax(power * table + np.log(width), axis=1) for part, power in ((0.8, 1.0), (0.2, 0.25))
    )
    below = np.pad(np.cumsum(mass, axis=1), ((0, 0), (1, 0)))
    uniform = ndtr(even.normal[:, 0])
    step = np.stack([np.interp(uniform, *pair) for pair in zip(below, ends, strict=True)], axis=1)
    cell = np.stack([np.searchsorted(row, steps) for row, steps in zip(ends, step.T, strict=True)], axis=1)
    cell = np.clip(cell - 1, 0, _CELLS - 1)
    log_density = np.log((mass / width)[rows, cell])
    t = even.normal[:, 1:] * even.scale[:, None]
    root = np.linalg.cholesky(covariance)
    given_step = centre[:, 1:] + moved - toward * np.expm1(step)[..., None]
    u = np.concatenate(
        [(centre[:, 0] + step)[..., None], given_step + np.einsum("iab,pb->pia", root, t)], axis=-1
    )
    return u[:, *by_row], log_density + _log_t(t)[:, None]


def _log_t(z: Float[np.ndarray, "point parameter"]) -> Float[np.ndarray, " point"]:
    """Log density of a standard multivariate t, up to a constant."""
    return -(_TAILS + z.shape[1]) / 2 * np.log1p(np.square(z).sum(1) / _TAILS)


class _Even(NamedTuple):
    """Points that fill the space evenly.

    Attributes:
        normal: standard normals.
        scale: what makes a multivariate t of them.
        mass_error: standard normals for the error of the mass.
    """

    normal: Float[np.ndarray, "point parameter"]
    scale: Float[np.ndarray, " point"]
    mass_error: Float[np.ndarray, " point"]


@cache
def _standard(size: int) -> _Even:
    """Such points for so many parameters."""
    even = np.clip(qmc.Sobol(size + _BESIDES, seed=20).random(POINTS), 1e-9, 1 - 1e-9)
    scale = np.sqrt(_TAILS / chi2.ppf(even[:, size], _TAILS))
    return _Even(norm.ppf(even[:, :size]), scale, norm.ppf(even[:, size + 1]))


def _outcomes(
    model: TraceModel,
    data: TraceData,
    u: Float[np.ndarray, "point impact parameter"],
    mass_error: Float[np.ndarray, "point impact"],
    weight: Float[np.ndarray, "point impact"],
) -> dict[str, dict[str, PerImpact]]:
    """What the impacts came to, at points drawn by their weights and with draws of the chain's errors."""
    # In a random order: every so many of points that fill the space evenly lie in one part of it.
    order = np.random.default_rng(20).permutation(len(u))
    levels = (np.arange(DRAWS) + 0.5) / DRAWS
    keys = np.asarray(jax.random.split(jax.random.PRNGKey(0), DRAWS))
    draws = []
    # One by one, so that what is drawn for an impact depends on no other.
    for number, column in enumerate(np.cumsum(weight[order], axis=0).T):
        at, alone = order[np.searchsorted(column, levels * column[-1])], np.array([number])
        of_rows = u[at][:, alone], mass_error[at][:, alone]
        draws.append(recorded_outcomes(model, data.impacts(alone), *of_rows, keys))
    outcomes = {}
    for name in draws[0]:
        values = np.concatenate([one[name] for one in draws], axis=1)
        low, median, high = quantiles(values.T, [0.05, 0.5, 0.95])
        never = np.isinf(values).mean(axis=0)
        outcomes[name] = {"median": median, "low": low, "high": high, "never": never}
    return outcomes


def _marginal(
    values: Float[np.ndarray, "point impact"], weight: Float[np.ndarray, "point impact"]
) -> dict[str, PerImpact]:
    """Weighted quantiles and standard deviation."""
    low, median, high = weighted_quantiles(values.T, weight.T, (0.05, 0.5, 0.95))
    mean = (weight * values).sum(0)
    sd = np.sqrt((weight * (values - mean) ** 2).sum(0))
    return {"median": median, "low": low, "high": high, "sd": sd}


@padded(0)
@compiled_quickly
def _residuals(model: TraceModel, data: TraceData, u: JaxPerParameter) -> JaxPerSample:
    """Residuals, of errors of the chain that are a draw given the trace."""
    key = jax.random.PRNGKey(0)
    event = impact_likelihood(model, data, list(u.T)).with_contact_found(key)
    return event.residuals(event.draw_errors(key))
