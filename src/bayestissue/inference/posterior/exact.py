"""The first path: every trace in every step of the chains."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from bayestissue.hierarchy.specification import Sampler
from bayestissue.hierarchy.trace_data import Prepared
from bayestissue.hierarchy.traces import COORDINATES, TraceModel, sampled_model, warped
from bayestissue.inference.execution.chunks import Progress, silent
from bayestissue.inference.posterior.approximate import Approximation
from bayestissue.inference.samplers.nuts import Start, run_chains
from bayestissue.inference.samplers.sampling import Draws
from bayestissue.padding import bucket, padded_zeros


def exact_draws(
    prepared: Prepared,
    approximation: Approximation,
    settings: Sampler,
    seed: int,
    *,
    progress: Progress = silent,
    checkpoints: Path | None = None,
    processes: bool = True,
) -> Draws:
    """Draws of the sites of `sampled_model`, whose coordinates the sites make; see `run_chains`."""
    draws = run_chains(
        sampled_model,
        model_arguments(prepared, approximation),
        start_of(prepared, approximation),
        settings,
        seed,
        progress=progress,
        checkpoints=checkpoints,
        processes=processes,
    ).thinned(settings.thinning)
    sites = straightened(prepared.model, approximation, draws.sites)
    return replace(draws, sites=sites)


def model_arguments(prepared: Prepared, approximation: Approximation) -> tuple[Any, ...]:
    """What `sampled_model` takes, filled up to a `bucket` of impacts."""
    impacts = len(prepared.impacts)
    present = np.arange(bucket(impacts)) < impacts
    sites, warp = padded_zeros(approximation.sites), approximation.coordinates.warp
    return prepared.model, prepared.data.padded, sites, warp, present


def straightened(
    model: TraceModel, approximation: Approximation, sites: dict[str, np.ndarray]
) -> dict[str, np.ndarray]:
    """Draws as if no coordinate had been warped: unconstrained hyperparameters, and standard normals."""
    count, warp = len(model.hyperparameters), approximation.coordinates.warp
    raw = np.asarray(warp.part(slice(count))(sites[COORDINATES]))
    z_b = sites["standard_locations"]
    if approximation.grid is not None:
        z_b = np.asarray(warped(jnp.asarray(z_b), warp))
    others = {name: values for name, values in sites.items() if name != COORDINATES}
    others["standard_impacts"] = others["standard_impacts"][:, :, : len(approximation.sites.centre)]
    return (
        others
        | {"standard_locations": z_b}
        | dict(zip(model.hyperparameters, np.moveaxis(raw, -1, 0), strict=True))
    )


def start_of(prepared: Prepared, approximation: Approximation) -> Start:
    """Chains begin at the middle of the hyperparameters given the sites, and of all standard normals."""
    impacts, size = approximation.sites.centre.shape
    middle = {
        "standard_locations": np.zeros(prepared.model.locations.size),
        "standard_impacts": np.zeros((bucket(impacts), size)),
    }
    count = len(prepared.model.hyperparameters)
    covariance = approximation.coordinates.covariance[:count, :count]
    return Start({COORDINATES: np.zeros(count), **middle}, COORDINATES, covariance)
