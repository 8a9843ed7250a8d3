"""Fits of campaigns that are made here: what they must recover, and one that is killed and goes on."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from time import sleep
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
import pandas as pd
from scipy.stats import binom

from bayestissue.base.declarations import declared
from bayestissue.inference.results.meanings import COLUMNS
from bayestissue.mechanics.elements import element
from bayestissue.reports.figures.impacts import end

_MODEL, _SUMMARY = "model.toml", "summary"
# The campaign, and what is another in that of an element.
_CAMPAIGN = declared(__package__, "campaign.toml")
# Of autoregressive displacements: theta1, and the shocks' standard deviation over the greatest depth.
_THETA1, _SHOCK = 0.3, 1e-5
# Of a correct program one self-test in ten thousand says no.
_RARE = 1e-4
_FARTHEST = 5.0
_CHAINS = 2
# Killed when chains have come so far; looked at so often, and for so long at most.
_SEGMENT, _EVERY_S, _LONGEST_S = "chain-0-segment-0003*", 0.05, 600.0


class Compared(NamedTuple):
    """What was compared, what was expected and found, in words, and whether that is well."""

    what: str
    expected: str
    found: str
    passed: bool


def differing(what: str, here: pd.DataFrame, there: pd.DataFrame) -> Compared:
    """Whether two tables have the same numbers: by a program's seed and on one machine, to the last digit."""
    if here.shape != there.shape:
        return Compared(what, f"{there.shape} numbers", f"{here.shape}", False)
    count = int((~np.isclose(here, there, rtol=0, atol=0, equal_nan=True)).sum())
    return Compared(what, "the same numbers", "the same" if not count else f"{count} differ", not count)


def campaign(
    folder: Path, *, subjects: int = 4, seed: int = 4, tissue: dict[str, Any] | None = None
) -> pd.DataFrame:
    """Write a small simulated campaign of decelerations; its impacts with the truth, a row each."""
    from bayestissue.studies.simulation import simulate, write_campaign
    from bayestissue.studies.simulation.simulation_file import Simulation

    stated = _CAMPAIGN["simulation"]
    changed = {
        "seed": seed,
        "design": stated["design"] | {"subjects": subjects},
        "tissue": stated["tissue"] | (tissue or {}),
    }
    simulation = Simulation.model_validate(stated | changed)
    campaign = simulate(simulation)
    write_campaign(folder, campaign, simulation)
    return campaign.impacts[["impact", "subject", "trial"]].merge(campaign.truth, on="impact")


def displacements(folder: Path, *, sampled: bool) -> pd.DataFrame:
    """Write displacements that are an ARMA(2,1) of known parameters, ``sampled`` if they are an A(2)'s."""
    from bayestissue.mechanics.oscillator import (
        impact_motion,
        spring_damper_inverse,
        time_to_peak,
        to_differences,
    )
    from bayestissue.model.likelihood.arma21 import arma21_series
    from bayestissue.recordings.dataset import write_dataset

    truth = campaign(folder / "decelerations")
    rng, dt = np.random.default_rng(5), 1 / 5000
    K, C, mass = (truth[name].to_numpy(float) for name in ("K_N_per_m", "C_N_s_per_m", "mass_kg"))
    velocity = np.full(len(truth), 1.5)
    omega_n, zeta = (np.asarray(value) for value in spring_damper_inverse(K, C, mass))
    c1, c2, theta1 = to_differences(omega_n, zeta, dt)
    peak = np.asarray(time_to_peak(omega_n, zeta))
    samples = int(np.ceil(peak.max() / dt)) + 2
    first = impact_motion(dt * np.arange(2), omega_n[:, None], zeta[:, None], velocity[:, None]).displacement
    shocks = _SHOCK * velocity / omega_n * rng.normal(size=(samples - 1, len(truth)))
    theta1 = theta1 if sampled else jnp.full(len(truth), _THETA1)
    x = np.asarray(arma21_series(first, jnp.asarray(shocks), c1, c2, theta1))
    until_peak = np.arange(samples) * dt <= peak[:, None]
    row, sample = np.nonzero(until_peak)
    names = truth["impact"].to_numpy()
    write_dataset(
        folder / "displacements",
        settings={"name": "self-test", "signal": {"quantity": "displacement", "unit": "m"}},
        impacts=truth[["impact", "subject", "trial", "mass_kg"]],
        traces=pd.DataFrame({"impact": names[row], "time_s": sample * dt, "value": x[until_peak]}),
    )
    return truth


