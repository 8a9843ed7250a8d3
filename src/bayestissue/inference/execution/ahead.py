"""A second process: it compiles what a fit will need, and then does its share of the draws.

Most of a short fit is spent in the compiler. What the second half needs compiled is known from the data's
shapes alone: a worker on another core compiles it, keeps it, and leaves it in the folder of compiled
functions, where this process finds it. What is done draw by draw is then done piece by piece by whoever is
free.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import Future
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field
from functools import partial
from itertools import count
from threading import Condition, Thread
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from bayestissue.hierarchy.gaussian.impacts import Sites
from bayestissue.hierarchy.specification import Sampler
from bayestissue.hierarchy.trace_data import Prepared
from bayestissue.hierarchy.traces import TraceData, TraceModel
from bayestissue.inference.execution.compiling import (
    CHAINS,
    CHOICE,
    CORRECTION,
    DRAWS,
    PREDICTIONS,
    Function,
    Helper,
    Result,
    length_of_piece,
)
from bayestissue.inference.execution.second_core import SecondCore, begun, submitted
from bayestissue.inference.factors import importance_ratios as ratios
from bayestissue.inference.factors.grid import flat_grid
from bayestissue.inference.factors.likelihoods import POINTS, densities_at
from bayestissue.inference.posterior import approximate as trace_start
from bayestissue.inference.posterior import constrained_draws as trace_draws
from bayestissue.inference.posterior import recipe as summary_path
from bayestissue.inference.posterior.conditional_prior import DRAWS as DRAWS_OF_CALL
from bayestissue.inference.posterior.conditional_prior import conditional_priors_of
from bayestissue.inference.posterior.coordinates import Coordinates, straight
from bayestissue.inference.results.predictions import PREDICTIVE_DRAWS, prior_draws, replicates
from bayestissue.inference.samplers.nuts import Known, lowered_chain, run_compiled

# In the order in which a fit asks for them.
PARTS = (CHAINS, CORRECTION, CHOICE, DRAWS, PREDICTIONS)
# Those of which the worker may be asked for its share.
IN_PIECES = (CHAINS, CHOICE, DRAWS)
# These ask whether the last parameter has a profile, which for some models only their traces tell.
_OF_PROFILE = (CHAINS, CORRECTION)
# In the worker: what it has compiled, by the fit's number and the part whose rows it may be asked for.
_COMPILED: dict[tuple[int, str], Any] = {}
_GIVEN: dict[tuple[int, str], tuple[Any, ...]] = {}
_NUMBERS = count()


@contextmanager
def second_process(prepared: Prepared, settings: Sampler, core: SecondCore | None = None) -> Iterator[Helper]:
    """A helper on another core for the length of a fit, where there is one.

    A worker that fails costs time only: whoever asks then does for himself.
    """
    with SecondCore() if core is None else nullcontext(core) as found:
        pool = found.pool()
        if pool is None:
            yield Helper()
            return
        worker = _Worker(pool, Job.of(prepared, settings))
        try:
            yield worker
        finally:
            worker.close()


class _Worker(Helper):
    """See `Helper`; a thread keeps the process busy, with pieces of what is shared before all else."""

    def __init__(self, pool: Any, job: Job) -> None:
        self._pool, self._job, self._number = pool, job, next(_NUMBERS)
        self._profiled: bool | None = None
        self._asked = False
        self._parts: dict[str, Future] = {}
        self._changed = Condition()
        self._to_compile: deque[str] = deque()
        self._compiled_here: set[str] = set()
        self._shared: _Shared | None = None
        self._closed = False

    def compile_ahead(self, *, profiled: bool | None = None) -> None:
        if self._asked:
            return
        self._asked = True
        if self._job.model.kind == "arma" or not self._job.model.weakly_identified:
            profiled = self._job.model.kind == "arma"
        self._profiled = profiled
        wanted = PARTS if profiled is not None else (CHOICE, DRAWS)
        self._compile(*wanted)

    def decided(self, *, profiled: bool) -> None:
        if not self._asked or profiled == self._profiled:
            return
        self._profiled = profiled
        self._compiled_here -= set(_OF_PROFILE)
        others = [part for part in PARTS if part not in (*_OF_PROFILE, *self._parts)]
        self._compile(*_OF_PROFILE, first=True)
        self._compile(*others)

    def wait(self, part: str) -> None:
        """Wait, and meanwhile compile what the worker would come to last."""
        while part in self._parts and not self._parts[part].done():
            other = self._not_begun()
            if other is None:
                # A broken worker tells only when it is asked; what it should have done is then done here.
                self._parts[part].exception()
                return
            for lowered in lowered_functions(other, self._job, profiled=bool(self._profiled)):
                lowered.compile()
            self._compiled_here.add(other)
            if other not in IN_PIECES:
                self._parts[other].set_result(None)
                continue
            # The worker too may be asked for it, and finds it in the folder of compiled functions.
            self._compile(other, first=other == part)
            if other == part:
                return

    def _not_begun(self) -> str | None:
        """The last part that nobody has compiled, which is then left to this process."""
        with self._changed:
            left = [part for part in self._to_compile if part not in self._compiled_here]
            if not left:
                return None
            self._to_compile.remove(left[-1])
            return left[-1]

    def share(
        self, part: str, function: Function, given: tuple[Any, ...], pieces: Sequence[tuple[Any, ...]]
    ) -> list[Any]:
        self.wait(part)
        arguments = jax.device_get((given, list(pieces)))
        shared = _Shared((self._number, part), arguments, deque(range(len(pieces))))
        with self._changed:
            self._shared = shared if part in self._parts else None
            self._changed.notify_all()
        made: dict[int, Any] = {}
        while len(made) + len(shared.made) < len(pieces):
            with self._changed:
                # What the worker could not do comes back to those that are left.
                self._changed.wait_for(lambda: shared.left or shared.under_way is None)
                place = shared.left.popleft() if shared.left else None
            if place is not None:
                made[place] = jax.block_until_ready(function(*given, *pieces[place]))
        self._shared = None
        return [(made | shared.made)[place] for place in range(len(pieces))]

    def begin(self, function: Function, *arguments: Any) -> Result:
        return begun(self._pool, function, arguments)

    def close(self) -> None:
        """Ask for nothing any more."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    def _compile(self, *parts: str, first: bool = False) -> None:
        if not self._parts:
            Thread(target=self._work, daemon=True).start()
        with self._changed:
            self._parts |= {part: Future() for part in parts}
            others = [part for part in self._to_compile if part not in parts]
            self._to_compile = deque([*parts, *others] if first else [*others, *parts])
            self._changed.notify_all()

    def _work(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._closed or self._to_compile or self._has_pieces())
                if self._closed:
                    return
                shared = self._shared if self._has_pieces() else None
                if shared is not None:
                    shared.under_way = shared.left.pop()
                else:
                    part = self._to_compile.popleft()
                    told = self._parts[part]
            if shared is not None:
                self._do_piece(shared)
            else:
                given = (self._number, part, self._job, bool(self._profiled))
                error = submitted(self._pool, _compile, *given).exception()
                told.set_result(None) if error is None else told.set_exception(error)

    def _has_pieces(self) -> bool:
        if self._shared is None or not self._shared.left:
            return False
        compiled = self._parts[self._shared.what[1]]
        return compiled.done() and compiled.exception() is None

    def _do_piece(self, shared: _Shared) -> None:
        given, pieces = shared.arguments
        place = shared.under_way
        assert place is not None  # noqa: S101 - it was just taken
        # What all pieces share is sent once.
        future = submitted(self._pool, _piece, shared.what, None if shared.sent else given, pieces[place])
        error = future.exception()
        with self._changed:
            shared.sent, shared.under_way = True, None
            if error is None:
                shared.made[place] = future.result()
            else:
                shared.left.append(place)
                self._shared = None
            self._changed.notify_all()


