"""Whether a model's form is plainly wrong, before its chains are run.

A fit without a discrepancy whose residuals will be plainly structured is followed by one with it, and only
the second is told. Its summaries tell as much: replicates of the traces from them need no chain.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from bayestissue.hierarchy.conditional import ImpactParts, Summaries, impact_values
from bayestissue.hierarchy.trace_data import Prepared
from bayestissue.hierarchy.traces import constrained
from bayestissue.inference.compiling import compiled_quickly
from bayestissue.inference.model_form import LIMIT, judged
from bayestissue.inference.trace_correction import expectation
from bayestissue.inference.trace_predictions import PREDICTIVE_DRAWS, replicates
from bayestissue.inference.trace_start import LAST, Summarised, last_mean

# Short of this a whole fit decides.
_PLAIN = 2 * LIMIT
# Fitted noise over the recorder's own, above which it is worth a look.
_SUSPICIOUS = 1.2


def plainly_wrong(prepared: Prepared, summarised: Summarised, seed: int) -> dict[str, Any] | None:
    """What `model_form` says of replicates from the summaries, where that leaves no doubt of the form.

    Args:
        prepared: the model and its data, decelerations.
        summarised: its summaries, and the mode of the spreads.
        seed: of the replicates.
    """
    fitted = np.asarray(summarised.summaries.centre)[:, 2] + np.asarray(prepared.data.log_peak)
    if np.median(np.exp(fitted) / np.maximum(prepared.signal.noise_sd, 1e-12)) < _SUSPICIOUS:
        return None
    key = jax.random.fold_in(jax.random.PRNGKey(seed), 31)
    keys = jax.random.split(key, PREDICTIVE_DRAWS)
    u = _draws(prepared, summarised, jax.random.fold_in(key, 1))
    made = replicates(prepared.model, prepared.data, u, keys)["deceleration"]
    inside = np.arange(made.shape[-1]) < prepared.signal.n_samples[:, None]
    measured = np.where(inside, prepared.signal.deceleration, np.nan)
    found = judged(measured, np.asarray(made))
    return found if found["score"] > _PLAIN else None


def _draws(prepared: Prepared, summarised: Summarised, key: Array) -> Float[Array, "draw impact parameter"]:
    """Every impact's parameters from the normals that the summaries make them, the spreads at their mode."""
    model, summaries = prepared.model, summarised.summaries
    mode = {name: jnp.asarray(value) for name, value in summarised.spreads.mode.items()}
    bare = prepared.data._replace(record=None)  # type: ignore[arg-type]
    spread, conditional, about = expectation(model, bare, summaries, constrained(model, mode))
    standard = jax.random.normal(key, (PREDICTIVE_DRAWS, *summaries.centre.shape))
    u = _values(conditional.parts, summaries, about, standard)
    if summarised.profile is None:
        return u
    # The summaries have no word on the last one.
    last = last_mean(conditional, mode[LAST]) + spread.nuisance[-1] * standard[..., -1]
    return u.at[..., -1].set(last)


@compiled_quickly()
def _values(
    parts: ImpactParts,
    summaries: Summaries,
    about: list[Array],
    standard: Float[Array, "draw impact parameter"],
) -> Float[Array, "draw impact parameter"]:
    return jax.lax.map(lambda z: jnp.stack(impact_values(parts, summaries, about, z), axis=-1), standard)