def recovered(folder: Path, model: str) -> list[Compared]:
    """Fit a campaign that ``model`` has made, by the command in a process of its own, and look for its truth.

    Args:
        folder: an empty one; the fit stays in its folder ``fit``.
        model: a model of the program: "impact", "arma", "a2" or the name of an element.
    """
    if model in ("arma", "a2"):
        truth, dataset = displacements(folder, sampled=model == "a2"), folder / "displacements"
    else:
        tissue = {} if model == "impact" else _tissue(model)
        truth, dataset = campaign(folder / "recorded", tissue=tissue), folder / "recorded"
    ended = fit(dataset, folder / "fit", model)
    return [Compared("exit status", "0", str(ended), ended == 0), *_held(folder / "fit", truth)]


def _tissue(name: str) -> dict[str, Any]:
    """Of an element with its typical further parameters."""
    further = {parameter.name: parameter.typical for parameter in element(name).extra}
    return {"element": name, "parameters": further, **_CAMPAIGN["elements"].get(name, {})}


def _held(run: Path, truth: pd.DataFrame) -> list[Compared]:
    """Of a finished fit: how many 90 % intervals hold the truth, and the farthest from it."""
    from bayestissue.base.results.tables import read_table

    summary = read_table(run, _SUMMARY)
    held, distances = [], []
    for variable, column in COLUMNS.items():
        rows = summary[summary["variable"] == variable].reset_index(drop=True)
        true = truth[column].to_numpy(float)
        held.append((rows["eti90_low"] <= true) & (true <= rows["eti90_high"]))
        distances.append(np.abs(true - rows["median"]) / rows["sd"])
    hits, farthest = np.concatenate(held), float(np.max(distances))
    return [
        coverage(hits),
        Compared(
            "the truth's greatest distance from the median, in standard deviations",
            f"at most {_FARTHEST:g}",
            f"{farthest:.2f}",
            farthest <= _FARTHEST,
        ),
    ]


def coverage(hits: np.ndarray, name: str = "K and C") -> Compared:
    """How many 90 % intervals hold the truth, which of a correct program are hardly ever fewer."""
    held, least = int(hits.sum()), int(binom.ppf(_RARE, hits.size, 0.9))
    expected, observed = f"at least {least} of {hits.size}", f"{held} of {hits.size}"
    return Compared(f"90 % intervals of {name} that hold the truth", expected, observed, held >= least)


def calibrated(folder: Path, campaigns: int) -> list[Compared]:
    """Estimate each impact of campaigns by itself: K and C of thirty impacts each, and their intervals."""
    from bayestissue.inference.single.impact_estimates import estimate

    hits: dict[str, list[np.ndarray]] = {q: [] for q in COLUMNS}
    for number in range(campaigns):
        truth = campaign(folder / f"campaign-{number}", subjects=10, seed=100 + number)
        estimates = estimate(folder / f"campaign-{number}")
        for q, column in COLUMNS.items():
            low, high = (estimates[end(q, side)].to_numpy() for side in ("low", "high"))
            true = truth[column].to_numpy(float)
            hits[q].append((low <= true) & (true <= high))
    return [coverage(np.concatenate(inside), name) for name, inside in hits.items()]


def resumed(folder: Path, whole: Path) -> list[Compared]:
    """Kill a fit amid its chains, give the same command again, and compare with the fit that was not killed.

    Args:
        folder: an empty one.
        whole: of `recovered`, of the model "impact".
    """
    from bayestissue.base.results.tables import read_table

    dataset, out = whole / "recorded", folder / "fit"
    process = subprocess.Popen(  # noqa: S603 - this program
        _command(dataset, out, "impact"), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    waited = 0.0
    while process.poll() is None and waited < _LONGEST_S and not any(folder.rglob(_SEGMENT)):
        sleep(_EVERY_S)
        waited += _EVERY_S
    running = process.poll() is None
    process.kill()
    process.wait()
    finished = len(list(folder.rglob("chain-*-segment-*")))
    ended = fit(dataset, out, "impact")
    return [
        Compared(
            "finished parts of a fit that was killed", "kept", f"{finished} kept", running and finished > 0
        ),
        Compared("exit status of the same command again", "0", str(ended), ended == 0),
        differing(
            "summary.csv, against that of the fit that was not killed",
            *(read_table(run, _SUMMARY).select_dtypes("number") for run in (out, whole / "fit")),
        ),
    ]


def fit(dataset: Path, out: Path, model: str) -> int:
    """The exit status of ``bayestissue fit``, in a process of its own."""
    return subprocess.run(  # noqa: S603 - this program
        _command(dataset, out, model), capture_output=True, check=False
    ).returncode


def _command(dataset: Path, out: Path, model: str) -> Sequence[str]:
    file = out.parent / _MODEL
    file.write_text(f'like = "{model}"\n[sampler]\nchains = {_CHAINS}\n', encoding="utf-8")
    words = ("fit", dataset, "--model", file, "--out", out, "--quiet")
    return [sys.executable, "-m", "bayestissue", *map(str, words)]
