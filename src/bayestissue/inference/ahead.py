"""A second process: it compiles what a fit will need, and then does its share of the draws.

Most of a short fit is spent in the compiler. What the second half needs compiled is known from the data's
shapes alone: a worker on another core compiles it, keeps it, and leaves it in the folder of compiled
functions, where this process finds it. What is done draw by draw is then done by both.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from functools import partial
from queue import SimpleQueue
from threading import Thread
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
from bayestissue.inference.chains import Start, lowered_chain, run_compiled
from bayestissue.inference.compiling import (
    CHAINS,
    CHOICE,
    CORRECTION,
    DRAWS,
    PREDICTIONS,
    Function,
    Helper,
    Result,
)
from bayestissue.inference.ratios import compare_over
from bayestissue.inference.trace_correction import POINTS, Profile, flat_profile
from bayestissue.inference.trace_predictions import PREDICTIVE_DRAWS, prior_draws, replicates

# In the order in which a fit asks for them.
PARTS = (CHAINS, CORRECTION, CHOICE, DRAWS, PREDICTIONS)
# These ask whether the last parameter has a profile, which for some models only their traces tell.
_OF_PROFILE = (CHAINS, CORRECTION)
# In the worker: what it has compiled, by the part whose rows it may be asked for.
_COMPILED: dict[str, Any] = {}


@contextmanager
def second_process(prepared: Prepared, settings: Sampler) -> Iterator[Helper]:
    """A helper on another core for the length of a fit.

    There is none where there is no second core, no folder that keeps what is compiled, or an accelerator. A
    worker that fails costs time only: whoever asks then does for himself.
    """
    if not runtime.compiled_folder() or runtime.cores() < 2 or jax.default_backend() != "cpu":
        yield Helper()
        return
    from loky import ProcessPoolExecutor

    own = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else set()
    others = tuple(core for core in runtime.CORES if core not in own) or runtime.CORES
    # Functions that are compiled and kept would pass for a leak of memory, and the worker be replaced.
    kept = {"LOKY_MAX_MEMORY_LEAK_SIZE": "1e18"}
    core = others[0] if others else None
    pool = ProcessPoolExecutor(1, initializer=runtime.settle_on, initargs=(core,), env=kept)
    worker = _Worker(pool, Job.of(prepared, settings))
    try:
        yield worker
    finally:
        worker.close()
        pool.shutdown(wait=True, kill_workers=True)


class _Worker(Helper):
    """See `Helper`; jobs are done in the order in which they are asked for."""

    def __init__(self, pool: Any, job: Job) -> None:
        self._pool, self._job = pool, job
        self._profiled: bool | None = None
        self._parts: dict[str, Future] = {}
        self._queue: SimpleQueue[tuple[str, Future] | None] = SimpleQueue()
        Thread(target=self._compile_all, daemon=True).start()
        if job.model.kind == "arma" or not job.model.last_may_be_open:
            self._profiled = job.model.kind == "arma"
            self._compile(*PARTS)
        else:
            self._compile(CHOICE, DRAWS)

    def decided(self, *, profiled: bool) -> None:
        if profiled != self._profiled:
            self._profiled = profiled
            others = (part for part in PARTS if part not in (*_OF_PROFILE, *self._parts))
            self._compile(*_OF_PROFILE, *others)

    def wait(self, part: str) -> None:
        if part in self._parts:
            # A broken worker tells only when it is asked; what it should have done is then done here.
            self._parts[part].exception()

    def begin_rows(self, part: str, function: Function, *arguments: Any) -> Result:
        return self._begun(partial(function, *arguments), _rows, part, jax.device_get(arguments))

    def begin(self, function: Function, *arguments: Any) -> Result:
        return self._begun(partial(function, *arguments), function, *jax.device_get(arguments))

    def _begun(self, otherwise: Result, function: Function, *arguments: Any) -> Result:
        future = self._submitted(function, *arguments)

        def result() -> Any:
            return otherwise() if future.exception() is not None else future.result()

        return result

    def _compile(self, *parts: str) -> None:
        for part in parts:
            self._parts[part] = Future()
            self._queue.put((part, self._parts[part]))

    def _compile_all(self) -> None:
        """Ask for one part after another, so that what else is asked for meanwhile comes in between."""
        while (asked := self._queue.get()) is not None:
            part, told = asked
            error = self._submitted(_compile, part, self._job, bool(self._profiled)).exception()
            told.set_result(None) if error is None else told.set_exception(error)

    def close(self) -> None:
        """Ask for nothing any more."""
        self._queue.put(None)

    def _submitted(self, function: Function, *arguments: Any) -> Future:
        try:
            return self._pool.submit(function, *arguments)
        except Exception as error:
            failed: Future = Future()
            failed.set_exception(error)
            return failed


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


def _compile(what: str, job: Job, profiled: bool) -> None:
    compiled = [lowered.compile() for lowered in lowered_functions(what, job, profiled=profiled)]
    _COMPILED[what] = compiled[-1]
    if what == CHAINS:
        model = summary_path.spreads_of(job.model)
        _COMPILED[what] = partial(run_compiled, compiled, model)


def _rows(what: str, arguments: tuple[Any, ...]) -> Any:
    return jax.device_get(_COMPILED[what](*arguments))


def lowered_functions(what: str, job: Job, *, profiled: bool) -> Iterator[Any]:
    """The functions of one of `PARTS`, ready for the compiler, from shapes alone.

    Those done row by row are made for half of the draws, as `in_halves` asks for them.
    """
    model, data, settings, codes, counts = job
    impacts = data.log_mass.shape[0]
    size = 2 + len(model.nuisance)
    real = partial(jax.ShapeDtypeStruct, dtype=jnp.float64)
    summaries = Summaries._make(
        real(shape) for shape in ((impacts, size), (impacts, size), (impacts, size, size), (impacts,))
    )
    profile = _shapes(flat_profile(impacts)) if profiled else None
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
        yield from _of_correction(model, data, summaries, profile, raw, z_b)
    elif what == CHOICE:
        candidates = jax.ShapeDtypeStruct((), jnp.int64)
        rows = _half((raw, z_b, keys))
        yield summary_path.standard_impacts.lower(model, data, summaries, candidates, *rows)
    elif what == DRAWS:
        flat = raw | {"standard_locations": z_b, "standard_impacts": real((number, impacts, size))}
        groups = tuple(jax.ShapeDtypeStruct((count,), jnp.int64) for count in codes)
        yield trace_draws.unfold_all.lower(model, counts, data, summaries, groups, *_half((flat, keys)))
    elif what == PREDICTIONS:
        one = jax.ShapeDtypeStruct(keys.shape[1:], keys.dtype)
        yield prior_draws.lower(model, data, one)
        some = real((PREDICTIVE_DRAWS, impacts, size))
        of_some = jax.ShapeDtypeStruct((PREDICTIVE_DRAWS, *keys.shape[1:]), keys.dtype)
        yield replicates.lower(model, data, some, of_some)


def _half(rows: Any) -> Any:
    return jax.tree.map(
        lambda leaf: jax.ShapeDtypeStruct((-(-leaf.shape[0] // 2), *leaf.shape[1:]), leaf.dtype), rows
    )


def _of_correction(
    model: TraceModel,
    data: TraceData,
    summaries: Summaries,
    profile: Profile | None,
    raw: dict[str, Any],
    z_b: Any,
) -> Iterator[Any]:
    bare = data._replace(record=None)  # type: ignore[arg-type]
    some = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct((POINTS, *leaf.shape[1:]), leaf.dtype), (raw, z_b))
    yield summary_path.locations_of.lower(model, bare, summaries, *some)
    part = summary_path.locations_of.eval_shape(model, bare, summaries, *some)
    standard = jax.ShapeDtypeStruct((POINTS, summaries.centre.shape[1]), jnp.float64)
    yield compare_over.lower(model, data, summaries, part, standard, profile)
    ratios = compare_over.eval_shape(model, data, summaries, part, standard, profile)
    yield summary_path.log_weights.lower(model, bare, summaries, ratios, raw, z_b)