@dataclass
class _Shared:
    """A function's pieces, of which this process takes the first that is left, and the worker the last.

    Attributes:
        what: the fit's number and the part.
        arguments: those that all pieces share, and the pieces.
        left: places of pieces that nobody has begun.
        made: what the worker has made, by place.
        under_way: the place of the piece that the worker is at.
        sent: whether the worker has what all pieces share.
    """

    what: tuple[int, str]
    arguments: tuple[tuple[Any, ...], list[tuple[Any, ...]]]
    left: deque[int]
    made: dict[int, Any] = field(default_factory=dict)
    under_way: int | None = None
    sent: bool = False


class Job(NamedTuple):
    """All that determines what a fit will need compiled.

    Attributes:
        model: the model.
        data: shapes of the dataset.
        settings: how many chains and draws.
    """

    model: TraceModel
    data: TraceData
    settings: Sampler

    @classmethod
    def of(cls, prepared: Prepared, settings: Sampler) -> Job:
        """That of a fit."""
        return cls(prepared.model, _shapes(prepared.data), settings)


def _shapes(tree: Any) -> Any:
    return jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(np.shape(leaf), jnp.result_type(leaf)), tree)


def _compile(number: int, what: str, job: Job, profiled: bool) -> None:
    compiled = [lowered.compile() for lowered in lowered_functions(what, job, profiled=profiled)]
    _COMPILED[number, what] = compiled[-1]
    if what == CHAINS:
        model = summary_path.marginal_of(job.model)
        _COMPILED[number, what] = partial(run_compiled, compiled, model)
    elif what == CHOICE:
        # What it asks for is then in the folder of compiled functions.
        _COMPILED[number, what] = partial(summary_path.sir_proposals, job.model)


