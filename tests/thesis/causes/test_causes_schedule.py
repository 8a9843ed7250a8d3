from __future__ import annotations

import gc
import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pandas as pd
import psutil
import pytest
from causes_bench import work

from bayestissue.errors import InputError
from bayestissue.hierarchy.gaussian.arrangement import arrange
from bayestissue.hierarchy.traces import TraceData
from bayestissue.inference.execution import chunks
from bayestissue.inference.execution import workers as execution
from bayestissue.inference.execution.chunks import in_blocks
from bayestissue.inference.execution.workers import _PATIENCE_S, computed, on_cluster
from bayestissue.inference.points import fit
from bayestissue.likelihood.arma.displacement import displacement_record
from bayestissue.thesis.causes.batches import Batch, run_batches

pytestmark = pytest.mark.filterwarnings("ignore::ResourceWarning")


@pytest.fixture(scope="module", autouse=True)
def _connections_collected() -> Iterator[None]:
    """What Dask's connections leave behind is collected here, where its warnings are expected."""
    yield
    gc.collect()


@pytest.fixture(scope="module")
def batches() -> list[Batch]:
    return work("centring", "anticipation")


@pytest.fixture(scope="module")
def expected(batches: list[Batch]) -> pd.DataFrame:
    return pd.concat(run_batches(batches))


class Killer:
    """A progress function that kills one process when the first batch is done."""

    def __init__(self, *victims: int) -> None:
        self.victims, self.killed = list(victims), 0

    def __call__(self, done: int, total: int) -> None:
        if 1 <= done < total and not self.killed:
            own = psutil.Process().children(recursive=True)
            workers = [child.pid for child in own if any("LokyProcess" in part for part in child.cmdline())]
            os.kill((self.victims or workers)[0], signal.SIGKILL)
            self.killed += 1


@pytest.mark.slow
def test_worker_processes_give_the_same_numbers_though_one_is_killed(
    batches: list[Batch], expected: pd.DataFrame
) -> None:
    killer = Killer()
    found = pd.concat(run_batches(batches[:3], jobs=2, progress=killer))
    assert killer.killed == 1
    pd.testing.assert_frame_equal(found, expected.iloc[: len(found)], check_exact=True)


@pytest.mark.slow
def test_finished_batches_are_not_computed_again(
    batches: list[Batch], expected: pd.DataFrame, tmp_path: Path
) -> None:
    class Stop(Exception):  # noqa: N818
        pass

    def interrupt(done: int, total: int) -> None:
        if done == 3:
            raise Stop

    with pytest.raises(Stop):
        run_batches(batches, folder=tmp_path, progress=interrupt)
    written = {path.name: path.stat().st_mtime_ns for path in tmp_path.iterdir()}
    assert len(written) == 3
    counts: list[int] = []
    found = pd.concat(run_batches(batches, folder=tmp_path, progress=lambda done, total: counts.append(done)))
    assert counts[0] == 3
    assert all((tmp_path / name).stat().st_mtime_ns == when for name, when in written.items())
    pd.testing.assert_frame_equal(found, expected, check_exact=True)


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, list[int]]]:
    """A scheduler and two workers, started as a user would: its address, and the workers' processes."""
    with started(tmp_path_factory.mktemp("dask"), workers=2) as (address, pids):
        yield address, pids[1:]


@contextmanager
def started(folder: Path, *, workers: int) -> Iterator[tuple[str, list[int]]]:
    """The address of a scheduler, and the processes: its own, then the workers'."""
    pytest.importorskip("distributed")
    told = folder / "scheduler.json"
    dask = [sys.executable, "-m", "dask"]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    begun = [
        subprocess.Popen(  # noqa: S603
            [*dask, "scheduler", "--port", "0", "--no-dashboard", "--scheduler-file", str(told)], **quiet
        )
    ]
    try:
        for _ in range(300):
            if told.is_file() and told.stat().st_size:
                break
            time.sleep(0.1)
        address = json.loads(told.read_text())["address"]
        worker = [*dask, "worker", address, "--nthreads", "1", "--no-nanny", "--no-dashboard"]
        begun += [subprocess.Popen(worker, **quiet) for _ in range(workers)]  # noqa: S603
        yield address, [process.pid for process in begun]
    finally:
        for process in reversed(begun):
            process.kill()
            process.wait()


