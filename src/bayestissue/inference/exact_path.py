"""The first path: every trace in every step of the chains."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache, partial
from pathlib import Path

import jax.numpy as jnp
import numpy as np

from bayestissue.hierarchy.specification import Sampler
from bayestissue.hierarchy.trace_data import Prepared
from bayestissue.hierarchy.traces import TraceModel, sampled_model, warped
from bayestissue.inference.chains import Start, run_chains
from bayestissue.inference.sampling import Draws, Progress, silent
from bayestissue.inference.trace_start import LAST, Summarised


def exact_draws(
    prepared: Prepared,
    summarised: Summarised,
    settings: Sampler,
    seed: int,
    *,
    progress: Progress = silent,
    checkpoints: Path | None = None,
    processes: bool = True,
) -> Draws:
    """Draws of the sites of `sampled_model`, whose coordinates the summaries make; see `run_chains`."""
    draws = run_chains(
        model_of(prepared.model),
        (prepared.data, summarised.summaries, summarised.warp),
        start_of(prepared, summarised),
        settings,
        seed,
        progress=progress,
        checkpoints=checkpoints,
        processes=processes,
    ).thinned(settings.thinning)
    if summarised.warp is not None:
        straight = warped(jnp.asarray(draws.sites["standard_locations"]), summarised.warp)
        draws.sites["standard_locations"] = np.asarray(straight)
    return draws


@lru_cache(maxsize=8)
def model_of(model: TraceModel) -> Callable[..., None]:
    """The same function each time, so that what is compiled for it serves again."""
    return partial(sampled_model, model)


def start_of(prepared: Prepared, summarised: Summarised) -> Start:
    """Chains begin at the spreads' mode given the summaries, and at the middle of all standard normals."""
    middle = {
        "standard_locations": np.zeros(prepared.model.locations.size),
        "standard_impacts": np.zeros(summarised.summaries.centre.shape),
    }
    spreads = summarised.spreads.without(LAST)
    return Start({**spreads.mode, **middle}, tuple(sorted(spreads.mode)), spreads.covariance)