def _piece(what: tuple[int, str], given: tuple[Any, ...] | None, piece: tuple[Any, ...]) -> Any:
    if given is not None:
        _GIVEN.clear()
        _GIVEN[what] = given
    return jax.device_get(_COMPILED[what](*_GIVEN[what], *piece))


def lowered_functions(what: str, job: Job, *, profiled: bool) -> Iterator[Any]:
    """The functions of one of `PARTS`, ready for the compiler, from shapes alone.

    Those done row by row are made for a piece of the draws, as `in_pieces` asks for them.
    """
    model, data, settings = job
    impacts = data.log_mass.shape[0]
    size = 2 + len(model.nuisance)
    real = partial(jax.ShapeDtypeStruct, dtype=jnp.float64)
    summaries = Sites._make(
        real(shape) for shape in ((impacts, size), (impacts, size), (impacts, size, size), (impacts,))
    )
    profile = _shapes(flat_grid(impacts)) if profiled else None
    number = settings.chains * settings.draws
    bare = data._replace(record=None)  # type: ignore[arg-type]
    keys = jax.eval_shape(lambda: jax.random.split(jax.random.PRNGKey(0), number))
    if what == CHAINS:
        names = trace_start.names_of(model, profiled=profiled)
        spreads = Coordinates(names, straight(len(names)), np.eye(len(names)))
        arguments = (bare, summaries, profile, _shapes(spreads.warp))
        points = np.zeros((settings.chains, len(names)))
        start = summary_path.start_at(spreads, Known(points, points[:, 0], points))
        yield from lowered_chain(summary_path.marginal_of(model), arguments, start, settings)
    elif what == CORRECTION:
        yield from _of_correction(model, data, summaries, profiled=profiled)
    elif what == CHOICE:
        yield densities_at.lower(model, data, real((POINTS, impacts, size)), 1)
    elif what == DRAWS:
        sites = {name: real((number,)) for name in model.spreads}
        b, u = real((number, model.locations.size)), real((number, impacts, size))
        yield trace_draws.constrain_rows.lower(model, data, *_rows_of_piece((sites, b, u, u, keys)))
    elif what == PREDICTIONS:
        one = jax.ShapeDtypeStruct(keys.shape[1:], keys.dtype)
        yield prior_draws.lower(model, data, one)
        some = real((PREDICTIVE_DRAWS, impacts, size))
        of_some = jax.ShapeDtypeStruct((PREDICTIVE_DRAWS, *keys.shape[1:]), keys.dtype)
        yield replicates.lower(model, data, some, of_some)


def _rows_of_piece(rows: Any) -> Any:
    return jax.tree.map(
        lambda leaf: jax.ShapeDtypeStruct((length_of_piece(leaf.shape[0]), *leaf.shape[1:]), leaf.dtype), rows
    )


def _of_correction(model: TraceModel, data: TraceData, summaries: Sites, *, profiled: bool) -> Iterator[Any]:
    bare = data._replace(record=None)  # type: ignore[arg-type]
    real = partial(jax.ShapeDtypeStruct, dtype=jnp.float64)
    some = (
        {name: real((DRAWS_OF_CALL,)) for name in model.spreads},
        real((DRAWS_OF_CALL, model.locations.size)),
    )
    yield conditional_priors_of.lower(model, bare, summaries, *some, 1)
    impacts, size = summaries.centre.shape
    found = ratios.shapes(model, POINTS, impacts, profiled=profiled)
    anchors = (real((ratios.DRAWS, impacts, size)), real((ratios.DRAWS, 1, size, size)))
    yield ratios.corrections_of.lower(summaries, found, *anchors, 1)
