"""Who computes the batches: this process, worker processes of this machine, or a Dask cluster.

A batch's numbers depend on the batch alone, so who computes it makes no difference. A worker that dies takes
its batches with it, and they are computed again by others.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import as_completed
from pathlib import Path
from typing import Any

import pandas as pd

from bayestissue import runtime
from bayestissue.causes.batches import Batch, run_batch
from bayestissue.errors import InputError, Problem
from bayestissue.results import scratch, whole_file

Progress = Callable[[int, int], None]
# Workers that die this often without a batch done between are no accident.
_DEATHS = 5
_PATIENCE_S = 10


def run_batches(
    batches: Sequence[Batch],
    *,
    jobs: int = 1,
    scheduler: str | None = None,
    kept: Path | None = None,
    progress: Progress = lambda done, total: None,
) -> list[pd.DataFrame]:
    """The tables of all batches, in their order.

    Args:
        batches: what to compute.
        jobs: worker processes on this machine; 1 computes in this process.
        scheduler: address of a Dask scheduler that is to compute instead, such as ``tcp://host:8786``.
        kept: an existing folder to which finished batches are written, and where those of an earlier run of
            the same job are looked for.
        progress: told after every batch how many are done, and of how many.

    Raises:
        InputError: Dask is not installed, or the scheduler doesn't answer.
        RuntimeError: workers die again and again.
    """
    done = {batch.name: table for batch in batches if (table := _read(kept, batch)) is not None}
    left = [batch for batch in batches if batch.name not in done]
    progress(len(done), len(batches))
    compute = (
        _on_dask(left, scheduler) if scheduler else _here(left) if jobs == 1 else _in_workers(left, jobs)
    )
    for batch, table in compute:
        done[batch.name] = table
        if kept is not None:
            with whole_file(kept / f"{batch.name}.parquet") as staging:
                table.to_parquet(staging)
        progress(len(done), len(batches))
    return [done[batch.name] for batch in batches]


def _read(kept: Path | None, batch: Batch) -> pd.DataFrame | None:
    path = None if kept is None else kept / f"{batch.name}.parquet"
    return pd.read_parquet(path) if path is not None and path.is_file() else None


def _here(batches: Sequence[Batch]) -> Iterator[tuple[Batch, pd.DataFrame]]:
    for batch in batches:
        yield batch, run_batch(batch)


def _in_workers(batches: Sequence[Batch], jobs: int) -> Iterator[tuple[Batch, pd.DataFrame]]:
    from loky.process_executor import BrokenProcessPool

    left, deaths = {batch.name: batch for batch in batches}, 0
    while left:
        with scratch() as places, runtime.worker_pool(min(jobs, len(left)), places) as pool:
            futures = {pool.submit(run_batch, batch): batch for batch in left.values()}
            try:
                for future in as_completed(futures):
                    batch, table = futures[future], future.result()
                    del left[batch.name]
                    deaths = 0
                    yield batch, table
            except BrokenProcessPool as death:
                deaths += 1
                if deaths == _DEATHS:
                    raise RuntimeError(f"workers died {deaths} times without a batch done") from death


def _on_dask(batches: Sequence[Batch], address: str) -> Iterator[tuple[Batch, pd.DataFrame]]:
    distributed = _dask()
    client = _client(distributed, address)
    try:
        left, deaths = {batch.name: batch for batch in batches}, 0
        while left:
            futures = {client.submit(_settled, batch, pure=False): batch for batch in left.values()}
            try:
                for future in distributed.as_completed(list(futures), loop=client.loop):
                    batch, table = futures[future], future.result()
                    del left[batch.name]
                    deaths = 0
                    yield batch, table
            except distributed.KilledWorker as death:
                deaths += 1
                if deaths == _DEATHS:
                    raise RuntimeError(f"workers died {deaths} times without a batch done") from death
    finally:
        client.close()


def _settled(batch: Batch) -> pd.DataFrame:
    """A batch in a worker that someone else started."""
    runtime.configure()
    return run_batch(batch)


def _dask() -> Any:
    try:
        import distributed
    except ImportError as error:
        raise InputError(
            Problem(
                "--scheduler",
                "Dask beside this program",
                'Install it with pip install "bayestissue[dask]", or leave --scheduler out.',
                value="not installed",
            )
        ) from error
    return distributed


def _client(distributed: Any, address: str) -> Any:
    try:
        return distributed.Client(address, timeout=_PATIENCE_S, set_as_default=False)
    except (OSError, TimeoutError, ValueError) as error:
        raise InputError(
            Problem(
                "--scheduler",
                "the address of a running Dask scheduler, such as tcp://127.0.0.1:8786",
                "Start one with `dask scheduler` and workers with `dask worker ADDRESS`, or leave "
                "--scheduler out.",
                value=address,
            )
        ) from error
