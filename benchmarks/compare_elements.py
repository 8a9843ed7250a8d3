"""How often `bayestissue compare` finds the element that made the data, among all that there are.

    .venv/bin/python benchmarks/compare_elements.py maxwell

The campaigns are those of coverage.py: five people in four conditions at 5 kHz. Each is fitted by the model
file of every element, by chains of 10,000 transitions at most, and compared by what `compare` calls. Fits
whose chains did not pass are left out, unless fewer than two are left. A row a campaign.
The difference is that of the expected log predictive densities of the right element and of the best other
one, impacts left out in turn, and decides where it is above two of its standard errors and four nats, as in
the report. `_people` is the same with whole people left out.
"""

from __future__ import annotations

import sys
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from coverage import campaign, fits_of
from evidence import measure
from studies import KEPT, decelerations

from bayestissue.inference.model_comparison import compare_runs
from bayestissue.inference.quantities.quantity_draws import Draws
from bayestissue.inference.results.cross_validation import scheme_words
from bayestissue.mechanics.elements import element_names
from bayestissue.model.hierarchy.specification import Sampler
from bayestissue.model.hierarchy.trace_data import Prepared
from bayestissue.studies.simulation import simulate

# Twelve of all elements together: a share of 90 % is known to 9 %.
CAMPAIGNS = 2
# Samples that nearly all traces are filled up to: what one piece has compiled serves the others.
LONGEST = 192
# A wrong element may take all the transitions that there are; the differences are sums over all impacts.
SAMPLER = Sampler(draws=KEPT, effective=200, transitions=10_000)
# What the runs are compared by beside their densities: stiffness and damping of each impact.
OF_IMPACTS = ("C", "C_equivalent", "K", "K_secant")
BY_IMPACT, BY_PERSON = scheme_words("impact"), scheme_words("subject")


def finished(prepared: Prepared, found: Draws) -> xr.DataTree:
    """What `compare` reads of a run's folder."""
    draws, people = ("chain", "draw"), prepared.impacts["subject"].astype(str).to_numpy()
    scalars = {site: (draws, values) for site, values in found.population.items() if values.ndim == 2}
    impacts = {
        site: ((*draws, "impact"), found.impacts[site]) for site in OF_IMPACTS if site in found.impacts
    }
    trace = {"trace": ((*draws, "impact"), found.log_likelihood["trace"])}
    groups = {
        site: ((*draws, site.removeprefix("traces_of_")), values)
        for site, values in found.log_likelihood.items()
        # Beside these is the score of all traces together.
        if site.startswith("traces_of_")
    }
    names = {"impact": prepared.impacts["impact"].astype(str).to_numpy()}
    return xr.DataTree.from_dict(
        {
            "posterior": xr.Dataset({**scalars, **impacts}, names),
            "log_likelihood": xr.Dataset(trace, names),
            "log_likelihood_of_groups": xr.Dataset(groups),
            "observed_data": xr.Dataset(
                {"deceleration": (("impact", "sample"), decelerations(prepared))}, names
            ),
            "constant_data": xr.Dataset({"impact_subject": (("impact",), people)}, names),
        }
    )


def row_of(right: str, number: int) -> dict[str, Any]:
    """One campaign: every fit, and what `compare` says of them."""
    simulation = campaign(right, number)
    result = simulate(simulation)
    runs: dict[str, xr.DataTree] = {}
    refused: dict[str, xr.DataTree] = {}
    passed: dict[str, bool] = {}
    for name in element_names():
        fits = fits_of(name, LONGEST, SAMPLER)
        prepared = fits.prepared(result.dataset(simulation.name))
        found, passed[name] = fits.fit(prepared, number)
        if all(np.isfinite(values).all() for values in found.log_likelihood.values()):
            (runs if passed[name] else refused)[name] = finished(prepared, found)
    if len(runs) < 2:
        runs |= refused
    comparison = compare_runs(runs, {name: {"likelihood": "impact"} for name in runs})
    people = _score(comparison, BY_PERSON, right)
    return {
        **_score(comparison, BY_IMPACT, right),
        **{f"{key}_people": value for key, value in people.items()},
        **_elpd(comparison),
        **{f"trusted_{name}": each for name, each in passed.items()},
    }


def _score(comparison: pd.DataFrame, scheme: str, right: str) -> dict[str, Any]:
    """The right element beside the best other one; a fit without a finite density has lost."""
    rows = comparison[comparison["scheme"] == scheme].set_index("model")
    winner = rows["elpd"].idxmax()
    if right not in rows.index:
        lost = {"difference": -np.inf, "se": 0.0, "weight": 0.0, "high_k": 0}
        return {"winner": winner, "rival": winner, **lost}
    rival = rows.drop(right)["elpd"].idxmax()
    # The table gives differences from the best, which is one of the two.
    loser, sign = (rival, -1) if winner == right else (right, 1)
    return {
        "winner": winner,
        "rival": rival,
        "difference": round(sign * float(rows.loc[loser, "elpd_difference"]), 2),
        "se": round(float(rows.loc[loser, "se_difference"]), 2),
        "weight": round(float(rows.loc[right, "weight"]), 4),
        "high_k": int(rows["warning"].str.contains("Pareto").sum()),
    }


def _elpd(comparison: pd.DataFrame) -> dict[str, float]:
    rows = comparison[comparison["scheme"] == BY_IMPACT].set_index("model")["elpd"]
    return {f"elpd_{name}": round(float(rows.get(name, np.nan)), 2) for name in element_names()}


def main() -> None:
    name = sys.argv[1]
    measure(f"compare_elements-{name}", range(CAMPAIGNS), partial(row_of, name))


if __name__ == "__main__":
    main()
