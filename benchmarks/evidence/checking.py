"""Whether the program's numbers are those that were accepted: each set of results computed anew."""

from __future__ import annotations

import multiprocessing
import os
import time
from concurrent.futures import ProcessPoolExecutor
from tempfile import TemporaryDirectory

import pandas as pd

from evidence.references import SETS, TABLE, accepted, differing

WORKERS = 2


def check_numbers(names: list[str], *, accept: bool = False) -> int:
    """Compute the sets, two side by side, and say what differs; 1 where something does.

    With ``accept`` what differs is written as the program's numbers from now on, and the evidence that rests
    on it is to be measured again; where nothing differs, nothing is written.
    """
    from bayestissue.base import runtime

    begun, wrong = time.monotonic(), {}
    runtime.keep_compiled()
    context = multiprocessing.get_context("spawn")
    with (
        TemporaryDirectory() as folder,
        # Each worker keeps to a core of its own.
        ProcessPoolExecutor(WORKERS, context, runtime.settle, (os.getpid(), folder, runtime.CORES)) as pool,
    ):
        for name, now in zip(names, pool.map(computed, names), strict=True):
            words = differing(name, now)
            print(f"{name:16} {words or 'as accepted'}", flush=True)
            if words:
                wrong[name] = now
    print(f"{len(names) - len(wrong)} of {len(names)} are as accepted ({time.monotonic() - begun:.0f} s).")
    if wrong and accept:
        kept = accepted()[~accepted()["set"].isin(wrong)]
        parts = [kept, *(table.assign(set=name) for name, table in wrong.items())]
        table = pd.concat(parts)[["set", "quantity", "value", "scale", "mcse"]]
        table.to_csv(TABLE, index=False, float_format="%.10g")
        accepted.cache_clear()
        return 0
    return 1 if wrong else 0


def computed(name: str) -> pd.DataFrame:
    """The results of a set by the program as it is."""
    return SETS[name]()
