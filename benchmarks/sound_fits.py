"""What a fit says of datasets that obey its model: nothing against it, in how many of forty.

    .venv/bin/python benchmarks/sound_fits.py

Twelve to twenty-four impacts by a spring and damper each, with white noise of 0.2 to 2 % of the peak and
contact at any phase of a sampling interval, at 2 and 5 kHz; in half of them mass, velocity, gain and zero err
as declared. Each goes through the summary path of the model file. And 4,000 impacts at 2 kHz by `estimate`:
how many have p below 0.01, where the model's own noise gives 1 %. A row a dataset.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from coverage import KEPT, Fits, model_of, residuals_of
from evidence import recorded

import bayestissue as bt
from bayestissue.base import runtime
from bayestissue.inference.checking.model_form import SMALL_P, judged, with_impacts
from bayestissue.inference.factors.noise_left import noise_p
from bayestissue.model.hierarchy.specification import Sampler
from bayestissue.studies.simulation import Simulation, simulate

DATASETS, IMPACTS, FIRST_SEED = 40, 4000, 50_000
# The unit of the impacts that are estimated, not fitted.
ALONE = -1
# The score is that of all residuals together, by medians over the draws.
SAMPLER = Sampler(draws=KEPT, effective=200)
RATES_HZ = (2000.0, 5000.0)
# Samples that all traces are filled up to, so that the fits of a design are compiled once.
LONGEST = dict(zip(RATES_HZ, (64, 192), strict=True))
CHAIN = {
    "relative_mass_sd": 0.005,
    "velocity_sd_m_s": 0.0075,
    "relative_gain_sd": 0.005,
    "offset_sd_m_s2": 0.2,
}


def campaign(seed: int, rate: float, *, errs: bool, people: int, repeats: int = 1) -> Simulation:
    """People hit with three masses, or with the middle one alone where there are thousands."""
    noise = float(np.exp(np.random.default_rng([seed, 9]).uniform(np.log(0.002), np.log(0.02))))
    masses = (0.5, 0.7, 1.0) if people < DATASETS else (0.7,)
    conditions = [{"trial": f"{mass} kg", "mass_kg": mass, "velocity_m_s": 1.5} for mass in masses]
    spread = {f"sd_{level}_{name}": 0.15 for level in ("subject", "impact") for name in "KC"}
    return Simulation.model_validate(
        {
            "name": "sound",
            "seed": seed,
            "design": {"subjects": people, "conditions": conditions, "repeats": repeats},
            "tissue": {"K_N_per_m": 3000.0, "C_N_s_per_m": 25.0, **spread},
            "recording": {
                "sampling_rate_hz": rate,
                "noise_relative_to_peak": noise,
                **(CHAIN if errs else {}),
            },
        }
    )


def fitted(number: int, fits: Fits, made: Simulation, *, errs: bool) -> dict[str, Any]:
    """The verdict of one dataset's fit, as `bayestissue fit` has it."""
    prepared = fits.prepared(simulate(made).dataset(made.name))
    draws, _ = fits.fit(prepared, number)
    form = judged(*residuals_of(prepared, draws, number))
    middle = np.median(draws.impacts["parameters"].astype(float), axis=(0, 1))
    p = noise_p(prepared.model, prepared.data, middle)
    form = with_impacts(form, prepared.impacts["impact"].astype(str).tolist(), p)
    return {
        "rate_hz": made.recording.sampling_rate_hz,
        "errors": errs,
        "impacts": form["impacts"]["tested"],
        "below": form["impacts"]["below"],
        "score": round(form["score"], 2),
        "nothing_against": form["words"].startswith("Nothing against the model"),
    }


def counted(rate: float, impacts: int) -> dict[str, Any]:
    """How many of so many impacts have a small p."""
    made = campaign(FIRST_SEED - 1, rate, errs=True, people=impacts)
    p = bt.estimate(simulate(made).dataset(made.name))["whiteness_p"].to_numpy()
    tested, below = int(np.isfinite(p).sum()), int((p < SMALL_P).sum())
    return {"rate_hz": rate, "errors": True, "impacts": tested, "below": below}


def main() -> None:
    runtime.configure()
    with recorded("sound_fits") as record:
        fits: dict[tuple[int, float], Fits] = {}
        model = model_of("impact").model_copy(update={"sampler": SAMPLER})
        for number in record.missing([ALONE, *range(DATASETS)]):
            if number == ALONE:
                record.add(number, [counted(RATES_HZ[0], IMPACTS)])
                continue
            people, errs = 2 + number // 2 % 3, number % 4 < 2
            rate = RATES_HZ[number % 2]
            simulation = campaign(FIRST_SEED + number, rate, errs=errs, people=people, repeats=2)
            if (of := (people, rate)) not in fits:
                first = simulate(simulation).dataset(simulation.name)
                fits[of] = Fits(model, first, LONGEST[rate])
            record.add(number, [fitted(number, fits[of], simulation, errs=errs)])


if __name__ == "__main__":
    main()
