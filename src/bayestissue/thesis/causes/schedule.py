"""The batches of a run, computed by whoever there is, and kept as they are done."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from bayestissue.inference.execution.chunks import Progress, silent
from bayestissue.inference.execution.workers import computed
from bayestissue.results import whole_file
from bayestissue.thesis.causes.batches import Batch, run_batch


def run_batches(
    batches: Sequence[Batch],
    *,
    jobs: int = 1,
    scheduler: str | None = None,
    kept: Path | None = None,
    progress: Progress = silent,
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
    for place, table in computed(run_batch, left, jobs=jobs, scheduler=scheduler):
        batch = left[place]
        done[batch.name] = table
        if kept is not None:
            with whole_file(kept / f"{batch.name}.parquet") as staging:
                table.to_parquet(staging)
        progress(len(done), len(batches))
    return [done[batch.name] for batch in batches]


def _read(kept: Path | None, batch: Batch) -> pd.DataFrame | None:
    path = None if kept is None else kept / f"{batch.name}.parquet"
    return pd.read_parquet(path) if path is not None and path.is_file() else None
