"""How often the intervals of `bayestissue fit` hold the truth, on campaigns simulated by physics.

    .venv/bin/python benchmarks/coverage_fit.py arma
    .venv/bin/python benchmarks/coverage_fit.py a2
    .venv/bin/python benchmarks/coverage_fit.py impact

Each of 200 campaigns has five people in four conditions, 0.375 to 1.333 kg at 5 kHz, and mass exponents and
spreads of the conditions of its own: N(0.5, 1) and half-normals of scale 0.5, as wide as the models' priors
think possible, since four conditions say little of their own spread. The accelerometer's white noise is
0.5 % of the peak; offset, gain, velocity and mass err by as much as the dataset declares. Each goes through
the summary path of the model file. A campaign's impacts share errors of the population, so two standard
errors are given: the binomial one, and that between campaigns. The table goes to coverage_fit.csv and, in
short, to the manual and to the report of a fit.
"""

from __future__ import annotations

import argparse
import itertools
import time
from functools import lru_cache
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pandas as pd
from evidence import recorded

from bayestissue import runtime
from bayestissue.dataset import Dataset
from bayestissue.hierarchy.specification import ModelSpecification, Sampler, read_specification
from bayestissue.hierarchy.trace_data import Prepared, assemble, prepare
from bayestissue.inference.posterior.constrained_draws import constrained_draws
from bayestissue.inference.posterior.exact import exact_draws
from bayestissue.inference.posterior.recipe import Correction, corrected_draws
from bayestissue.inference.posterior.scores import LikelihoodApproximation
from bayestissue.inference.samplers.sampling import ConstrainedDraws
from bayestissue.signal import displacements
from bayestissue.signal.displacement import FEWEST_SAMPLES
from bayestissue.simulation import Simulation, simulate

CAMPAIGNS = 200
KINDS = ("impact", "arma", "a2")
LEVELS = (50, 90)
# Of the simulated recordings of this script and of those that are to be as good.
MEASURING_CHAIN = {
    "noise_relative_to_peak": 0.005,
    "offset_sd_m_s2": 0.2,
    "relative_gain_sd": 0.005,
    "velocity_sd_m_s": 0.005,
    "relative_mass_sd": 0.002,
}
SAMPLER = Sampler(chains=2, warmup=200, draws=300, target_accept=0.8, path="summary")
ROOT = Path(__file__).parents[1]
TABLE = ROOT / "benchmarks" / "coverage_fit.csv"


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


class Fits:
    """The fits of one model file to data sets of one design, through the summary path.

    With ``exact`` through the exact one where the correction can't be trusted, as `bayestissue fit` goes on.
    """

    def __init__(self, specification: ModelSpecification, dataset: Dataset, *, exact: bool = False) -> None:
        self._specification, self._exact = specification, exact
        self._design = prepare(dataset, specification, source="the model file").design

    def prepared(self, dataset: Dataset) -> Prepared:
        """Its data, be its traces as short as they may."""
        signal = displacements(dataset, self._specification.signal)
        return assemble(dataset, self._specification, self._design, signal)

    def fit(self, prepared: Prepared, seed: int) -> tuple[ConstrainedDraws, Correction]:
        """Draws of everything, and how they were corrected."""
        approximation, draws, correction = corrected_draws(prepared, SAMPLER, seed)
        key = jax.random.PRNGKey(seed)
        if self._exact and not correction.trusted:
            draws = exact_draws(prepared, approximation, SAMPLER, seed, processes=False)
            return constrained_draws(prepared, approximation, draws, key), correction
        likelihood = LikelihoodApproximation(approximation, correction.of_impacts)
        return constrained_draws(prepared, approximation, draws, key, likelihood=likelihood), correction


@lru_cache
def _tails() -> np.ndarray:
    return np.array([[0.5 - level / 200, 0.5 + level / 200] for level in LEVELS])


