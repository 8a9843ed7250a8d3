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
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from evidence import recorded
from evidence.references import tissue_of

from bayestissue.base import runtime
from bayestissue.inference.fit import draws_of_chain, sample
from bayestissue.inference.quantities.quantity_draws import Draws
from bayestissue.inference.results.tree import predicted
from bayestissue.mechanics.elements import element
from bayestissue.model.hierarchy.specification import ModelSpecification, read_specification
from bayestissue.model.hierarchy.trace_data import Prepared, assemble, prepare
from bayestissue.recordings.dataset import Dataset
from bayestissue.recordings.signal import displacements
from bayestissue.recordings.signal.displacement import FEWEST_SAMPLES, Displacements
from bayestissue.studies.simulation import Simulation, simulate

# A share of 90 % is known to 1.1 % by a likelihood's 800 impacts, and to 2.1 % by an element's 200.
CAMPAIGNS = {"coverage_fit": 40, "coverage_elements": 10}
# Of each chain: about as many as are effective, whose quantities are made sooner than those of all.
KEPT = 250
KINDS = ("impact", "arma", "a2")
LENGTHS = (64, 96, 128, 192, 256, 384, 512, 768)
QUANTILES = {"q05": 0.05, "q25": 0.25, "q50": 0.5, "q75": 0.75, "q95": 0.95}
# Of the simulated recordings of this script and of those that are to be as good.
MEASURING_CHAIN = {
    "noise_relative_to_peak": 0.005,
    "offset_sd_m_s2": 0.2,
    "relative_gain_sd": 0.005,
    "velocity_sd_m_s": 0.005,
    "relative_mass_sd": 0.002,
}
ROOT = Path(__file__).parents[1]
FILES = {"kelvin_voigt": "impact"}


def campaign(seed: int) -> Simulation:
    """The specification of one campaign: the example's tissue, a smaller design, exponents of its own."""
    rng = np.random.default_rng([seed, 7])
    exponents, trials = rng.normal(0.5, 1.0, 2), np.abs(rng.normal(0, 0.5, 2))
    conditions = [
        {"trial": f"t{i + 1}", "mass_kg": mass, "velocity_m_s": velocity}
        for i, (mass, velocity) in enumerate([(0.375, 1.5), (0.575, 1.2), (0.867, 1.0), (1.333, 0.8)])
    ]
    return Simulation.model_validate(
        {
            "name": "coverage",
            "seed": seed,
            "design": {"subjects": 5, "conditions": conditions},
            "tissue": {
                "K_N_per_m": 3000.0,
                "C_N_s_per_m": 25.0,
                "reference_mass_kg": 0.7,
                "mass_exponent_K": exponents[0],
                "mass_exponent_C": exponents[1],
                "sd_subject_K": 0.2,
                "sd_subject_C": 0.2,
                "sd_trial_K": trials[0],
                "sd_trial_C": trials[1],
                "sd_impact_K": 0.05,
                "sd_impact_C": 0.05,
            },
            "recording": {
                "sampling_rate_hz": 5000.0,
                "before_contact_s": 0.005,
                "after_contact_s": 0.005,
                **MEASURING_CHAIN,
            },
        }
    )


def campaign_of(name: str, seed: int) -> Simulation:
    """One campaign by another element, and with conditions that all elements bear."""
    content = campaign(seed).model_dump(mode="json")
    exponents = np.random.default_rng([seed, 8]).normal(0.5, 0.3, 2)
    content["tissue"] |= {"mass_exponent_K": exponents[0], "mass_exponent_C": exponents[1]}
    content["tissue"] |= {"sd_trial_K": 0.05, "sd_trial_C": 0.05, "element": name, **tissue_of(name)}
    if element(name).extra:
        content["tissue"]["sd_impact_parameters"] = 0.05
    return Simulation.model_validate(content)


def model_of(name: str) -> ModelSpecification:
    """The model file of a likelihood or of an element."""
    return read_specification(ROOT / "models" / f"{FILES.get(name, name)}.toml")


