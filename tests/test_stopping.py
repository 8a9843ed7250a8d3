"""A request to stop ends a command in good order, says so in a line, and leaves nothing half done."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from bayestissue.base.errors import more
from bayestissue.base.results.output_folder import claim

MORE = f"{more(['interrupted'])}\n"
BEGINS = """
import gc, sys, time
from pathlib import Path
from bayestissue import __main__, cli
from bayestissue.base.result import after_results
from bayestissue.base.results.output_folder import claim
from bayestissue.base.runtime import quieten_libraries, worker_pool

def main(command):
    if __name__ == "__main__":
        cli.main = command
        __main__.main()
"""

SLEEPS = """
def busy():
    print("ready", flush=True)
    time.sleep(60)
"""

# As a callback of a compiled function does, or a library that makes another error of everything.
CHANGES_EXCEPTIONS = """
def busy():
    try:
        print("ready", flush=True)
        time.sleep(60)
    except BaseException:
        raise RuntimeError("something else")
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
    def once(*_):
        gc.callbacks.remove(once)
        print("ready", flush=True)
        time.sleep(60)
    gc.callbacks.append(once)
    gc.collect()
    for _ in range(600):
        time.sleep(0.1)
"""

# A library that loses what is raised as it is imported; some of them end the process with a core dump.
WHILE_IMPORTING = """
LIBRARY = '''
import time
try:
    print("ready", flush=True)
    time.sleep(1)
except BaseException:
    pass
'''

def busy():
    folder = Path(sys.argv[1]).parents[1] / "modules"
    folder.mkdir()
    (folder / "slow.py").write_text(LIBRARY)
    sys.path.insert(0, str(folder))
    import slow
    time.sleep(60)
"""

KEEPS_THE_INTERPRETER = """
def busy():
    import ctypes
    print("ready", flush=True)
    # As a long compiled call does: the interpreter runs no handler before it is back.
    ctypes.CDLL(None).sleep(60)
"""

WRITES = """
def writes():
    with claim(Path(sys.argv[1]), command="fit") as place, place.folder() as folder:
        (folder / "half.csv").write_text("half")
        busy()
main(writes)
"""

KEEPS_PARTS = """
def keeps_parts():
    with claim(Path(sys.argv[1]), command="fit") as place, place.unfinished("job") as parts:
        (parts / "segment").write_text("1")
        busy()
main(keeps_parts)
"""

ADDS_A_PAGE = """
def adds_a_page():
    with after_results("run", "again"):
        busy()
main(adds_a_page)
"""


def stopped(
    program: str,
    *arguments: str,
    number: int = signal.SIGINT,
    again_after_s: float | None = None,
    again: int = signal.SIGINT,
) -> tuple[int, str, float]:
    """Status, standard error and the seconds it took to end a program that had said that it was ready."""
    started = subprocess.Popen(  # noqa: S603 - our own program
        [sys.executable, "-c", program, *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    try:
        assert started.stdout is not None
        assert started.stdout.readline() == "ready\n"
        began = time.monotonic()
        started.send_signal(number)
        if again_after_s is not None:
            time.sleep(again_after_s)
            started.send_signal(again)
        _, said = started.communicate(timeout=30)
        return started.returncode, said, time.monotonic() - began
    finally:
        started.kill()
        started.communicate()


@pytest.mark.parametrize(
    ("busy", "number"),
    [
        (SLEEPS, signal.SIGTERM),
        (CHANGES_EXCEPTIONS, signal.SIGINT),
        (WHILE_IMPORTING, signal.SIGINT),
        (IN_THE_GARBAGE_COLLECTOR, signal.SIGINT),
    ],
)
def test_a_request_to_stop_ends_a_command_in_good_order(
    tmp_path: Path, busy: str, number: signal.Signals
) -> None:
    out = tmp_path / "deep" / "run"
    status, said, seconds = stopped(BEGINS + busy + WRITES, str(out), number=number)
    assert (status, said) == (130, f"interrupted\n{MORE}")
    assert seconds < 10
    assert not out.parent.exists()
    assert [path.name for path in tmp_path.iterdir() if path.name != "modules"] == []


@pytest.mark.parametrize("busy", [LOSES_EXCEPTIONS, KEEPS_THE_INTERPRETER])
def test_a_second_request_ends_a_command_whatever_it_is_doing(tmp_path: Path, busy: str) -> None:
    """Nothing has its name, and what is left is cleared away by the next command."""
    out = tmp_path / "run"
    status, _, seconds = stopped(BEGINS + busy + WRITES, str(out), again_after_s=1.2)
    assert status == 130
    assert seconds < 10
    assert not out.exists()
    with claim(out, command="fit"):
        pass
    assert list(tmp_path.iterdir()) == []


BEGINS_TO_WAIT = """
import os, sys, time
from bayestissue.base import stopping

stopping.on_request()
try:
    print("ready", flush=True)
    time.sleep(60)
except KeyboardInterrupt:
    os._exit(130)
"""


@pytest.mark.slow
def test_a_request_is_not_lost_where_a_wait_begins_just_then() -> None:
    """By a signal with another behind it; of such programs one in five went on to the end of its wait."""
    for _ in range(15):
        assert stopped(BEGINS_TO_WAIT, again_after_s=0.0, again=signal.SIGTERM)[0] == 130


def test_two_signals_at_once_are_one_request(tmp_path: Path) -> None:
    status, said, _ = stopped(BEGINS + SLEEPS + WRITES, str(tmp_path / "run"), again_after_s=0.0)
    assert (status, said) == (130, f"interrupted\n{MORE}")
    assert list(tmp_path.iterdir()) == []


def test_what_was_kept_is_said(tmp_path: Path) -> None:
    status, said, _ = stopped(BEGINS + SLEEPS + KEEPS_PARTS, str(tmp_path / "run"))
    assert (status, said) == (130, f"interrupted; run the same command again to go on from here\n{MORE}")
    assert [path.name for path in tmp_path.iterdir()] == [".run.unfinished"]


def test_results_that_stand_are_said() -> None:
    status, said, _ = stopped(BEGINS + SLEEPS + ADDS_A_PAGE)
    assert (status, said) == (130, f"interrupted; the results are in run; again\n{MORE}")


WITH_WORKERS = """
def computes():
    quieten_libraries()
    with worker_pool(1) as pool:
        future = pool.submit(time.sleep, 60)
        while not pool._processes or not future.running():
            time.sleep(0.1)
        print(*pool._processes, file=sys.stderr)
        print("ready", flush=True)
        time.sleep(60)
main(computes)
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
def test_worker_processes_end_where_the_process_that_began_them_was_killed() -> None:
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
from bayestissue.base import stopping

stopping.on_request()

def close():
    print("ready", flush=True)
    for _ in range(100):
        time.sleep(0.01)

atexit.register(close)
stopping.done()
"""


@pytest.mark.slow
def test_a_request_after_everything_is_done_changes_nothing() -> None:
    assert stopped(ENDS_SLOWLY)[:2] == (0, "")


@pytest.mark.parametrize("after_s", [0.6, 1.2])
def test_a_command_can_be_stopped_while_it_imports(tmp_path: Path, after_s: float) -> None:
    """At two moments of a fit's first seconds; to the whole process group, as a terminal does."""
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
