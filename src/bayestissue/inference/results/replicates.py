"""Posterior and prior predictive draws: replicates of every trace."""

from __future__ import annotations

import warnings

import jax
import numpy as np
from jax import Array
from jaxtyping import Float

from bayestissue.base.arrays import JaxPerParameter, JaxPerSample
from bayestissue.inference.execution.compiling import by_row, padded
from bayestissue.inference.execution.kept import some_impacts
from bayestissue.inference.quantities.quantity_draws import Draws
from bayestissue.inference.samplers.sampling import flat, in_chains
from bayestissue.model.hierarchy.trace_data import Prepared
from bayestissue.model.hierarchy.trace_models import TraceData, TraceModel, trace_likelihood

PREDICTIVE_DRAWS, PRIOR_PREDICTIVE_DRAWS = 100, 50
# Steps of a replicate, in what its noise differs by from sample to sample: they add 1e-5 to its variance.
_STEPS = 64
# Below every digit of a double: nothing is rounded.
_NO_NOISE = 2.0**-80


def predicted(prepared: Prepared, draws: Draws, seed: int) -> dict[str, np.ndarray]:
    """About a hundred replicates of every trace, as what the likelihood is of."""
    u = draws.impacts["parameters"]
    u = u[:, :, some_impacts(u.shape[2])].astype(float)
    chains, length = u.shape[:2]
    u = u[:, :: max(1, chains * length // PREDICTIVE_DRAWS)]
    keys = jax.random.split(jax.random.fold_in(jax.random.PRNGKey(seed), 12), chains * u.shape[1])
    replicated = replicates(prepared.model, prepared.data, flat(u), keys)
    return in_chains({name: rounded(v) for name, v in replicated.items()}, u.shape[:2])


def rounded(replicates: Float[np.ndarray, "draw impact sample"]) -> Float[np.ndarray, "draw impact sample"]:
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

    That is the deceleration, and a force beside it; of a likelihood of displacements these, and the
    decelerations that follow.
    """
    samples = data.record.traces.shape[1]
    force = getattr(data.record, "force", None)
    ends = {} if force is None else {"force": force.y.shape[1]}
    replicated = _replicates(model, data, u, keys)
    return {name: values[..., : ends.get(name, samples)] for name, values in replicated.items()}


@padded(1, None)
@by_row(PREDICTIVE_DRAWS, constant=2)
def _replicates(
    model: TraceModel, data: TraceData, u: JaxPerParameter, key: Array
) -> dict[str, JaxPerSample]:
    """The same with as many samples as a `bayestissue.base.padding.bucket` holds."""
    replicate = trace_likelihood(model, data, list(u.T)).replicate(key)
    # Else the noise is made anew for every part of the row that is written: three times as long.
    return jax.lax.optimization_barrier(replicate)