class Fits:
    """The fits of one model file to data sets of one design, their traces filled up to ``least`` samples."""

    def __init__(self, specification: ModelSpecification, dataset: Dataset, least: int = 0) -> None:
        self._specification, self._least = specification, least
        self._design = prepare(dataset, specification, source="the model file").design

    def prepared(self, dataset: Dataset) -> Prepared:
        """Its data, be its traces as short as they may."""
        signal = filled_up(displacements(dataset, self._specification.signal), self._least)
        return assemble(dataset, self._specification, self._design, signal)

    def fit(self, prepared: Prepared, seed: int) -> tuple[Draws, bool]:
        """Draws of everything, and whether the chains passed."""
        # What is compiled for many shapes takes more mapped memory than a process may have.
        runtime.release_compiled()
        sampler = self._specification.sampler
        chains = sample(prepared, sampler, seed)
        return draws_of_chain(prepared, chains.thinned(min(KEPT, sampler.draws)), seed), chains.verdict.passed


def filled_up(signal: Displacements, least: int = 0) -> Displacements:
    """The same with zeros past the ends, up to one of a few lengths: what is compiled serves most of them."""
    samples = signal.x.shape[1]
    more = next((length for length in LENGTHS if length >= max(samples, least)), samples) - samples
    by_sample = ("x", "v", "value", "sample_number", "clipped")
    rows = {name: np.pad(getattr(signal, name), ((0, 0), (0, more))) for name in by_sample}
    return replace(signal, **rows)


def rows_of(quantities: Mapping[str, tuple[np.ndarray, Any]]) -> pd.DataFrame:
    """A row a quantity and impact, of draws [chain, draw, impact] or [chain, draw] and the truth [impact]."""
    parts = []
    for name, (draws, truth) in quantities.items():
        flat = draws.reshape(draws.shape[0] * draws.shape[1], -1).astype(float)
        quantiles = np.quantile(flat, list(QUANTILES.values()), axis=0)
        columns = {"truth": truth, "mean": flat.mean(0), "sd": flat.std(0, ddof=1)}
        columns |= dict(zip(QUANTILES, quantiles, strict=True))
        parts.append(pd.DataFrame({"quantity": name} | columns))
    return pd.concat(parts, ignore_index=True)


def residuals_of(prepared: Prepared, draws: Draws, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Recorded decelerations [impact, sample], NaN outside the contact, and replicated ones [draw, ...]."""
    signal, replicated = prepared.signal, predicted(prepared, draws, seed)["deceleration"].astype(float)
    inside = np.arange(signal.x.shape[1]) < signal.n_samples[:, None]
    return np.where(inside, signal.deceleration, np.nan), replicated.reshape(-1, *inside.shape)


def compared_with(draws: Draws, truth: pd.DataFrame, simulation: Simulation) -> pd.DataFrame:
    """`rows_of` all that was simulated and fitted: of each impact, and the mass exponents."""
    columns = {"K": "K_N_per_m", "C": "C_N_s_per_m", "K_secant": "K_secant_N_per_m"}
    columns |= {"C_equivalent": "C_equivalent_N_s_per_m", "energy_lost": "energy_lost"}
    columns |= {name: name for name in simulation.tissue.parameters}
    quantities = {
        name: (draws.impacts[name], truth[column].to_numpy())
        for name, column in columns.items()
        if column in truth and name in draws.impacts
    }
    for name in ("mass_exponent_K", "mass_exponent_C"):
        quantities[name] = (draws.population[name], getattr(simulation.tissue, name))
    return rows_of(quantities)


def main() -> None:
    name = sys.argv[1]
    family = "coverage_fit" if name in KINDS else "coverage_elements"
    simulation_of = campaign if name in KINDS else lambda seed: campaign_of(name, seed)
    runtime.configure()
    with recorded(f"{family}-{name}") as record:
        fits = Fits(model_of(name), simulate(simulation_of(0)).dataset("first"))
        for number in record.missing(range(CAMPAIGNS[family])):
            simulation = simulation_of(number)
            result = simulate(simulation)
            prepared = fits.prepared(result.dataset(simulation.name))
            if prepared.signal.n_samples.min() < FEWEST_SAMPLES:
                record.add(number, [])
                continue
            draws, passed = fits.fit(prepared, number)
            rows = compared_with(draws, result.truth, simulation)
            record.add(number, rows.assign(passed=passed))


if __name__ == "__main__":
    main()
