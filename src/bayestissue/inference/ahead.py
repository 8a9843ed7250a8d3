"""Compiling what a fit will need in another process, while this one still summarises the traces.

Most of a short fit is spent in the compiler. What the second half needs compiled is known from the data's
shapes alone: a worker on another core compiles it and leaves it in the folder of compiled functions, where
this process finds it.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from bayestissue import runtime
from bayestissue.hierarchy.conditional import Summaries
from bayestissue.hierarchy.specification import Sampler
from bayestissue.hierarchy.trace_data import Prepared
from bayestissue.hierarchy.traces import TraceData, TraceModel
from bayestissue.hierarchy.warp import Warp
from bayestissue.inference import summary_path, trace_draws, trace_start
from bayestissue.inference.chains import Start, lowered_chain
from bayestissue.inference.compiling import CHAINS, CORRECTION, DRAWS, PREDICTIONS, Wait, at_once
from bayestissue.inference.ratios import compare_over
from bayestissue.inference.trace_correction import POINTS, Profile, flat_profile
from bayestissue.inference.trace_predictions import PREDICTIVE_DRAWS, prior_draws, replicates

# In the order in which a fit asks for them.
PARTS = (CHAINS, CORRECTION, DRAWS, PREDICTIONS)


@contextmanager
def compiling_ahead(prepared: Prepared, settings: Sampler) -> Iterator[Wait]:
    """A function that waits until the named part of the summary path is compiled.

    Nothing is compiled ahead where there is no second core, no folder that keeps what is compiled, or an
    accelerator. A worker that fails costs time only: whoever calls compiles for himself.
    """
    if not runtime.compiled_folder() or runtime.cores() < 2 or jax.default_backend() != "cpu":
        yield at_once
        return
    from loky import ProcessPoolExecutor

    own = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else set()
    others = tuple(core for core in runtime.CORES if core not in own) or runtime.CORES
    pool = ProcessPoolExecutor(1, initializer=runtime.settle_on, initargs=(others[0] if others else None,))
    try:
        job = Job.of(prepared, settings)
        parts: dict[str, Future] = {name: pool.submit(_compile, name, job) for name in PARTS}

        def wait(what: str) -> None:
            # A broken worker tells only when it is asked; what it should have done is then done here.
            parts[what].exception()

        yield wait
    finally:
        pool.shutdown(wait=True, kill_workers=True)


class Job(NamedTuple):
    """All that determines what a fit will need compiled.

    Attributes:
        model: the model.
        data: shapes of the dataset.
        settings: how many chains and draws.
        codes: how many impacts are coded for each group of effects.
        counts: how many levels each group has.
    """

    model: TraceModel
    data: TraceData
    settings: Sampler
    codes: list[int]
    counts: tuple[int, ...]

    @classmethod
    def of(cls, prepared: Prepared, settings: Sampler) -> Job:
        """That of a fit."""
        design = prepared.design
        codes = [len(getattr(design, group)) for group in trace_draws.GROUPS]
        counts = tuple(len(getattr(design, f"{group}s")) for group in trace_draws.GROUPS)
        return cls(prepared.model, _shapes(prepared.data), settings, codes, counts)


def _shapes(tree: Any) -> Any:
    return jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(np.shape(leaf), jnp.result_type(leaf)), tree)


def _compile(what: str, job: Job) -> None:
    for lowered in lowered_functions(what, job):
        lowered.compile()


def lowered_functions(what: str, job: Job) -> Iterator[Any]:
    """The functions of one of `PARTS`, ready for the compiler, from shapes alone."""
    model, data, settings, codes, counts = job
    impacts = data.log_mass.shape[0]
    size = 2 + len(model.nuisance)
    real = partial(jax.ShapeDtypeStruct, dtype=jnp.float64)
    summaries = Summaries._make(
        real(shape) for shape in ((impacts, size), (impacts, size), (impacts, size, size), (impacts,))
    )
    profile = _shapes(flat_profile(impacts)) if model.kind == "arma" else None
    number = settings.chains * settings.draws
    raw = {name: real((number,)) for name in model.spreads}
    z_b = real((number, model.locations.size))
    bare = data._replace(record=None)  # type: ignore[arg-type]
    keys = jax.eval_shape(lambda: jax.random.split(jax.random.PRNGKey(0), number))
    if what == CHAINS:
        names = sorted([*model.spreads, *([trace_start.LAST] if profile is not None else [])])
        start = Start({name: np.zeros(()) for name in names}, tuple(names), np.eye(len(names)))
        warp = None if profile is None else Warp._make(real(()) for _ in Warp._fields)
        arguments = (bare, summaries, profile, warp)
        yield from lowered_chain(summary_path.spreads_of(model), arguments, start, settings)
    elif what == CORRECTION:
        yield from _of_correction(model, data, summaries, profile, raw, z_b, keys)
    elif what == DRAWS:
        flat = raw | {"standard_locations": z_b, "standard_impacts": real((number, impacts, size))}
        groups = tuple(jax.ShapeDtypeStruct((count,), jnp.int64) for count in codes)
        yield trace_draws.unfold_all.lower(model, counts, data, summaries, flat, keys, groups)
    elif what == PREDICTIONS:
        one = jax.ShapeDtypeStruct(keys.shape[1:], keys.dtype)
        yield prior_draws.lower(model, data, one)
        some = real((PREDICTIVE_DRAWS, impacts, size))
        of_some = jax.ShapeDtypeStruct((PREDICTIVE_DRAWS, *keys.shape[1:]), keys.dtype)
        yield replicates.lower(model, data, some, of_some)


def _of_correction(
    model: TraceModel,
    data: TraceData,
    summaries: Summaries,
    profile: Profile | None,
    raw: dict[str, Any],
    z_b: Any,
    keys: Any,
) -> Iterator[Any]:
    bare = data._replace(record=None)  # type: ignore[arg-type]
    some = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct((POINTS, *leaf.shape[1:]), leaf.dtype), (raw, z_b))
    yield summary_path.locations_of.lower(model, bare, summaries, *some)
    part = summary_path.locations_of.eval_shape(model, bare, summaries, *some)
    standard = jax.ShapeDtypeStruct((POINTS, summaries.centre.shape[1]), jnp.float64)
    yield compare_over.lower(model, data, summaries, part, standard, profile)
    ratios = compare_over.eval_shape(model, data, summaries, part, standard, profile)
    yield summary_path.log_weights.lower(model, bare, summaries, ratios, raw, z_b)
    candidates = jax.eval_shape(lambda: jnp.asarray(summary_path.CANDIDATES))
    yield summary_path.standard_impacts.lower(model, data, summaries, raw, z_b, keys, candidates)
