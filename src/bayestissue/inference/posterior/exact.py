"""The first path: every trace in every step of the chains."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import jax.numpy as jnp
import numpy as np

from bayestissue.hierarchy.specification import Sampler
from bayestissue.hierarchy.trace_data import Prepared
from bayestissue.hierarchy.traces import COORDINATES, TraceModel, sampled_model, warped
from bayestissue.inference.execution.compiling import filled_up
from bayestissue.inference.execution.progress import Progress, silent
from bayestissue.inference.posterior.approximate import Approximation
from bayestissue.inference.samplers.nuts import Start, run_chains
from bayestissue.inference.samplers.sampling import Draws
from bayestissue.padding import bucket


def exact_draws(
    prepared: Prepared,
    summarised: Approximation,
    settings: Sampler,
    seed: int,
    *,
    progress: Progress = silent,
    checkpoints: Path | None = None,
    processes: bool = True,
) -> Draws:
    """Draws of the sites of `sampled_model`, whose coordinates the summaries make; see `run_chains`."""
    impacts = len(prepared.impacts)
    present = np.arange(bucket(impacts)) < impacts
    draws = run_chains(
        sampled_model,
        (prepared.model, *filled_up((prepared.data, summarised.summaries)), summarised.spreads.warp, present),
        start_of(prepared, summarised),
        settings,
        seed,
        progress=progress,
        checkpoints=checkpoints,
        processes=processes,
    ).thinned(settings.thinning)
    sites = straightened(prepared.model, summarised, draws.sites)
    return replace(draws, sites=sites)


def straightened(
    model: TraceModel, summarised: Approximation, sites: dict[str, np.ndarray]
) -> dict[str, np.ndarray]:
    """Draws as if no coordinate had been warped: the spreads' unconstrained values, and standard normals."""
    count, warp = len(model.spreads), summarised.spreads.warp
    raw = np.asarray(warp.part(slice(count))(sites[COORDINATES]))
    z_b = sites["standard_locations"]
    if summarised.profile is not None:
        z_b = np.asarray(warped(jnp.asarray(z_b), warp))
    rest = {name: values for name, values in sites.items() if name != COORDINATES}
    rest["standard_impacts"] = rest["standard_impacts"][:, :, : len(summarised.summaries.centre)]
    return rest | {"standard_locations": z_b} | dict(zip(model.spreads, np.moveaxis(raw, -1, 0), strict=True))


def start_of(prepared: Prepared, summarised: Approximation) -> Start:
    """Chains begin at the middle of the spreads given the summaries, and of all standard normals."""
    impacts, size = summarised.summaries.centre.shape
    middle = {
        "standard_locations": np.zeros(prepared.model.locations.size),
        "standard_impacts": np.zeros((bucket(impacts), size)),
    }
    count = len(prepared.model.spreads)
    covariance = summarised.spreads.covariance[:count, :count]
    return Start({COORDINATES: np.zeros(count), **middle}, (COORDINATES,), covariance)
