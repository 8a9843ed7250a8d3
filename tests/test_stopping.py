from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import pytest

LOSES_EXCEPTIONS = """
import sys, time
from pathlib import Path
from bayestissue import results, stopping

stopping.PATIENCE_S = 0.2
stopping.on_request()
lost = int(sys.argv[2])
with results.whole_folder(Path(sys.argv[1])) as folder:
    (folder / "half.csv").write_text("half")
    for turn in range(lost + 1):
        try:
            if turn == 0:
                print("ready", flush=True)
            time.sleep(60)
        except KeyboardInterrupt:
            if turn == lost:
                raise
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize(("lost", "status"), [(0, -signal.SIGINT), (2, -signal.SIGINT), (1000, 130)])
def test_a_request_to_stop_is_not_lost_with_an_exception(
    tmp_path: Path, number: signal.Signals, lost: int, status: int
) -> None:
    """Python ends itself by SIGINT where nothing catches KeyboardInterrupt; 130 is the last resort."""
    program = subprocess.Popen(  # noqa: S603 - our own program
        [sys.executable, "-c", LOSES_EXCEPTIONS, str(tmp_path / "run"), str(lost)],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
    )
    try:
        assert program.stdout is not None
        assert program.stdout.readline() == b"ready\n"
        program.send_signal(number)
        assert program.wait(timeout=30) == status
    finally:
        program.kill()
        program.communicate()
    assert list(tmp_path.iterdir()) == []


ENDS_SLOWLY = """
import atexit, time
from bayestissue import stopping

stopping.on_request()

def close():
    print("closing", flush=True)
    for _ in range(100):
        time.sleep(0.01)

atexit.register(close)
"""


def test_a_request_after_everything_is_done_changes_nothing() -> None:
    program = subprocess.Popen(  # noqa: S603 - our own program
        [sys.executable, "-c", ENDS_SLOWLY], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    try:
        assert program.stdout is not None
        assert program.stdout.readline() == b"closing\n"
        program.send_signal(signal.SIGTERM)
        _, said = program.communicate(timeout=30)
        assert (program.returncode, said) == (0, b"")
    finally:
        program.kill()
        program.communicate()
