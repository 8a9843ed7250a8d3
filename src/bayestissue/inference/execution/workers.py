"""Who computes: this process, worker processes of this machine, or a Dask cluster.

What is computed depends on its item alone, so who computes it makes no difference. A worker that dies takes
its items with it, and they are computed again by others.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import CancelledError, Executor, as_completed
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any

from bayestissue.base import runtime
from bayestissue.base.errors import InputError

# Workers that die this often without an item done between are no accident.
_DEATHS = 5
_PATIENCE_S = 4
# A worker that was just started loads for some seconds.
_WORKERS_S = 20.0
_SCHEDULER: ContextVar[str | None] = ContextVar("scheduler", default=None)


@contextmanager
def on_cluster(scheduler: str | None) -> Iterator[None]:
    """For the length of a block, what is shared out goes to the Dask scheduler at this address, if any.

    Raises:
        InputError: Dask is not installed, or the scheduler doesn't answer.
    """
    if scheduler is not None:
        _client(scheduler).close()
    token = _SCHEDULER.set(scheduler)
    try:
        yield
    finally:
        _SCHEDULER.reset(token)


def cluster() -> str | None:
    """The address of `on_cluster`."""
    return _SCHEDULER.get()


def computed[Item, Result](
    function: Callable[[Item], Result], items: Iterable[Item], *, jobs: int = 1, scheduler: str | None = None
) -> Iterator[tuple[int, Result]]:
    """``function`` of every item, each with the item's place, in whatever order they are done.

    Args:
        function: of one item.
        items: what it is computed of; in this process one after the other.
        jobs: worker processes on this machine; 1 computes in this process.
        scheduler: address of a Dask scheduler that is to compute instead, such as ``tcp://host:8786``.

    Raises:
        InputError: Dask is not installed, or the scheduler doesn't answer.
        RuntimeError: workers die again and again.
    """
    if scheduler is None and jobs == 1:
        yield from enumerate(map(function, items))
        return
    left, deaths = dict(enumerate(items)), 0
    while left:
        with _executor(min(jobs, len(left)), scheduler) as (pool, killed):
            futures = {pool.submit(_settled, function, item): number for number, item in left.items()}
            try:
                for future in as_completed(futures):
                    result = future.result()
                    del left[futures[future]]
                    deaths = 0
                    yield futures[future], result
            except killed as death:
                deaths += 1
                if deaths == _DEATHS:
                    raise RuntimeError(f"workers died {deaths} times with nothing done") from death


@contextmanager
def _executor(jobs: int, scheduler: str | None) -> Iterator[tuple[Executor, type[Exception]]]:
    """Who computes, for the length of a block, and the exception that says that a worker died."""
    if scheduler is None:
        from loky.process_executor import BrokenProcessPool

        with runtime.worker_pool(jobs) as pool:
            yield pool, BrokenProcessPool
        return
    client = _client(scheduler)
    import distributed

    try:
        yield client.get_executor(pure=False), distributed.KilledWorker
    except (CancelledError, OSError) as loss:
        if client.status == "running":
            raise
        lost = "the scheduler answers no longer"
        raise InputError.stated("scheduler.lost", "--scheduler", value=lost) from loss
    finally:
        client.close(timeout=_PATIENCE_S)


def _settled(function: Callable[[Any], Any], item: Any) -> Any:
    """An item in a worker, which someone else may have started."""
    runtime.configure()
    return function(item)


def _client(address: str) -> Any:
    try:
        import distributed
    except ImportError as error:
        raise InputError.stated("scheduler.dask", "--scheduler", value="not installed") from error
    try:
        # A client that fails waits for itself, and complains when collected; so a bare connection first.
        asyncio.run(_answers(address))
        client = distributed.Client(address, timeout=_PATIENCE_S, set_as_default=False)
    except Exception:  # whatever another program answers may be read as anything
        raise InputError.stated("scheduler.address", "--scheduler", value=address) from None
    try:
        client.wait_for_workers(1, timeout=_WORKERS_S)
    except TimeoutError:
        client.close(timeout=_PATIENCE_S)
        raise InputError.stated(
            "scheduler.lost", "--scheduler", value="a scheduler without workers"
        ) from None
    return client


async def _answers(address: str) -> None:
    """Return if a Dask scheduler is reached at the address within `_PATIENCE_S`; raise else."""
    from distributed.core import connect

    # Its own limit leaves out the greeting.
    async with asyncio.timeout(_PATIENCE_S):
        (await connect(address, timeout=_PATIENCE_S)).abort()
