"""How long `bayestissue watch` takes from a whole file to its verdict, at the tenth impact and at the 100th.

    .venv/bin/python benchmarks/bench_latency.py

Simulated drops are written into a folder, which a watch follows as the command does, looking every 0.4 s;
those about the number one after the other, each once the one before has its verdict. The seconds are those
from the end of writing to the line that is said. They include waiting for a look and for the
next, which shows that the file stands still; `work_s` is what the verdict takes by itself.
"""

from __future__ import annotations

import queue
import tempfile
import threading
import time
from pathlib import Path

import numpy as np
import pandas as pd
from evidence import recorded
from evidence.simulations import simulation, tables

from bayestissue.base import runtime

AT, ABOUT, POLL_S = (10, 100), 10, 0.4
# Longer no verdict takes.
MOST_S = 60.0
TABLES = tables(__file__)


def drops() -> list[tuple[str, str]]:
    """Names and contents of enough files."""
    from bayestissue.studies.simulation.campaign import simulate

    data = simulate(simulation(TABLES["drops"]), 5).dataset("latency")
    impacts = data.impacts.assign(n=data.impacts.groupby(["subject", "mass_kg"]).cumcount() + 1)
    files = []
    for row, trace in zip(impacts.itertuples(), data.traces, strict=True):
        table = pd.DataFrame({"time_s": trace.time_s, "value": trace.value})
        files.append((f"{row.subject}_{row.mass_kg}kg_{row.n}.csv", table.to_csv(index=False)))
    return sorted(files)


def measured() -> pd.DataFrame:
    """Seconds of every drop, in its order."""
    from bayestissue.studies.bench.campaign_file import read_campaign
    from bayestissue.studies.bench.drops import Drops
    from bayestissue.studies.bench.following import Stamp
    from bayestissue.studies.bench.order import Order
    from bayestissue.studies.bench.watching import Watch

    rows, said, heard = [], queue.SimpleQueue[str](), 0
    with tempfile.TemporaryDirectory() as scratch:
        (Path(scratch) / "campaign.toml").write_text(TABLES["campaign"])
        folder, campaign = Path(scratch) / "recorded", read_campaign(Path(scratch) / "campaign.toml")
        folder.mkdir()
        spent = [0.0]

        class Timed(Watch):
            def _take(self, name: str, stamp: Stamp) -> None:
                begin = time.monotonic()
                super()._take(name, stamp)
                spent[0] = time.monotonic() - begin

        watch = Timed(folder, campaign, Drops(Path(scratch) / "set", campaign), Order(()), said.put)
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
                while heard < number - 1:
                    said.get(timeout=MOST_S)
                    heard += 1
                # Writing falls anywhere between two looks.
                time.sleep(POLL_S * np.random.default_rng(number).uniform())
                (folder / name).write_text(text)
                begin = time.monotonic()
                said.get(timeout=MOST_S)
                heard += 1
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
