"""A chain whose impacts are shared out over devices and processes: the numbers of one device.

As a program it draws a few transitions and prints a hash of where chains ended and of all draws:
`test_devices.py ADDRESS PROCESSES NUMBER`, an address of "" starting no further process.
"""

from __future__ import annotations

import os
import re
import socket
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
PAGE = ROOT / "docs" / "how-to" / "several-devices.md"


def main(address: str, processes: str, number: str) -> None:
    """Draw from the posterior of 1,800 impacts, filled up to 2,048: two blocks for each of eight devices."""
    import jax

    if address:
        jax.distributed.initialize(address, int(processes), int(number))
    jax.config.update("jax_enable_x64", True)
    import hashlib

    import numpy as np

    from bayestissue.inference.chain.chain_settings import ChainSettings
    from bayestissue.inference.chain.draws import ChainJob, chain_draws
    from bayestissue.inference.factors.expansions import first_guess
    from bayestissue.model.hierarchy.gaussian.factor import GaussianFactor
    from bayestissue.model.hierarchy.specification import Sampler, read_specification
    from bayestissue.model.hierarchy.trace_data import prepare
    from campaigns import simulated

    recording = {"sampling_rate_hz": 2000.0, "noise_relative_to_peak": 0.005}
    design = {"people": 36, "masses": (0.5, 0.6, 0.7, 0.8, 1.0), "design": {"repeats": 10}}
    campaign = simulated({"sd_subject_K": 0.2}, recording, **design, seed=1).dataset("many")
    model = ROOT / "models" / "impact.toml"
    prepared = prepare(campaign, read_specification(model), source=str(model))
    # Sites may be any: the chain is exact.
    centre = first_guess(prepared)[None]
    precision = np.broadcast_to(np.eye(centre.shape[2]) * 400.0, (*centre.shape, centre.shape[2]))
    sites = GaussianFactor(centre, np.zeros(centre.shape), precision, np.zeros(centre.shape[:2]))
    short = {"first_rounds": (1,), "round": 1, "most_rounds": 1, "last_round": 1, "first_look": 10}
    job = ChainJob(prepared, Sampler(chains=2, transitions=100), 1)
    drawn = next(chain_draws(job, sites, ChainSettings(segment=10, **short)))
    kept = drawn.end, drawn.population, drawn.log_likelihood, drawn.log_ratios, drawn.u
    digest = hashlib.sha256(b"".join(np.asarray(leaf).tobytes() for leaf in jax.tree.leaves(kept)))
    sys.stdout.write(f"{jax.device_count()} {digest.hexdigest()}\n")


def started(devices: int = 1, processes: int = 1) -> list[list[str]]:
    """What each process prints in its last line: the number of devices, and the hash."""
    with socket.socket() as free:
        free.bind(("localhost", 0))
        address = f"localhost:{free.getsockname()[1]}" if processes > 1 else ""
    flags = {"XLA_FLAGS": f"--xla_force_host_platform_device_count={devices}", "JAX_PLATFORMS": "cpu"}
    environment = (
        os.environ | flags | {"PYTHONPATH": os.pathsep.join(map(str, (ROOT / "src", ROOT / "tests")))}
    )
    begun = [
        subprocess.Popen(  # noqa: S603 - this file
            [sys.executable, __file__, address, str(processes), str(number)],
            env=environment,
            stdout=subprocess.PIPE,
            text=True,
        )
        for number in range(processes)
    ]
    printed = [process.communicate()[0] for process in begun]
    assert not any(process.returncode for process in begun)
    return [out.splitlines()[-1].split() for out in printed]


@pytest.mark.long
def test_numbers_do_not_depend_on_devices_or_processes():
    ((one, digest),) = started()
    assert one == "1"
    for devices in (2, 8):
        assert started(devices) == [[str(devices), digest]]
    assert started(processes=2) == [["2", digest]] * 2


def test_the_manual_starts_processes_as_this_test_does():
    """By the same call, with as many arguments as it has."""
    page = PAGE.read_text(encoding="utf-8")
    call = "jax.distributed.initialize(address, int(processes), int(number))"
    assert call in page
    assert call in Path(__file__).read_text(encoding="utf-8")
    assert len(re.findall(r"^\$ python shared\.py localhost:\d+ 2 [01]$", page, re.MULTILINE)) == 2


if __name__ == "__main__":
    main(*sys.argv[1:])
