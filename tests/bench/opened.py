"""A finished run and the dataset that it is of; and any view on a server of its own."""

from __future__ import annotations

import json
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from bayestissue.recordings.dataset import read_dataset
from bayestissue.recordings.dataset.write import write_dataset
from bayestissue.studies.bench.server import HOST, application, configured
from dataset_bench import deceleration
from make_fit_run import CONDITIONS, MASS, PEOPLE, make_fit_run

TOKEN = "a-token-of-this-test"  # noqa: S105 - of nothing
SETTINGS = {"name": "made up", "signal": {"quantity": "deceleration", "unit": "m/s^2"}}


def run_and_dataset(folder: Path) -> tuple[Path, Path]:
    """A run whose ``run.json`` says that it is of a dataset beside it, of the same impacts."""
    run, dataset = make_fit_run(folder / "run", two_sides=True), folder / "set"
    rows = [
        {
            "impact": f"t{c}-s{p}",
            "subject": f"s{p}",
            "trial": f"t{c}",
            "mass_kg": MASS[c],
            "velocity_m_s": 1.5,
        }
        for c in range(CONDITIONS)
        for p in range(PEOPLE)
    ]
    parts = {row["impact"]: deceleration(row["mass_kg"], 1.5) for row in rows}
    traces = pd.DataFrame(
        {
            "impact": np.repeat(list(parts), [len(time) for time, _ in parts.values()]),
            "time_s": np.concatenate([time for time, _ in parts.values()]),
            "value": np.concatenate([value for _, value in parts.values()]),
        }
    )
    write_dataset(
        dataset, settings=SETTINGS, impacts=pd.DataFrame(rows), traces=traces, trace_file="traces.csv"
    )
    about = json.loads((run / "run.json").read_text())
    about |= {"dataset_folder": "../set", "whole_hash": read_dataset(dataset).whole_hash}
    (run / "run.json").write_text(json.dumps(about))
    return run, dataset


@contextmanager
def served(view: Any) -> Iterator[int]:
    """The port of this machine at which a view is served."""
    with socket.socket() as listener:
        listener.bind((HOST, 0))
        listener.listen()
        port = listener.getsockname()[1]
        server = configured(application(view, port, TOKEN))
        thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]})
        thread.start()
        try:
            yield port
        finally:
            server.should_exit = True
            thread.join()


def address(port: int, path: str = "", token: str = TOKEN) -> str:
    return f"http://{HOST}:{port}/{path}{'&' if '?' in path else '?'}token={token}"
