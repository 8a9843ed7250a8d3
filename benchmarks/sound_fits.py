"""What a fit says of datasets that obey its model: nothing against it, in how many of forty.

    .venv/bin/python benchmarks/sound_fits.py

Twelve to twenty-four impacts by a spring and damper each, with white noise of 0.2 to 2 % of the peak and
contact at any phase of a sampling interval, at 2 and 5 kHz; in half of them mass, velocity, gain and zero err
as declared. Each goes through the summary path of the model file. And 4,000 impacts at 2 kHz by `estimate`:
how many have p below 0.01, where the model's own noise gives 1 %. A row a dataset.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from evidence import measure
from evidence.simulations import simulation, tables
from studies import FEW_DRAWS, Fits, model_of, residuals_of

import bayestissue as bt
from bayestissue.inference.checking.model_form import SMALL_P, judged, with_impacts
from bayestissue.inference.factors.noise_left import noise_p
from bayestissue.studies.simulation import simulate

DATASETS, IMPACTS, FIRST_SEED = 40, 4000, 50_000
# The unit of the impacts that are estimated, not fitted.
ALONE = -1
RATES_HZ = (2000.0, 5000.0)
# Samples that all traces are filled up to, so that the fits of a design are compiled once.
LONGEST = dict(zip(RATES_HZ, (64, 192), strict=True))
TABLES = tables(__file__)


def campaign(number: int, masses: tuple[float, ...], rate: float, *, errs: bool, **design: int) -> bt.Dataset:
    """People hit with each of the masses."""
    seed = FIRST_SEED + number
    noise = float(np.exp(np.random.default_rng([seed, 9]).uniform(np.log(0.002), np.log(0.02))))
    own = {
        "design": {"conditions": [(f"{mass} kg", mass, 1.5) for mass in masses], **design},
        "recording": {"sampling_rate_hz": rate, "noise_relative_to_peak": noise},
    }
    errors = {"recording": TABLES["errors"] if errs else {}}
    return simulate(simulation(TABLES["campaign"], own, errors, seed=seed)).dataset("sound")


def fit_of(number: int) -> dict[str, Any]:
    """The verdict of one dataset's fit, as `bayestissue fit` has it."""
    people, rate, errs = 2 + number // 2 % 3, RATES_HZ[number % 2], number % 4 < 2
    data = campaign(number, (0.5, 0.7, 1.0), rate, errs=errs, subjects=people, repeats=2)
    fits = fits_of(people, rate)
    prepared = fits.prepared(data)
    # The score is that of all residuals together, by medians over the draws.
    draws, _ = fits.fit(prepared, number)
    form = judged(*residuals_of(prepared, draws, number))
    middle = np.median(draws.impacts["parameters"].astype(float), axis=(0, 1))
    p = noise_p(prepared.model, prepared.data, middle)
    form = with_impacts(form, prepared.impacts["impact"].astype(str).tolist(), p)
    return {
        "rate_hz": rate,
        "errors": errs,
        "impacts": form["impacts"]["tested"],
        "below": form["impacts"]["below"],
        "score": round(form["score"], 2),
        "nothing_against": form["words"].startswith("Nothing against the model"),
    }


@cache
def fits_of(people: int, rate: float) -> Fits:
    """The fits of one design's datasets."""
    first = campaign(0, (0.5, 0.7, 1.0), rate, errs=True, subjects=people, repeats=2)
    return Fits(model_of("impact").model_copy(update={"sampler": FEW_DRAWS}), first, LONGEST[rate])


def estimated(rate: float = RATES_HZ[0]) -> dict[str, Any]:
    """How many of thousands of impacts have a small p."""
    p = bt.estimate(campaign(-1, (0.7,), rate, errs=True, subjects=IMPACTS))["whiteness_p"].to_numpy()
    tested, below = int(np.isfinite(p).sum()), int((p < SMALL_P).sum())
    return {"rate_hz": rate, "errors": True, "impacts": tested, "below": below}


def main() -> None:
    units = [ALONE, *range(DATASETS)]
    measure("sound_fits", units, lambda number: estimated() if number == ALONE else fit_of(number))


if __name__ == "__main__":
    main()
