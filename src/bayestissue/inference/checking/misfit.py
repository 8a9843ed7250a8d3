"""Whether a model's form is plainly wrong, before its chains are run.

A fit without a discrepancy whose residuals will be plainly structured is followed by one with it, and only
the second is told. The traces' own best fits tell as much, and need no chain and no population.
"""

from __future__ import annotations

from typing import Any

import jax
import numpy as np
from jax import Array
from jaxtyping import Float

from bayestissue.hierarchy.gaussian.factor import GaussianFactor
from bayestissue.hierarchy.trace_data import Prepared
from bayestissue.hierarchy.traces import TraceData
from bayestissue.inference.checking.model_form import LIMIT, judged
from bayestissue.inference.results.predictions import PREDICTIVE_DRAWS, replicates

# Short of this a whole fit decides.
_PLAIN = 2 * LIMIT
# Fitted noise over the recorder's own, above which it is worth a look.
_SUSPICIOUS = 1.2


def misfit_precheck(prepared: Prepared, expansions: GaussianFactor, seed: int) -> dict[str, Any] | None:
    """What `model_form` says of replicates of the best fits, where that leaves no doubt of the form.

    A best fit follows its trace more closely than the draws of a posterior do, and so understates what its
    residuals have in common.

    Args:
        prepared: the model and its data, decelerations.
        expansions: each trace's own, as `bayestissue.inference.posterior.approximate.expanded` finds them.
        seed: of the replicates.
    """
    best = np.asarray(expansions.centre)
    noise = np.exp(best[:, 2] + np.asarray(prepared.data.log_peak))
    if np.median(noise / np.maximum(prepared.signal.noise_sd, 1e-12)) < _SUSPICIOUS:
        return None
    key = jax.random.fold_in(jax.random.PRNGKey(seed), 31)
    verdict = judged_at(prepared, prepared.data, best, key)
    return verdict if verdict["score"] > _PLAIN else None


def judged_at(
    prepared: Prepared,
    data: TraceData,
    u: Float[np.ndarray, "impact parameter"],
    key: Array,
    offset: Float[np.ndarray, "impact 1"] | float = 0.0,
) -> dict[str, Any]:
    """`model_form` of decelerations less the offset, beside replicates of ``data`` at one u."""
    keys = jax.random.split(key, PREDICTIVE_DRAWS)
    draws = np.broadcast_to(u, (PREDICTIVE_DRAWS, *u.shape))
    replicated = replicates(prepared.model, data, draws, keys)["deceleration"]
    inside = np.arange(replicated.shape[-1]) < prepared.signal.n_samples[:, None]
    return judged(np.where(inside, prepared.signal.deceleration - offset, np.nan), replicated)
