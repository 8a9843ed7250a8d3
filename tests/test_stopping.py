"""A request to stop ends the process at once, says so in a line, and leaves nothing half done."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from bayestissue.errors import more

MORE = f"{more(['interrupted'])}\n"
BEGINS = """
import gc, sys, time
from pathlib import Path
from bayestissue import stopping
from bayestissue.results import claim

stopping.on_request()
"""

LOSES_EXCEPTIONS = """
def busy():
    print("ready", flush=True)
    while True:
        try:
            time.sleep(60)
        except BaseException:
            pass
"""

IN_THE_GARBAGE_COLLECTOR = """
def busy():
    gc.callbacks.append(lambda *_: (print("ready", flush=True), time.sleep(60)))
    gc.collect()
"""

WHILE_IMPORTING = """
def busy():
    folder = Path(sys.argv[1]).parent / "modules"
    folder.mkdir()
    (folder / "slow.py").write_text("import time\\nprint('ready', flush=True)\\ntime.sleep(60)")
    sys.path.insert(0, str(folder))
    import slow
"""

KEEPS_THE_INTERPRETER = """
def busy():
    import ctypes
    print("ready", flush=True)
    # As a long compiled call does: the interpreter runs no handler before it is back.
    ctypes.CDLL(None).sleep(60)
"""

WRITES = """
with claim(Path(sys.argv[1]), command="fit") as place, place.folder() as folder:
    (folder / "half.csv").write_text("half")
    busy()
"""

KEEPS_PARTS = """
with claim(Path(sys.argv[1]), command="fit") as place, place.unfinished("job") as parts:
    (parts / "segment").write_text("1")
    busy()
"""


def stopped(program: str, *arguments: str, number: int = signal.SIGINT) -> tuple[int, str, float]:
    """Status, standard error and the seconds it took to end a program that had said that it was ready."""
    started = subprocess.Popen(  # noqa: S603 - our own program
        [sys.executable, "-c", program, *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    try:
        assert started.stdout is not None
        assert started.stdout.readline() == "ready\n"
        began = time.monotonic()
        started.send_signal(number)
        _, said = started.communicate(timeout=30)
        return started.returncode, said, time.monotonic() - began
    finally:
        started.kill()
        started.communicate()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize(
    "busy", [LOSES_EXCEPTIONS, IN_THE_GARBAGE_COLLECTOR, WHILE_IMPORTING, KEEPS_THE_INTERPRETER]
)
def test_a_request_to_stop_ends_the_process_whatever_it_is_doing(
    tmp_path: Path, busy: str, number: signal.Signals
) -> None:
    out = tmp_path / "deep" / "run"
    status, said, seconds = stopped(BEGINS + busy + WRITES, str(tmp_path / "run"), number=number)
    assert (status, said) == (130, f"interrupted\n{MORE}")
    assert seconds < 10
    assert not out.parent.exists()
    assert [path.name for path in tmp_path.iterdir() if path.name != "modules"] == []


def test_what_was_kept_is_said(tmp_path: Path) -> None:
    status, said, _ = stopped(BEGINS + LOSES_EXCEPTIONS + KEEPS_PARTS, str(tmp_path / "run"))
    assert (status, said) == (130, f"interrupted; run the same command again to go on from here\n{MORE}")
    assert [path.name for path in tmp_path.iterdir()] == [".run.unfinished"]


A_WHOLE_STEP = """
with stopping.whole_step():
    print("ready", flush=True)
    time.sleep(1)
    Path(sys.argv[1]).write_text("whole")
Path(sys.argv[1]).write_text("too late")
"""


def test_a_step_that_has_begun_is_finished(tmp_path: Path) -> None:
    status, said, _ = stopped(BEGINS + A_WHOLE_STEP, str(tmp_path / "file"))
    assert (status, said) == (130, f"interrupted\n{MORE}")
    assert (tmp_path / "file").read_text() == "whole"


WITH_WORKERS = """
from bayestissue import runtime
from bayestissue.results import scratch
if __name__ == "__main__":
    with scratch() as told, runtime.worker_pool(1, told) as pool:
        future = pool.submit(time.sleep, 60)
        while not pool._processes or not future.running():
            time.sleep(0.1)
        print(*pool._processes, file=sys.stderr)
        print("ready", flush=True)
        time.sleep(60)
"""


def test_worker_processes_end_with_the_process_that_began_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    status, said, _ = stopped(BEGINS + WITH_WORKERS)
    assert status == 130
    worker, *words = said.split("\n", 1)
    assert words == [f"interrupted\n{MORE}"]
    assert not alive(int(worker))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_worker_processes_end_where_the_process_that_began_them_was_killed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    status, said, _ = stopped(BEGINS + WITH_WORKERS, number=signal.SIGKILL)
    assert status == -signal.SIGKILL
    assert not alive(int(said))


def alive(pid: int) -> bool:
    for _ in range(50):
        try:
            os.kill(pid, 0)
        except ProcessLookupError:
            return False
        time.sleep(0.1)
    return True


ENDS_SLOWLY = """
import atexit, time
from bayestissue import stopping

stopping.on_request()

def close():
    print("ready", flush=True)
    for _ in range(100):
        time.sleep(0.01)

atexit.register(close)
stopping.done()
"""


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_request_after_everything_is_done_changes_nothing(number: signal.Signals) -> None:
    assert stopped(ENDS_SLOWLY, number=number)[:2] == (0, "")


@pytest.mark.parametrize("after_s", [0.15, 0.5, 1.2])
def test_a_command_can_be_stopped_while_it_imports(tmp_path: Path, after_s: float) -> None:
    """At three moments of a fit's first seconds; to the whole process group, as a terminal does."""
    command = [sys.executable, "-m", "bayestissue", "fit", "data/example", "--out", str(tmp_path / "run")]
    root = Path(__file__).resolve().parents[1]
    started = subprocess.Popen(  # noqa: S603 - our own program
        command, cwd=root, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    time.sleep(after_s)
    os.killpg(started.pid, signal.SIGINT)
    said = started.communicate(timeout=60)[1]
    assert (started.returncode, said) == (130, f"interrupted\n{MORE}")
    assert list(tmp_path.iterdir()) == []
