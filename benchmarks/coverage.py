"""How often the intervals of `bayestissue fit` hold the truth: simulated campaigns, fitted.

    .venv/bin/python benchmarks/coverage.py arma
    .venv/bin/python benchmarks/coverage.py maxwell

Campaigns are simulated by physics, five people in four conditions of 0.375 to 1.333 kg at 5 kHz, with white
accelerometer noise and errors of the measuring chain as they are declared, and with mass exponents of their
own. By `impact`, `arma` and `a2` a spring and damper is fitted by the model file of that likelihood, and the
exponents are drawn from N(0.5, 1); an element's name stands for tissue of that element, fitted by its own
model file, with exponents from N(0.5, 0.3) and conditions that all elements bear.

A row a campaign, quantity and impact has the truth and the posterior's mean, standard deviation and
quantiles. A campaign whose tissue is so stiff that the program would ask for a faster recorder has none.
"""

from __future__ import annotations

import sys
from functools import cache, partial

import numpy as np
import pandas as pd
from evidence import measure
from evidence.references import varied_tissue
from evidence.simulations import by_response, simulation, tables
from studies import CHAIN, Fits, model_of, rows_of

from bayestissue.inference.quantities.quantity_draws import Draws
from bayestissue.model.hierarchy.specification import Sampler
from bayestissue.recordings.signal.displacement import FEWEST_SAMPLES
from bayestissue.studies.simulation import Simulation, simulate

# A share of 90 % is known to 1.1 % by a likelihood's 800 impacts, and to 2.1 % by an element's 200.
CAMPAIGNS = {"coverage_fit": 40, "coverage_elements": 10}
KINDS = ("impact", "arma", "a2")
# Columns of the truth of what is fitted of an impact, beside the parameters of its element.
COLUMNS = {
    "K": "K_N_per_m",
    "C": "C_N_s_per_m",
    "K_secant": "K_secant_N_per_m",
    "C_equivalent": "C_equivalent_N_s_per_m",
    "energy_lost": "energy_lost",
}


def campaign(name: str, seed: int) -> Simulation:
    """A campaign of a likelihood, of the example's tissue; or of an element, in conditions that all bear."""
    if name in KINDS:
        rng = np.random.default_rng([seed, 7])
        exponents, trials = rng.normal(0.5, 1.0, 2), np.abs(rng.normal(0, 0.5, 2))
        own = by_response(mass_exponent=exponents, sd_trial=trials)
    else:
        exponents = np.random.default_rng([seed, 8]).normal(0.5, 0.3, 2)
        own = by_response(mass_exponent=exponents, sd_trial=(0.05, 0.05)) | varied_tissue(name)
    return simulation(tables(__file__)["campaign"], {"tissue": own, "recording": CHAIN}, seed=seed)


def compared_with(draws: Draws, truth: pd.DataFrame, made: Simulation) -> pd.DataFrame:
    """`rows_of` all that was simulated and fitted: of each impact, and the mass exponents."""
    columns = COLUMNS | {name: name for name in made.tissue.parameters}
    quantities = {
        name: (draws.impacts[name], truth[column].to_numpy())
        for name, column in columns.items()
        if column in truth and name in draws.impacts
    }
    for name in ("mass_exponent_K", "mass_exponent_C"):
        quantities[name] = (draws.population[name], getattr(made.tissue, name))
    return rows_of(quantities)


@cache
def fits_of(name: str, least: int = 0, sampler: Sampler | None = None) -> Fits:
    """The fits of campaigns by a model file, compiled once; by its own sampler unless one is given."""
    model = model_of(name)
    model = model.model_copy(update={"sampler": sampler or model.sampler})
    return Fits(model, simulate(campaign(name, 0)).dataset("first"), least)


def rows_of_campaign(name: str, number: int) -> pd.DataFrame:
    """What is kept of one."""
    made, fits = campaign(name, number), fits_of(name)
    result = simulate(made)
    prepared = fits.prepared(result.dataset(made.name))
    if prepared.signal.n_samples.min() < FEWEST_SAMPLES:
        return pd.DataFrame()
    draws, passed = fits.fit(prepared, number)
    return compared_with(draws, result.truth, made).assign(passed=passed)


def main() -> None:
    name = sys.argv[1]
    family = "coverage_fit" if name in KINDS else "coverage_elements"
    measure(f"{family}-{name}", range(CAMPAIGNS[family]), partial(rows_of_campaign, name))


if __name__ == "__main__":
    main()
