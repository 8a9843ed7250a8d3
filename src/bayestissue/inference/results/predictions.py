"""Posterior and prior predictive draws: replicates of every trace, and draws of the priors."""

from __future__ import annotations

import warnings
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float
from numpyro.infer import Predictive

from bayestissue.hierarchy.trace_data import Prepared
from bayestissue.hierarchy.traces import TraceData, TraceModel, impacts_model, trace_likelihood
from bayestissue.inference.execution.compiling import by_row, compiled_quickly
from bayestissue.inference.execution.kept import some_impacts
from bayestissue.inference.samplers.sampling import ConstrainedDraws, thinned
from bayestissue.padding import padded_impacts

PREDICTIVE_DRAWS = 100
PRIOR_DRAWS, PRIOR_PREDICTIVE_DRAWS = 1000, 50
# Steps of a replicate, in what its noise differs by from sample to sample: they add 1e-5 to its variance.
_STEPS = 64
# Below every digit of a double: nothing is rounded.
_NO_NOISE = 2.0**-80


def predicted(prepared: Prepared, constrained: ConstrainedDraws, seed: int) -> dict[str, np.ndarray]:
    """About a hundred replicates of every trace, as what the likelihood is of."""
    parameters = constrained.impacts["parameters"]
    if constrained.kept_numbers is not None:
        parameters = parameters[:, :, some_impacts(parameters.shape[2])].astype(float)
    parameters_of_draws = thinned({"u": parameters}, PREDICTIVE_DRAWS)["u"]
    flat = parameters_of_draws.reshape(-1, *parameters_of_draws.shape[2:])
    keys = jax.random.split(jax.random.fold_in(jax.random.PRNGKey(seed), 12), len(flat))
    replicated = replicates(prepared.model, prepared.data, flat, keys)
    return {
        name: rounded(v).reshape(*parameters_of_draws.shape[:2], *v.shape[1:])
        for name, v in replicated.items()
    }


def rounded(
    replicates: Float[np.ndarray, "draw impact sample"],
) -> Float[np.ndarray, "draw impact sample"]:
    """The same in steps that are powers of two and far below the noise, which a file packs well."""
    with warnings.catch_warnings():
        # Of a trace of NaN alone.
        warnings.simplefilter("ignore", RuntimeWarning)
        noise = np.nanmedian(np.std(np.diff(replicates, 2), axis=0), axis=-1, keepdims=True)
    step = np.exp2(np.floor(np.log2(np.where(noise > 0, noise, _NO_NOISE) / _STEPS)))
    return (np.round(replicates / step) * step).astype(np.float32)


def replicates(
    model: TraceModel, data: TraceData, u: Float[np.ndarray, "draw impact parameter"], keys: Array
) -> dict[str, Float[np.ndarray, "draw impact sample"]]:
    """A replicate of every trace for each draw of ``u``, as what the likelihood is of.

    That is the deceleration; of a likelihood of displacements these, and the decelerations that follow.
    """
    impacts, samples = data.record.traces.shape
    replicated = _replicates(model, replace(data.padded, design=None), padded_impacts(u, 1), keys)  # type: ignore[arg-type]
    return {name: values[:, :impacts, :samples] for name, values in replicated.items()}


@by_row(PREDICTIVE_DRAWS, constant=2)
def _replicates(
    model: TraceModel, data: TraceData, u: Float[Array, "impact parameter"], key: Array
) -> dict[str, Float[Array, "impact sample"]]:
    """What is compiled of `replicates`."""
    replicate = trace_likelihood(model, data, list(u.T)).replicate(key)
    # Else the noise is made anew for every part of the row that is written: three times as long.
    return jax.lax.optimization_barrier(replicate)


def prior_draws(
    model: TraceModel, data: TraceData, key: Array
) -> tuple[dict[str, np.ndarray], Float[np.ndarray, "draw impact parameter"]]:
    """Draws from the priors: of the population, and of each impact's parameters."""
    drawn, u = jax.device_get(_prior_draws(model, data.padded, key))
    return drawn, u[:, : len(data.log_mass)]


@compiled_quickly
def _prior_draws(
    model: TraceModel, data: TraceData, key: Array
) -> tuple[dict[str, Array], Float[Array, "draw impact parameter"]]:
    """What is compiled of `prior_draws`."""
    shared = ["log_mass_error"] if model.mass_error == "subject" else []
    bare = Predictive(
        lambda: impacts_model(model, data),
        num_samples=PRIOR_DRAWS,
        return_sites=[*model.hyperparameters, "locations", "log_K_and_C", *model.nuisance, *shared],
    )
    drawn = bare(key)
    nuisance = [drawn.pop(name)[..., None] for name in model.nuisance]
    return drawn, jnp.concatenate([drawn.pop("log_K_and_C"), *nuisance], axis=-1)