def rows_of(
    found: ConstrainedDraws, truth: pd.DataFrame, made: Simulation, number: int
) -> list[dict[str, Any]]:
    """One row per quantity, impact and level: does the interval hold the truth, how wide, how far off."""
    quantities = {
        "K": (found.impacts["K"], truth["K_N_per_m"].to_numpy()),
        "C": (found.impacts["C"], truth["C_N_s_per_m"].to_numpy()),
        "mass_exponent_K": (
            found.sites["mass_exponent_K"][..., None],
            np.array([made.tissue.mass_exponent_K]),
        ),
        "mass_exponent_C": (
            found.sites["mass_exponent_C"][..., None],
            np.array([made.tissue.mass_exponent_C]),
        ),
    }
    rows = []
    for name, (values, true) in quantities.items():
        flat = values.reshape(-1, values.shape[-1])
        scale = true if name in ("K", "C") else np.ones(1)
        off = np.abs(np.median(flat, axis=0) - true) / scale
        for level, tails in zip(LEVELS, _tails(), strict=True):
            low, high = np.quantile(flat, tails, axis=0)
            held = (low <= true) & (true <= high)
            columns = zip(held, off, (high - low) / scale, strict=True)
            rows += [
                {"campaign": number, "quantity": name, "level": level, "held": h, "off": o, "width": w}
                for h, o, w in columns
            ]
    return rows


def measured(kind: str, campaigns: int, seconds: float) -> tuple[pd.DataFrame, list[float]]:
    """Every row of every campaign that was finished in time, and the Pareto k of each."""
    fits = Fits(read_specification(ROOT / "models" / f"{kind}.toml"), simulate(campaign(0)).dataset("first"))
    begun, rows, pareto, refused = time.perf_counter(), [], [], 0
    for number in itertools.count():
        if len(pareto) == campaigns or time.perf_counter() - begun > seconds:
            break
        made = campaign(number)
        result = simulate(made)
        prepared = fits.prepared(result.dataset(made.name))
        if prepared.signal.n_samples.min() < FEWEST_SAMPLES:
            # A tissue so stiff that the program would ask for a faster recorder.
            refused += 1
            continue
        found, correction = fits.fit(prepared, number)
        rows += rows_of(found, result.truth, made, number)
        pareto.append(correction.pareto_k)
        if len(pareto) % 10 == 0:
            print(f"{kind}: {len(pareto)} campaigns, {time.perf_counter() - begun:.0f} s", flush=True)
    print(f"{kind}: {refused} campaigns refused, since an impact was over in too few samples")
    return pd.DataFrame(rows), pareto


def summarised(kind: str, rows: pd.DataFrame, pareto: list[float], command: str) -> pd.DataFrame:
    """One line per quantity and level."""
    lines = []
    for (quantity, level), part in rows.groupby(["quantity", "level"], sort=False):
        share = part["held"].mean()
        by_campaign = part.groupby("campaign")["held"].mean()
        lines.append(
            {
                "likelihood": kind,
                "quantity": quantity,
                "level": level,
                "held": int(part["held"].sum()),
                "impacts": len(part),
                "share": round(share, 4),
                "binomial_se": round(float(np.sqrt(share * (1 - share) / len(part))), 4),
                "campaign_se": round(float(by_campaign.std(ddof=1) / np.sqrt(len(by_campaign))), 4),
                "median_error": float(f"{part['off'].median():.3g}"),
                "median_width": float(f"{part['width'].median():.3g}"),
                "campaigns": len(by_campaign),
                "pareto_k_above_0.7": int(np.sum(np.array(pareto) >= 0.7)),
                "command": command,
            }
        )
    return pd.DataFrame(lines)


def kept_with(path: Path, lines: pd.DataFrame, key: str) -> pd.DataFrame:
    """Print new lines, and write them into a table in the place of those of the same ``key``."""
    print(lines.drop(columns="command").to_string(index=False))
    if path.is_file():
        before = pd.read_csv(path)
        lines = pd.concat([before[~before[key].isin(lines[key])], lines], ignore_index=True)
    lines.to_csv(path, index=False)
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("likelihood", choices=KINDS)
    parser.add_argument("--campaigns", type=int, default=CAMPAIGNS)
    parser.add_argument("--seconds", type=float, default=np.inf, help="begin no campaign after these")
    asked = parser.parse_args()
    runtime.configure()
    with recorded(f"coverage_fit-{asked.likelihood}") as record:
        rows, pareto = measured(asked.likelihood, asked.campaigns, asked.seconds)
        command = f"benchmarks/coverage_fit.py {asked.likelihood}"
        if len(pareto) != CAMPAIGNS:
            command += f" --campaigns {len(pareto)}"
            record.left = f"{CAMPAIGNS - len(pareto)} of {CAMPAIGNS} campaigns"
        kept_with(TABLE, summarised(asked.likelihood, rows, pareto, command), "likelihood")


if __name__ == "__main__":
    main()
