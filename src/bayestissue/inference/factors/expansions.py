"""Where each trace's likelihood is greatest: a first guess, and its expansion about the maximum."""

from __future__ import annotations

from functools import partial

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from bayestissue.inference.execution.chunks import map_impacts
from bayestissue.inference.factors.conditional import ConditionalPrior
from bayestissue.inference.factors.sites import laplace_sites, weak_prior
from bayestissue.inference.points.point_fit import PointFit, fit_points
from bayestissue.mechanics.elements import element
from bayestissue.model.hierarchy.force_data import tells_added_mass
from bayestissue.model.hierarchy.gaussian.factor import GaussianFactor
from bayestissue.model.hierarchy.trace_data import Prepared
from bayestissue.model.hierarchy.trace_models import TraceData, TraceModel, with_normal_errors
from bayestissue.recordings.signal import Displacements

# What keeps artanh theta1 finite.
_NEAREST = 0.99


def first_guess(prepared: Prepared) -> Float[np.ndarray, "impact parameter"]:
    """Each impact's parameters: K and C from its point estimate, or of decelerations from its motion.

    Where these give no K it is from the time to peak, and where they give no C that of light damping.
    """
    signal, which = prepared.signal, element(prepared.model.element)
    if prepared.model.kind == "impact":
        (K, C), fit = _of_motion(signal), None
    else:
        fit = fit_points(signal.x, signal.n_samples, signal.dt, signal.mass, signal.gravity)
        K, C = fit.K, fit.C
    stiffness = np.where(np.isfinite(K) & (K > 0), K, signal.mass * (np.pi / 2 / signal.time_to_peak) ** 2)
    lightly = 0.1 * np.sqrt(stiffness * signal.mass)
    damping = np.where(np.isfinite(C) & (0.02 * lightly < C), C, lightly)
    guess = which.guess(jnp.asarray(stiffness), jnp.asarray(damping), jnp.asarray(signal.mass))
    columns = [*(np.log(np.asarray(values)) for values in guess), _noise(prepared, fit)]
    if fit is not None and prepared.model.kind == "arma":
        # artanh has no value at -1 and 1, where point estimates like to lie.
        columns.append(np.arctanh(np.clip(fit.theta1, -_NEAREST, _NEAREST)))
    columns += [np.full(len(stiffness), np.log(parameter.typical)) for parameter in which.extra]
    if prepared.model.contact:
        interval = signal.contact.interval_s > 0
        columns.append(
            np.where(
                interval, signal.contact.since_s / np.where(interval, signal.contact.interval_s, 1) - 0.5, 0
            )
        )
    columns += [np.zeros(len(stiffness))] * prepared.model.gain
    columns += [np.full(len(stiffness), prepared.model.priors.discrepancy.mean)] * prepared.model.discrepancy
    if prepared.force is not None:
        # Tissue that moves along accounts for what the force is more.
        ratio = prepared.force.log_ratio * (not tells_added_mass(prepared.force, which.name))
        columns += [prepared.force.log_noise - np.asarray(prepared.data.log_peak), ratio]
    return np.stack(columns, axis=1)


def _of_motion(signal: Displacements) -> Float[np.ndarray, "2 impact"]:
    """K and C by least squares of M d on penetration and velocity, as integrated from d."""
    moved = np.stack([signal.x, signal.v], axis=-1)
    inside = signal.inside & ~signal.at_limit
    moved = np.where(inside[..., None], moved, 0.0)
    squares = np.einsum("isa,isb->iab", moved, moved)
    products = np.einsum("isa,is->ia", moved, signal.mass[:, None] * signal.deceleration)
    return (np.linalg.pinv(squares, hermitian=True) @ products[..., None])[..., 0].T


def _noise(prepared: Prepared, fit: PointFit | None) -> np.ndarray:
    log_peak = np.asarray(prepared.data.log_peak)
    if fit is None:
        return np.log(np.maximum(prepared.signal.quiet.noise_sd, 1e-12)) - log_peak
    spectral = np.sqrt(1 + fit.theta1**2) if prepared.model.kind == "arma" else 1.0
    return np.log(np.maximum(fit.sigma_a, 1e-300) * spectral) - log_peak


def rows_of(sites: GaussianFactor, rows: np.ndarray) -> GaussianFactor:
    """Some impacts' sites."""
    return GaussianFactor(*(np.asarray(leaf)[rows] for leaf in sites))


def expanded(prepared: Prepared) -> GaussianFactor:
    """Every likelihood expanded at its own maximum."""
    start = first_guess(prepared)
    # A uniform error leaves its likelihood flat on top, which no expansion can describe.
    smooth = with_normal_errors(prepared.data)
    return laplace_of_all(prepared.model, smooth, start, weak_prior(start))


def laplace_of_all(
    model: TraceModel, smooth: TraceData, start: np.ndarray, prior: ConditionalPrior
) -> GaussianFactor:
    """`laplace_sites` of all impacts, block by block; errors of the traces are to be normal."""
    return map_impacts(partial(laplace_sites, model), smooth, start, prior.of_each())
