"""How often intervals of driven tissue hold the truth: simulated heel strikes under a leg, fitted.

    .venv/bin/python benchmarks/driven_coverage.py 100

So many studies of four people, two conditions and three impacts each: K, C, the mass above the tissue and
the leg's push are drawn, and neither mass nor push is told to the fit. Marker noise is 0.05 mm at 1.3 kHz, as
of recorded heel strikes. Of three studies one has a force plate of 1 N noise, one of 5 N, and one a marker of
0.2 mm noise. Three studies are of a spring and damper, the next three of tissue that stiffens with depth, and
are fitted with the element `stiffening`. Noted of each are the 90 % intervals of K, C, peak force, peak depth
and energy absorbed of each impact and of the ratios of K and C between the conditions, and whether the page
calls the residuals structured.

Rows are added to results/driven_coverage.csv, study by study: a script that is stopped goes on where it was.
The shares that held are printed, with standard errors over studies.
"""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
import pandas as pd
from studies import shares_held, studied

import bayestissue as bt
from bayestissue.simulation.driven import Driven, driven, outcomes_within

RESPONSES = {"K": "K_N_per_m", "C": "C_N_s_per_m"}
OUTCOMES = {
    name: f"{name}_{unit}"
    for name, unit in (("peak_force", "N"), ("peak_depth", "m"), ("energy_absorbed", "J"))
}
ELEMENTS = ("kelvin_voigt", "stiffening")
NOISES = ({}, {"noise_N": 5.0}, {"noise_m": 2e-4})
LEVEL = 0.9


def study(number: int) -> Driven:
    """One study; its random numbers follow from its number."""
    K, C = np.exp(np.random.default_rng([number, 5]).uniform(np.log([20e3, 150.0]), np.log([80e3, 600.0])))
    made = Driven(seed=number, K=float(K), C=float(C), **NOISES[number % len(NOISES)])
    return replace(made, stiffening_depth_m=4e-3) if element(number) == "stiffening" else made


def element(number: int) -> str:
    """What the study is of, and fitted with."""
    return ELEMENTS[number // len(NOISES) % len(ELEMENTS)]


def intervals(number: int) -> pd.DataFrame:
    """A row an interval: of what, its ends, the truth."""
    dataset, truth = driven(made := study(number))
    fit = bt.fit(dataset, {"like": "driven", "element": element(number)}, seed=number)
    posterior, parts = fit.posterior["posterior"].dataset, []
    levels = [(1 - LEVEL) / 2, (1 + LEVEL) / 2]
    constants = fit.posterior["constant_data"].dataset
    last = constants["first_sample_s"] + (constants["n_samples"] - 1) * constants["sampling_interval_s"]
    truth = truth.join(outcomes_within(made, last.sel(impact=truth["impact"].tolist()).to_numpy()))
    for name, column in (RESPONSES | OUTCOMES).items():
        ends = posterior[name].quantile(levels, ("chain", "draw"))
        low, high = ends.sel(impact=truth["impact"].tolist()).transpose("quantile", "impact").to_numpy()
        parts.append(pd.DataFrame({"of": name, "truth": truth[column], "low": low, "high": high}))
    for name in RESPONSES:
        of_trials = posterior[f"{name}_trial"]
        ratio = np.log(of_trials.isel(trial=1) / of_trials.isel(trial=0)).quantile(levels, ("chain", "draw"))
        difference = made.of_trials[1]["KC".index(name)] - made.of_trials[0]["KC".index(name)]
        ends_of_ratio = dict(zip(("low", "high"), ratio.to_numpy(), strict=True))
        parts.append(pd.DataFrame({"of": f"{name}, t1 over t0", "truth": [difference], **ends_of_ratio}))
    form = fit.diagnostics["model_form"]
    return pd.concat(parts).assign(
        noise=number % len(NOISES),
        element=element(number),
        passed=fit.diagnostics["passed"],
        structured=form["structured"] or form["impacts"]["structured"],
    )


def main() -> None:
    rows = studied("driven_coverage", int(sys.argv[1]), intervals)
    for name, of_element in rows.groupby("element"):
        print(name, shares_held(of_element), sep="\n")
    print(rows.pivot_table("held", ["element", "noise"], "of"))
    one = rows.drop_duplicates("unit")
    print(f"passed {one['passed'].mean():.3f}, called structured {one['structured'].mean():.3f}")


if __name__ == "__main__":
    main()