@pytest.mark.slow
def test_a_dask_cluster_gives_the_same_numbers_though_a_worker_is_killed(
    batches: list[Batch], expected: pd.DataFrame, cluster: tuple[str, list[int]]
) -> None:
    address, workers = cluster
    killer = Killer(*workers)
    found = pd.concat(run_batches(batches, scheduler=address, progress=killer))
    assert killer.killed == 1
    pd.testing.assert_frame_equal(found, expected, check_exact=True)


@pytest.mark.slow
def test_what_is_done_impact_by_impact_is_the_same_on_a_cluster(
    cluster: tuple[str, list[int]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """After the test above, one worker is left."""
    monkeypatch.setattr(chunks, "BLOCK", 8)
    monkeypatch.setattr(fit, "BATCH", 16)
    count, samples = 20, 60
    time_s = np.arange(samples) * 1e-3
    x = 1e-3 * np.sin(np.linspace(20, 26, count)[:, None] * time_s) * np.exp(-5 * time_s)
    same = np.ones(count)
    record = displacement_record(x, np.full(count, samples), 0 * same, 1e-3 * same, np.zeros((count, 3)))
    design = arrange([np.ones((1, 2))], np.zeros(count, int), [])
    data = TraceData(record, design, np.zeros(2), np.arange(count), same)
    factor = 2.0

    def found() -> tuple[Any, fit.PointFit]:
        def one(part: TraceData, rows: np.ndarray) -> Any:
            return {"sum": factor * np.asarray(part.record.x).sum(1), "row": rows + part.log_mass}

        own = in_blocks(data, one)
        return own, fit.fit_points(x, np.full(count, samples), 1e-3 * same, same)

    here = found()
    with on_cluster(cluster[0]):
        there = found()
    for own, other in zip(jax.tree.leaves(here), jax.tree.leaves(there), strict=True):
        np.testing.assert_array_equal(own, other)
    np.testing.assert_array_equal(here[0]["row"], 2 * np.arange(count))


@pytest.mark.slow
def test_a_scheduler_that_does_not_answer_is_refused_soon_and_in_our_words() -> None:
    """In one process, which imports Dask: nobody at a port, no address, and a port that never says a word."""
    pytest.importorskip("distributed")
    ask = (
        "import sys, time; from bayestissue.inference.execution.workers import on_cluster as o, InputError\n"
        "for address in sys.argv[1:]:\n"
        "    begun = time.monotonic()\n"
        "    try: o(address).__enter__()\n"
        "    except InputError as error: print(str(error).count('dask worker'), end=' ')\n"
        "    print(time.monotonic() - begun)\n"
    )
    with socket.create_server(("127.0.0.1", 0)) as silent:
        addresses = ["tcp://127.0.0.1:1", "nonsense", f"tcp://127.0.0.1:{silent.getsockname()[1]}"]
        told = subprocess.run(  # noqa: S603
            [sys.executable, "-c", ask, *addresses], capture_output=True, text=True, timeout=120, check=True
        )
    for said in told.stdout.splitlines():
        steps, seconds = said.split()
        assert int(steps) == 1
        # Beside the import of Dask.
        assert float(seconds) < _PATIENCE_S + 10
    assert len(told.stdout.splitlines()) == len(addresses)
    assert told.stderr == ""


def test_without_dask_the_next_step_is_told(batches: list[Batch], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(InputError, match=r"bayestissue\[dask\]"):
        run_batches(batches, scheduler="tcp://127.0.0.1:1")


def test_a_scheduler_without_workers_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(execution, "_WORKERS_S", 1.0)
    with (
        started(tmp_path, workers=0) as (address, _),
        pytest.raises(InputError, match="a scheduler without workers"),
        on_cluster(address),
    ):
        pass


@pytest.mark.slow
@pytest.mark.parametrize(("victim", "said"), [(0, "answers no longer"), (1, "without workers")])
def test_a_scheduler_or_its_last_worker_that_is_killed_ends_the_wait(
    victim: int, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with started(tmp_path, workers=1) as (address, pids):
        found = computed(time.sleep, [0.01, 30.0, 30.0], scheduler=address)
        assert next(found) == (0, None)
        monkeypatch.setattr(execution, "_WORKERS_S", 3.0)
        os.kill(pids[victim], signal.SIGKILL)
        begin = time.monotonic()
        with pytest.raises(InputError, match=said):
            list(found)
        assert time.monotonic() - begin < 20
