"""How long `bayestissue watch` takes from a whole file to its verdict, at the tenth impact and at the 100th.

    .venv/bin/python benchmarks/bench_latency.py

Simulated drops are written into a folder, which a watch follows as the command does, looking every 0.4 s;
those about the number one after the other, each once the one before has its verdict. The seconds are those
from the end of writing to the line that is said. They include waiting for a look and for the
next, which shows that the file stands still; `work_s` is what the verdict takes by itself.
"""

from __future__ import annotations

import tempfile
import threading
import time
from pathlib import Path

import numpy as np
import pandas as pd
from evidence import recorded

from bayestissue.base import runtime

AT, ABOUT, POLL_S = (10, 100), 10, 0.4
PEOPLE, MASSES = 25, (0.5, 0.8, 1.1, 1.4)
CAMPAIGN = """
pattern = "{subject}_{mass_kg}kg_{n}.csv"
[signal]
quantity = "deceleration"
unit = "m/s^2"
[uncertainty]
velocity_sd_m_s = 0.01
[facts]
velocity_m_s = 1.5
"""


def drops() -> list[tuple[str, str]]:
    """Names and contents of enough files."""
    from bayestissue.studies.simulation.campaign import simulate
    from bayestissue.studies.simulation.simulation_file import (
        Condition,
        Recording,
        Simulation,
        StudyDesign,
        Tissue,
    )

    repeats = -(-(AT[-1] + ABOUT + 1) // (PEOPLE * len(MASSES)))
    spec = Simulation(
        name="latency",
        tissue=Tissue(
            K_N_per_m=3000.0,
            C_N_s_per_m=25.0,
            sd_subject_K=0.2,
            sd_subject_C=0.2,
            sd_impact_K=0.05,
            sd_impact_C=0.05,
        ),
        recording=Recording(noise_relative_to_peak=0.005, velocity_sd_m_s=0.01),
        design=StudyDesign(
            conditions=tuple(Condition(trial=f"t{m}", mass_kg=m, velocity_m_s=1.5) for m in MASSES),
            subjects=PEOPLE,
            repeats=repeats,
        ),
    )
    data = simulate(spec, 5).dataset("latency")
    impacts = data.impacts.assign(n=data.impacts.groupby(["subject", "mass_kg"]).cumcount() + 1)
    files = []
    for row, trace in zip(impacts.itertuples(), data.traces, strict=True):
        table = pd.DataFrame({"time_s": trace.time_s, "value": trace.value})
        files.append((f"{row.subject}_{row.mass_kg}kg_{row.n}.csv", table.to_csv(index=False)))
    return sorted(files)


class Lines:
    """How many lines were said."""

    def __init__(self) -> None:
        self.count, self._change = 0, threading.Condition()

    def add(self, _: str) -> None:
        """Another one."""
        with self._change:
            self.count += 1
            self._change.notify_all()

    def wait_for(self, count: int) -> None:
        """Until so many were said."""
        with self._change:
            self._change.wait_for(lambda: self.count >= count, 60)


def measured() -> pd.DataFrame:
    """Seconds of every drop, in its order."""
    from bayestissue.studies.bench.campaign_file import read_campaign
    from bayestissue.studies.bench.drops import Drops
    from bayestissue.studies.bench.order import Order
    from bayestissue.studies.bench.watching import Watch

    rows, said = [], Lines()
    with tempfile.TemporaryDirectory() as scratch:
        (Path(scratch) / "campaign.toml").write_text(CAMPAIGN)
        folder, campaign = Path(scratch) / "recorded", read_campaign(Path(scratch) / "campaign.toml")
        folder.mkdir()
        spent = [0.0]

        class Timed(Watch):
            def _take(self, name: str) -> None:
                begin = time.monotonic()
                super()._take(name)
                spent[0] = time.monotonic() - begin

        watch = Timed(folder, campaign, Drops(Path(scratch) / "set", campaign), Order(()), said.add)
        watch.warm_up()
        over = threading.Event()

        def follow() -> None:
            while not over.is_set():
                watch.look()
                time.sleep(POLL_S)

        follower = threading.Thread(target=follow)
        follower.start()
        try:
            for number, (name, text) in enumerate(drops()[: AT[-1] + ABOUT], start=1):
                at = next((at for at in AT if abs(number - at) <= ABOUT), None)
                if at is None:
                    (folder / name).write_text(text)
                    continue
                while said.count < number - 1:
                    time.sleep(POLL_S)
                # Writing falls anywhere between two looks.
                time.sleep(POLL_S * np.random.default_rng(number).uniform())
                (folder / name).write_text(text)
                begin = time.monotonic()
                said.wait_for(number)
                rows.append({"at": at, "impact": number, "s": time.monotonic() - begin})
                time.sleep(0.02)
                rows[-1]["work_s"] = spent[0]
        finally:
            over.set()
            follower.join()
    return pd.DataFrame(rows)


def main() -> None:
    """Measure what is about each number."""
    runtime.keep_compiled()
    runtime.configure()
    with recorded("bench_latency") as record:
        record.write(measured())


if __name__ == "__main__":
    main()
