"""The self-test: its checks, by default and thoroughly, and what becomes of them: table, verdict, text."""

from __future__ import annotations

import os
import platform
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
import pandas as pd

from bayestissue.base import runtime
from bayestissue.base.outline import markdown_rows
from bayestissue.base.result import Say
from bayestissue.base.results.tables import table_of_rows
from bayestissue.reports.pages.page_tables import shown
from bayestissue.studies.selftest.fits import Compared, calibrated, recovered, resumed
from bayestissue.studies.selftest.published_numbers import PUBLISHED, Published

# Of these models a campaign is recovered by default, of the further ones by --thorough.
_LIKELIHOODS, _FURTHER = ("impact", "arma"), ("a2", "maxwell", "hunt_crossley")
# Campaigns of thirty impacts each.
_CALIBRATION, _THOROUGH_CALIBRATION = 1, 20
SAMPLES = Path(__file__).parent / "samples"
_RATE = 2000.0
# C3D files hold single precision; text has twelve digits.
_SINGLE, _TEXT = 1e-6, 1e-10


@dataclass(frozen=True)
class Part:
    """A part of the self-test.

    Attributes:
        name: what it is about.
        comparisons: of a folder, which is its own and empty, what it finds.
        thorough: whether it is one of ``--thorough`` alone.
    """

    name: str
    comparisons: Callable[[Path], Iterable[Compared]]
    thorough: bool = False


def self_test(folder: Path, *, thorough: bool, say: Say) -> pd.DataFrame:
    """Run the self-test in a folder of the user's; the table ``selftest.csv``.

    Args:
        folder: an empty one, in which everything is done that is done with files.
        thorough: the checks that take ten minutes, too.
        say: told the check, how many are done, and of how many.
    """
    return run([check for check in checks(folder) if thorough or not check.thorough], folder, say)


def checks(folder: Path) -> Iterator[Part]:
    """All checks. One that goes on from another finds what that has left in ``folder``."""
    for name, published in PUBLISHED.items():
        yield Part(f"published: {name}", partial(_published, published), published.takes_long)
    yield Part("formats of recorders", read_back)
    yield Part("calibration of single impacts", partial(calibrated, campaigns=_CALIBRATION))
    for likelihood in _LIKELIHOODS:
        yield Part(f"recovery by {likelihood}", partial(_recovered, folder / likelihood, likelihood))
    yield Part("a killed fit goes on", partial(resumed, whole=folder / "impact"))
    for model in _FURTHER:
        yield Part(f"recovery by {model}", partial(_recovered, folder / model, model), thorough=True)
    calibration = partial(calibrated, campaigns=_THOROUGH_CALIBRATION)
    yield Part("calibration of six hundred impacts", calibration, thorough=True)


def _published(published: Published, folder: Path) -> list[Compared]:
    """Each number, its own, and how far apart they may be."""
    computed = published.computed()
    off = published.differences(computed)
    return [
        Compared(
            f"{published.title}: {name}",
            f"{value:.14g}, within {published.tolerance_of(name):.1g} ({published.source})",
            f"{computed[name]:.14g}",
            name not in off,
        )
        for name, value in published.numbers.items()
    ]


def _recovered(work: Path, model: str, folder: Path) -> list[Compared]:
    """`recovered`, in a folder that other checks know."""
    work.mkdir()
    return recovered(work, model)


def read_back(folder: Path) -> list[Compared]:
    """Read the sample of each format, all of them as one dataset, and compare it with what it holds."""
    from bayestissue.recordings.dataset import read_dataset, write_dataset
    from bayestissue.recordings.dataset.recorders import SUFFIXES

    time = np.arange(200) / _RATE
    value = np.where(time > 0.01, 100 * np.sin(90 * (time - 0.01)) * np.exp(-20 * (time - 0.01)), 0.0)
    endings = [end for end in SUFFIXES if end != ".acq" or find_spec("bioread")]
    names = [f"recording{end}" for end in endings]
    for name in names:
        shutil.copy(SAMPLES / name, folder)
    rows = {"impact": endings, "subject": "s", "trial": "t", "mass_kg": 0.7, "velocity_m_s": 1.5}
    write_dataset(
        folder,
        settings={"name": "formats", "signal": {"quantity": "deceleration", "unit": "m/s^2"}},
        impacts=pd.DataFrame(rows).assign(trace=names),
    )
    data = read_dataset(folder)
    comparisons = []
    for end, trace in zip(endings, data.traces, strict=True):
        same = len(trace.value) == len(value)
        difference = np.abs(np.asarray(trace.value) - value).max() / value.max() if same else np.inf
        clock = np.abs(np.diff(np.asarray(trace.time_s)) - 1 / _RATE).max() * _RATE if same else np.inf
        allowed = _SINGLE if end == ".c3d" else _TEXT
        off = max(difference, clock)
        expected = f"{len(value)} samples, {allowed:g} off at most"
        observed = f"{len(trace.value)} samples, {off:.0e} off"
        comparisons.append(Compared(end, expected, observed, bool(off <= allowed)))
    left_out = [end for end in SUFFIXES if end not in endings]
    return comparisons + [Compared(end, "its library is optional", "not installed", True) for end in left_out]


def run(checks: Iterable[Part], folder: Path, say: Say) -> pd.DataFrame:
    """All checks, one after another, each in a folder of its own: the table ``selftest.csv``.

    What a check raises is what it found.
    """
    rows: list[tuple[Any, ...]] = []
    chosen = list(checks)
    for number, check in enumerate(chosen):
        say(check.name, number, len(chosen))
        files, began = folder / f"check-{number}", perf_counter()
        files.mkdir(parents=True)
        try:
            comparisons = list(check.comparisons(files))
        except Exception as error:
            # Whatever it is, the other checks go on.
            comparisons = [Compared("it ran to its end", "yes", f"{type(error).__name__}: {error}", False)]
        seconds = round((perf_counter() - began) / len(comparisons), 2)
        rows += [(check.name, *compared[:3], int(compared.passed), seconds) for compared in comparisons]
    return table_of_rows("selftest", rows)


def verdict(table: pd.DataFrame) -> tuple[bool, str]:
    """Whether all is well, and so in one line."""
    failed, seconds = table[table["passed"] == 0], table["seconds"].sum()
    if failed.empty:
        return True, f"The self-test passed: {len(table)} checks in {seconds:.0f} s."
    names = ", ".join(dict.fromkeys(failed["check"]))
    return False, f"The self-test failed: {len(failed)} of {len(table)} checks ({names}). Trust no result."


def machine() -> dict[str, str]:
    """The machine that the program ran on."""
    memory = ""
    if hasattr(os, "sysconf") and "SC_PHYS_PAGES" in os.sysconf_names:
        memory = f"{os.sysconf('SC_PHYS_PAGES') * os.sysconf('SC_PAGE_SIZE') / 2**30:.1f} GiB"
    return {
        "system": platform.platform(),
        "processor": platform.processor() or platform.machine(),
        "cores": str(runtime.cores()),
        "memory": memory,
    }


def as_markdown(table: pd.DataFrame, record: Mapping[str, Any]) -> str:
    """The file to attach to a paper: verdict, date, versions, machine, and every check."""
    _, words = verdict(table)
    facts = {"date": record["started"], **record["versions"], **record["machine"]}
    return "\n".join(
        [
            "# Self-test of bayestissue",
            "",
            words,
            "",
            *markdown_rows(("", ""), facts.items()),
            "",
            *shown("selftest", table).markdown(),
            "",
        ]
    )
