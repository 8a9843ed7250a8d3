"""How often intervals of driven tissue hold the truth: simulated heel strikes under a leg, fitted.

    .venv/bin/python benchmarks/driven_coverage.py
    .venv/bin/python benchmarks/driven_coverage.py 18

Studies of four people, two conditions and three impacts each: K, C, the mass above the tissue and
the leg's push are drawn, and neither mass nor push is told to the fit. Marker noise is 0.05 mm at 1.3 kHz, as
of recorded heel strikes. Of three studies one has a force plate of 1 N noise, one of 5 N, and one a marker of
0.2 mm noise. Three studies are of a spring and damper, the next three of tissue that stiffens with depth, and
are fitted with the element `stiffening`. Noted of each are the 90 % intervals of K, C, peak force, peak depth
and energy absorbed of each impact, and of the ratios of K and C between the conditions.

A number is of the studies to do in all; those that were done are not done again.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
from studies import Fitted, Interval, counted, ends, fitted, sides

from bayestissue.simulation.driven import Driven, driven, outcomes_within

RESPONSES = {"K": "K_N_per_m", "C": "C_N_s_per_m"}
OUTCOMES = {
    name: f"{name}_{unit}"
    for name, unit in (("peak_force", "N"), ("peak_depth", "m"), ("energy_absorbed", "J"))
}
ELEMENTS = ("kelvin_voigt", "stiffening")
NOISES = ({}, {"noise_N": 5.0}, {"noise_m": 2e-4})
KINDS = ("a force plate of 1 N", "a force plate of 5 N", "a marker of 0.2 mm")
# Six kinds: a share of 90 % of the intervals of one is known to 4 %.
STUDIES = 120


def study(number: int) -> Driven:
    """One study; its random numbers follow from its number."""
    K, C = np.exp(np.random.default_rng([number, 5]).uniform(np.log([20e3, 150.0]), np.log([80e3, 600.0])))
    made = Driven(seed=number, K=float(K), C=float(C), **NOISES[number % len(NOISES)])
    return replace(made, stiffening_depth_m=4e-3) if element(number) == "stiffening" else made


def element(number: int) -> str:
    """What the study is of, and fitted with."""
    return ELEMENTS[number // len(NOISES) % len(ELEMENTS)]


def intervals(fit: Fitted, truth: pd.DataFrame, made: Driven) -> Iterator[Interval]:
    """Of each quantity the ends and the truth."""
    posterior, of = fit.posterior, f"{element(made.seed)}, {KINDS[made.seed % len(KINDS)]}"
    impacts = truth["impact"].tolist()
    record = fit.prepared.signal
    last = record.first_sample_s + (record.n_samples - 1) * record.dt
    order = pd.Index(fit.prepared.impacts["impact"]).get_indexer(impacts)
    truth = truth.join(outcomes_within(made, last[order]))
    for name, column in (RESPONSES | OUTCOMES).items():
        yield Interval(of, name, ends(posterior[name].sel(impact=impacts)), truth[column].to_numpy())
    for name in RESPONSES:
        of_trials = posterior[f"{name}_trial"]
        ratio = np.log(of_trials.isel(trial=1) / of_trials.isel(trial=0))
        difference = made.of_trials[1]["KC".index(name)] - made.of_trials[0]["KC".index(name)]
        yield Interval(of, f"{name}, second condition over first", ends(ratio), difference)


def row_of(number: int) -> dict[str, Any]:
    """What is kept of a study."""
    dataset, truth = driven(made := study(number))
    fit = fitted(dataset, number, {"like": "driven", "element": element(number)})
    return sides(intervals(fit, truth, made)) | {"passed": fit.passed}


def main() -> None:
    counted("coverage_channels-driven", row_of, STUDIES)


if __name__ == "__main__":
    main()
