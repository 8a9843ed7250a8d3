"""The program as one types it, and how long it takes."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import time
from pathlib import Path

from evidence.registry import ROOT


def timed(
    *arguments: object, program: Path = ROOT, most_s: float | None = None, **variables: str | None
) -> dict[str, float]:
    """Seconds of a command by the clock, ``s``, and of the processor, ``cpu_s``.

    Args:
        arguments: of `bayestissue`.
        program: the checkout whose program is run, by this Python and its libraries.
        most_s: after which it is stopped.
        variables: of the environment, None for one that it is not to have.

    Raises:
        subprocess.TimeoutExpired: it was stopped.
    """
    own = os.environ | {"PYTHONPATH": str(program.resolve() / "src")} | variables
    environment = {name: value for name, value in own.items() if value is not None}
    command = [sys.executable, "-m", "bayestissue", *map(str, arguments)]
    before, begun = _processor_s(), time.perf_counter()
    subprocess.run(command, cwd=program, env=environment, timeout=most_s, check=False)  # noqa: S603 - our own
    seconds, worked = time.perf_counter() - begun, _processor_s() - before
    return {"s": round(seconds, 1), "cpu_s": round(worked, 1)}


def _processor_s() -> float:
    return sum(resource.getrusage(resource.RUSAGE_CHILDREN)[:2])
