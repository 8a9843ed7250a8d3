"""Compiling what a fit will need in another process, while this one still summarises the traces.

Most of a short fit is spent in the compiler. What the second half needs compiled is known from the data's
shapes alone: a worker on another core compiles it and leaves it in the folder of compiled functions, where
this process finds it.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from bayestissue import runtime
from bayestissue.hierarchy.conditional import Summaries
from bayestissue.hierarchy.specification import Sampler
from bayestissue.hierarchy.trace_data import Prepared
from bayestissue.hierarchy.traces import TraceData, TraceModel
from bayestissue.hierarchy.warp import Warp
from bayestissue.inference import summary_path, trace_draws
from bayestissue.inference.chains import Start, compile_chain
from bayestissue.inference.ratios import compare_over
from bayestissue.inference.trace_correction import POINTS, Profile, flat_profile

CHAINS, CORRECTION, DRAWS = "chains", "correction", "draws"
Wait = Callable[[str], None]


@contextmanager
def compiling_ahead(prepared: Prepared, settings: Sampler) -> Iterator[Wait]:
    """A function that waits until the named part of the summary path is compiled.

    Nothing is compiled ahead where there is no second core, no folder that keeps what is compiled, or an
    accelerator. A worker that fails costs time only: whoever calls compiles for himself.
    """
    if not runtime.compiled_folder() or runtime.cores() < 2 or jax.default_backend() != "cpu":
        yield summary_path.at_once
        return
    from loky import ProcessPoolExecutor

    own = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else set()
    others = tuple(core for core in runtime.CORES if core not in own) or runtime.CORES
    pool = ProcessPoolExecutor(1, initializer=runtime.settle_on, initargs=(others[0] if others else None,))
    try:
        bare = _shapes(prepared.data)
        job = (prepared.model, bare, settings, [len(codes) for codes in _codes(prepared)], _counts(prepared))
        parts: dict[str, Future] = {
            name: pool.submit(_compile, name, *job) for name in (CHAINS, CORRECTION, DRAWS)
        }

        def wait(what: str) -> None:
            # A broken worker tells only when it is asked; what it should have done is then done here.
            parts[what].exception()

        yield wait
    finally:
        pool.shutdown(wait=True, kill_workers=True)


def _codes(prepared: Prepared) -> list[Any]:
    return [getattr(prepared.design, group) for group in trace_draws.GROUPS]


def _counts(prepared: Prepared) -> tuple[int, ...]:
    return tuple(len(getattr(prepared.design, f"{group}s")) for group in trace_draws.GROUPS)


def _shapes(tree: Any) -> Any:
    return jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(np.shape(leaf), jnp.result_type(leaf)), tree)


def _compile(
    what: str,
    model: TraceModel,
    data: TraceData,
    settings: Sampler,
    codes: list[int],
    counts: tuple[int, ...],
) -> None:
    """Compile one part from shapes alone."""
    impacts = data.log_mass.shape[0]
    size = 2 + len(model.nuisance)
    real = partial(jax.ShapeDtypeStruct, dtype=jnp.float64)
    summaries = Summaries._make(
        real(shape) for shape in ((impacts, size), (impacts, size), (impacts, size, size), (impacts,))
    )
    profile = _shapes(flat_profile(impacts)) if model.kind == "arma" else None
    number = settings.chains * settings.draws
    raw = {name: real((number,)) for name in model.spreads}
    bare = data._replace(record=None)  # type: ignore[arg-type]
    if what == CHAINS:
        names = sorted([*model.spreads, *(["standard_last"] if profile is not None else [])])
        start = Start({name: np.zeros(()) for name in names}, tuple(names), np.eye(len(names)))
        warp = None if profile is None else Warp._make(real(()) for _ in Warp._fields)
        arguments = (bare, summaries, profile, warp)
        compile_chain(summary_path.spreads_of(model), arguments, start, settings)
        return
    z_b = real((number, model.locations.size))
    keys = jax.eval_shape(lambda: jax.random.split(jax.random.PRNGKey(0), number))
    if what == CORRECTION:
        _compile_correction(model, data, summaries, profile, raw, z_b, keys)
        return
    flat = raw | {"standard_locations": z_b, "standard_impacts": real((number, impacts, size))}
    groups = tuple(jax.ShapeDtypeStruct((count,), jnp.int64) for count in codes)
    trace_draws.unfold_all.lower(model, counts, data, summaries, flat, keys, groups).compile()


def _compile_correction(
    model: TraceModel,
    data: TraceData,
    summaries: Summaries,
    profile: Profile | None,
    raw: dict[str, Any],
    z_b: Any,
    keys: Any,
) -> None:
    bare = data._replace(record=None)  # type: ignore[arg-type]
    some = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct((POINTS, *leaf.shape[1:]), leaf.dtype), (raw, z_b))
    summary_path.locations_of.lower(model, bare, summaries, *some).compile()
    part = jax.eval_shape(partial(summary_path.locations_of, model), bare, summaries, *some)
    standard = jax.ShapeDtypeStruct((POINTS, summaries.centre.shape[1]), jnp.float64)
    compare_over.lower(model, data, summaries, part, standard, profile).compile()
    ratios = jax.eval_shape(partial(compare_over, model), data, summaries, part, standard, profile)
    summary_path.log_weights.lower(model, bare, summaries, ratios, raw, z_b).compile()
    summary_path.standard_impacts.lower(model, data, summaries, raw, z_b, keys).compile()
