"""Which checks the self-test has, by default and thoroughly."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path

import pandas as pd

from bayestissue.base.result import Say
from bayestissue.studies.selftest.check_results import Compared, Part, run
from bayestissue.studies.selftest.fits import calibrated, recovered, resumed
from bayestissue.studies.selftest.formats import read_back
from bayestissue.studies.selftest.published_numbers import PUBLISHED, Published

# Of these models a campaign is recovered by default, of the further ones by --thorough.
_LIKELIHOODS, _FURTHER = ("impact", "arma"), ("a2", "maxwell", "hunt_crossley")
# Campaigns of thirty impacts each.
_CALIBRATION, _THOROUGH_CALIBRATION = 1, 20


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
