"""Which checks the self-test has, by default and thoroughly, and the one of formats: files in ``samples``."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from functools import partial
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pandas as pd

from bayestissue.base.result import Say
from bayestissue.studies.selftest.check_results import Compared, Part, run
from bayestissue.studies.selftest.fits import calibrated, recovered, resumed
from bayestissue.studies.selftest.published_numbers import PUBLISHED, Published

# Of these models a campaign is recovered by default, of the further ones by --thorough.
_LIKELIHOODS, _FURTHER = ("impact", "arma"), ("a2", "maxwell", "hunt_crossley")
# Campaigns of thirty impacts each.
_CALIBRATION, _THOROUGH_CALIBRATION = 1, 20
SAMPLES = Path(__file__).parent / "samples"
_RATE = 2000.0
# C3D files hold single precision; text has twelve digits.
_SINGLE, _TEXT = 1e-6, 1e-10


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
