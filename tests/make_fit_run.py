"""A small run folder with the shape of a finished `fit`; its numbers are invented."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from bayestissue.base.results.tables import table_of_rows
from bayestissue.base.runtime import FORMAT
from bayestissue.inference.answers.contrasts import Contrasts, contrasts_table
from bayestissue.inference.answers.law import Law
from bayestissue.inference.answers.level_tables import curves_table, levels_table, loops_table
from bayestissue.inference.answers.reliability import as_variables, coefficients, reliability, variances
from bayestissue.inference.answers.study import Study
from bayestissue.inference.quantities.secants import comparable_draws
from bayestissue.model.hierarchy.recorded import Recorded
from bayestissue.reports.pages.fit.fit_run import FitRun
from bayestissue.reports.pages.run_folder import read_about
from made_once import made_once
from tree_file import write_tree

CHAINS, DRAWS, REPLICATES, SAMPLES = 2, 100, 40, 60
PEOPLE, CONDITIONS = 4, 3
MASS = np.array([0.4, 0.7, 1.2])
LEVEL = {"K": 2500.0, "C": 25.0}
UNITS = {"K": "N/m", "C": "N s/m"}
COLUMN = {"K": "K_N_per_m", "C": "C_N_s_per_m"}
POSTERIOR_SD, SUBJECT_SD = 0.01, 0.2
DT = 2e-4
PRIOR_DRAWS = 300

type Groups = dict[str, xr.Dataset]


def write_fit_run(
    folder: Path,
    *,
    passed: bool = True,
    truth: bool = True,
    exponent: float | None = 0.0,
    mass_varies: bool = True,
    likelihood: str = "a2",
    quantity: str = "deceleration",
    coloured: bool = False,
    own_depth: float | None = None,
    two_sides: bool = False,
    discrepancy: bool = False,
    pictures: bool = False,
    seed: int = 1,
    extended: Callable[[Groups], Groups] = dict,
) -> Path:
    """Write every file that a fit writes into ``folder``.

    ``exponent`` is the posterior's mean mass exponent of K (C's is 0), None for a model without one;
    ``coloured`` noise is a running mean of two samples; with ``own_depth``, K's exponent at each impact's own
    greatest depth, ``exponent`` is that at a common depth; of ``two_sides``, left is a fifth stiffer; beside
    a ``discrepancy`` the element's own K is half of K_secant, which is true; with
    ``pictures`` there are loops and curves. What is written is ``extended``.
    """
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(seed)
    impacts = _impacts(mass_varies)
    true = {
        q: LEVEL[q] * np.exp(SUBJECT_SD * rng.standard_normal(PEOPLE))[impacts["person"]] for q in ("K", "C")
    }
    posterior = _posterior(rng, impacts, true, exponent, likelihood)
    traces = _traces(rng, impacts, true, coloured, likelihood)
    if discrepancy:
        posterior = _with_discrepancy(posterior, impacts["subject"].to_numpy(str))
    if own_depth is not None:
        posterior["mass_exponent_K_common_depth"] = posterior["mass_exponent_K"]
        posterior["mass_exponent_K_secant"] = posterior["mass_exponent_K"] + own_depth - (exponent or 0.0)
        traces["constant_data"]["common_depth_m"] = 0.0123
    about = _about(passed, likelihood, quantity, exponent)
    about |= {"discrepancy": {"rms_of_peak": 0.05}} if discrepancy else {}
    if two_sides:
        _with_sides(rng, posterior, traces["constant_data"], about["model"]["formula"])
    recorded = Recorded.of_run(traces["constant_data"], about["model"])
    prior, found = _prior(posterior, seed), {}
    for name, draws in (("posterior", posterior), ("prior", prior)):
        for q in ("K", "C"):
            draws[f"{q}_typical_person"] = np.exp(draws[f"intercept_{q}"]).assign_attrs(unit=UNITS[q])
        repeatable = ("C",) if discrepancy else ("K", "C")
        each = {q: variances(draws, recorded, q, measurement_sd=0.01) for q in repeatable}
        found[name] = coefficients(each, draws)
        draws.update(as_variables(found[name]))
    groups = {"posterior": posterior, "prior": prior, **traces}
    write_tree(extended(groups), folder / "posterior.nc")
    tables = _tables(rng, impacts, true, posterior, exponent)
    compared = Contrasts(Study(posterior, recorded, Law(described=not discrepancy)))
    tables["contrasts"], tables["levels"] = contrasts_table(compared, 0.1), levels_table(compared)
    drawn = {"loops": loops_table, "curves": curves_table} if pictures else {}
    tables |= {name: drawn[name](compared) if drawn else table_of_rows(name) for name in ("loops", "curves")}
    tables["agreement"] = table_of_rows("agreement")
    tables["reliability"] = reliability(found["posterior"], found["prior"])
    for name, table in tables.items():
        table.to_csv(folder / f"{name}.csv", index=False)
    if truth:
        frame = pd.DataFrame({"impact": impacts["impact"], **{COLUMN[q]: true[q] for q in true}})
        frame.to_csv(folder / "truth.csv", index=False)
    _write(folder / "diagnostics.json", _diagnostics(passed))
    _write(folder / "run.json", about)
    return folder


make_fit_run = made_once(write_fit_run)


def read_fit_run(folder: Path, record: dict[str, Any] | None = None) -> FitRun:
    """A run as a page reads it, by another ``run.json`` than its own if there is one."""
    return FitRun.read(folder, read_about(folder) if record is None else record).complete()


def changed(run: FitRun, **parts: Any) -> FitRun:
    """A run of which some fields, tables or groups are others."""
    tables = {name: parts.pop(name) for name in ("summary", "contrasts", "levels") if name in parts}
    kept = {name: parts.pop(name) for name in ("groups",) if name in parts} or {"groups": run.groups}
    about = {"about": parts.pop("record")} if "record" in parts else {}
    copy = replace(
        run, **parts, **about, table=lambda name: tables[name] if name in tables else run.table(name)
    )
    vars(copy).update(kept)
    return copy


def _with_discrepancy(posterior: xr.Dataset, people: np.ndarray) -> xr.Dataset:
    secant = posterior["K"].copy()
    for name in ("K", "K_subject", "K_trial", "K_new"):
        posterior[name] = 0.5 * posterior[name]
    posterior["intercept_K"] = posterior["intercept_K"] + np.log(0.5)
    typical = np.log(0.05) + 0 * posterior["intercept_K"]
    pooled = {"discrepancy_mean": typical, "sd_discrepancy": 1 + 0 * typical}
    posterior = posterior.assign(K_secant=secant, discrepancy=0.05 + 0 * secant, **pooled)
    return posterior.assign(comparable_draws(posterior[["K_secant"]], {"subject": people}))


def _with_sides(rng, posterior: xr.Dataset, constants: xr.Dataset, formula: dict[str, str]) -> None:
    for q, ratio in (("K", 1.2), ("C", 1.0)):
        drawn = -np.log(ratio) + 0.03 * rng.standard_normal((CHAINS, DRAWS))
        posterior[f"effect_of_side[right]_{q}"] = (("chain", "draw"), drawn)
        formula[q] = f"side + {formula[q]}"
    sides = np.resize(["left", "right"], constants.sizes["impact"])
    constants["column_side"] = xr.Variable("impact", sides, {"column": "side"})


def _impacts(mass_varies: bool) -> pd.DataFrame:
    person, condition = np.meshgrid(np.arange(PEOPLE), np.arange(CONDITIONS))
    frame = pd.DataFrame({"person": person.ravel(), "condition": condition.ravel()})
    frame["subject"] = [f"s{i}" for i in frame["person"]]
    frame["trial"] = [f"t{i}" for i in frame["condition"]]
    frame["impact"] = frame["trial"] + "-" + frame["subject"]
    frame["mass_kg"] = MASS[frame["condition"]] if mass_varies else 0.7
    return frame


def _posterior(rng, impacts, true, exponent, likelihood) -> xr.Dataset:
    shape = (CHAINS, DRAWS)

    def normal(*more: int) -> np.ndarray:
        return rng.standard_normal((*shape, *more))

    of = {"impact": "impact", "subject": "subject", "trial": "trial"}
    found: dict[str, tuple] = {}
    for q in ("K", "C"):
        at = np.log(LEVEL[q]) + 0.05 * normal()
        person = np.log(true[q][:PEOPLE] / LEVEL[q])
        own = np.log(true[q]) + POSTERIOR_SD * (rng.standard_normal(len(impacts)) + normal(len(impacts)))
        found |= {
            f"intercept_{q}": ((), at),
            f"subject_effect_{q}": (("subject",), person + 0.02 * normal(PEOPLE)),
            f"trial_effect_{q}": (("trial",), 0.01 * normal(CONDITIONS)),
            f"sd_impact_{q}": ((), np.exp(-3 + 0.1 * normal())),
            f"sd_subject_{q}": ((), np.exp(-1.5 + 0.2 * normal())),
            f"sd_trial_{q}": ((), np.exp(-4 + 0.2 * normal())),
            f"{q}_subject": (("subject",), LEVEL[q] * np.exp(person + 0.02 * normal(PEOPLE))),
            f"{q}_trial": (("trial",), LEVEL[q] * np.exp(0.05 * normal(CONDITIONS))),
            q: ((of["impact"],), np.exp(own)),
            f"{q}_new": ((), np.exp(at + SUBJECT_SD * normal())),
        }
        if exponent is not None:
            found[f"mass_exponent_{q}"] = ((), (exponent if q == "K" else 0.0) + 0.02 * normal())
    count = len(impacts)
    errors = ("ramp_error", "level_error") if likelihood != "impact" else ("velocity_error",)
    found |= {name: (("impact",), 1e-3 * normal(count)) for name in errors}
    found["mass"] = (("impact",), impacts["mass_kg"].to_numpy() * (1 + 0.002 * normal(count)))
    if likelihood == "impact":
        found["sigma_d"] = (("impact",), np.exp(0.1 * normal(count)))
    else:
        found["sigma_a"] = (("impact",), np.exp(-18 + 0.1 * normal(count)))
        found["theta1"] = (("impact",), -0.999 + 1e-4 * normal(count))
    coords = {
        "impact": impacts["impact"].tolist(),
        "subject": [f"s{i}" for i in range(PEOPLE)],
        "trial": [f"t{i}" for i in range(CONDITIONS)],
    }
    posterior = xr.Dataset({k: (("chain", "draw", *dims), v) for k, (dims, v) in found.items()}, coords)
    for name, values in posterior.items():
        values.attrs = {"unit": UNITS.get(str(name)[0], "1")}
    return posterior


def _prior(posterior: xr.Dataset, seed: int) -> xr.Dataset:
    """One chain of the population and its levels, wider than the posterior and about the same values."""
    rng, shape = np.random.default_rng([seed, 1]), (1, PRIOR_DRAWS)
    levels = [name for name in posterior.data_vars if "impact" not in posterior[name].dims]

    def wider(array: xr.DataArray) -> tuple[tuple[str, ...], np.ndarray]:
        middle, spread = array.mean(("chain", "draw")), 10 * array.std(("chain", "draw"))
        noise = rng.standard_normal((*shape, *middle.shape))
        values = middle.to_numpy() + spread.to_numpy() * noise
        return array.dims, np.abs(values) if str(array.name).startswith("sd_") else values

    return xr.Dataset({name: wider(posterior[name]) for name in levels}, posterior[levels].coords).drop_vars(
        ["chain", "draw"], errors="ignore"
    )


def _traces(rng, impacts, true, coloured, likelihood) -> dict[str, xr.Dataset]:
    mass, velocity = impacts["mass_kg"].to_numpy(), 1.5
    time = DT * np.arange(SAMPLES) + 0 * mass[:, None]
    rate = np.sqrt(true["K"] / mass)[:, None]
    clean = {
        "deceleration": velocity * rate * np.sin(rate * time),
        "displacement": velocity / rate * np.sin(rate * time),
    }
    noise = {"deceleration": 0.1, "displacement": 1e-6}
    inside = np.arange(SAMPLES) < SAMPLES - np.arange(len(impacts))[:, None] % 3

    def noisy(name: str, colour: bool, *shape: int) -> np.ndarray:
        white = rng.standard_normal((*shape, len(impacts), SAMPLES + 1))
        added = white[..., 1:] + white[..., :-1] if colour else white[..., 1:]
        return np.where(inside, clean[name] + noise[name] * added, np.nan)

    names, chain = impacts["impact"].tolist(), ("chain", "draw", "impact", "time_index")
    of_impact = {
        "mass_kg": mass,
        "velocity_m_s": np.full(len(impacts), velocity),
        "impact_subject": impacts["subject"].to_numpy(str),
        "impact_trial": impacts["trial"].to_numpy(str),
    }
    return {
        "posterior_predictive": xr.Dataset(
            {k: (chain, noisy(k, False, CHAINS, REPLICATES // CHAINS).astype("float32")) for k in clean},
            {"impact": names},
        ),
        "observed_data": xr.Dataset(
            {k: (("impact", "time_index"), noisy(k, coloured)) for k in clean}, {"impact": names}
        ),
        "constant_data": xr.Dataset(
            {
                "time": (("impact", "time_index"), np.where(inside, time, np.nan)),
                **{k: (("impact",), v) for k, v in of_impact.items()},
            },
            {"impact": names},
        ),
    }


def _tables(rng, impacts, true, posterior, exponent) -> dict[str, pd.DataFrame]:
    own = impacts[["impact", "subject", "trial", "mass_kg"]].assign(flags="")
    # As the thesis's method does: too large, and C growing with the mass.
    dds = own.assign(K_N_per_m=2 * true["K"], C_N_s_per_m=3 * true["C"] * own["mass_kg"] ** 0.5)
    every = ("K", "C", "K_common_depth", "K_secant") if exponent is not None else ()
    quantities = [q for q in every if f"mass_exponent_{q}" in posterior]
    slopes = {q: posterior[f"mass_exponent_{q}"].to_numpy() for q in quantities}
    hypotheses = [
        (q, name, value, value - 0.1, value + 0.1, float(np.mean(np.abs(slopes[q] - value) < 0.1)))
        for q in quantities
        for name, value in (("fixed stiffness", 0.0), ("constant natural frequency", 1.0))
    ]  # fmt: skip
    schemes = (("impact", own["impact"]), ("subject", posterior["subject"]), ("trial", posterior["trial"]))
    bad = ("", "Pareto k above 0.7")
    scores = [
        (f"leave one {kind} out", str(label), 500.0 + i, 0.2 + 0.7 * (i == 1), bad[i == 1])
        for kind, labels in schemes
        for i, label in enumerate(np.asarray(labels))
    ]  # fmt: skip
    return {
        "summary": _summary(posterior),
        "estimates_dds": dds,
        "hypotheses": pd.DataFrame(
            hypotheses, columns=["quantity", "hypothesis", "value", "rope_low", "rope_high", "probability"]
        ),
        "cross_validation": pd.DataFrame(
            scores, columns=["scheme", "label", "elpd", "pareto_k", "warning"]
        ),
        "sensitivity": pd.DataFrame(
            [("intercept_K", 0.01, 0.2, "✓"), ("sd_trial_K", 0.1, 0.2, "potential prior-data conflict")],
            columns=["variable", "prior", "likelihood", "diagnosis"],
        ),
        "interval_sources": _sources(),
    }  # fmt: skip


def _sources() -> pd.DataFrame:
    of_impact = {
        "noise": 0.5,
        "velocity and gain": 0.3,
        "offset": 0.0,
        "contact moment": 0.05,
        "impacts": 0.15,
    }
    of_people = {"noise": 0.0005, "people": 0.7, "conditions": 0.2, "priors": 0.0995}
    rows = [
        (level, q, source, share, 0.01 * share**0.5)
        for level, shares in (("impact", of_impact), ("typical person", of_people), ("new person", of_people))
        for q in ("K", "C")
        for source, share in {**shares, "all": 1.0, "as drawn": 1.0 + (level == "new person")}.items()
    ]  # fmt: skip
    return pd.DataFrame(rows, columns=["level", "quantity", "source", "share", "sd"])


def _summary(posterior: xr.Dataset) -> pd.DataFrame:
    parts = []
    for name, array in posterior.data_vars.items():
        flat = array.to_numpy().reshape(CHAINS * DRAWS, -1)
        low, quarter, median, three_quarters, high = np.percentile(flat, [5, 25, 50, 75, 95], axis=0)
        part = pd.DataFrame(
            {
                "label": array[array.dims[2]].to_numpy() if array.ndim == 3 else [""],
                "mean": flat.mean(0),
                "sd": flat.std(0),
                "median": median,
                "eti50_low": quarter,
                "eti50_high": three_quarters,
                "eti90_low": low,
                "eti90_high": high,
            }
        )
        parts.append(part.assign(variable=name, unit=UNITS.get(str(name)[0], "1")))
    return pd.concat(parts).assign(ess_bulk=1000.0, ess_tail=900.0, r_hat=1.001, mcse_mean=0.01)


def _diagnostics(passed: bool) -> dict[str, object]:
    path, words = ("summary", "Corrected.") if passed else ("exact", "Sampled by the exact path, since.")
    return {
        "passed": passed,
        "route": {"path": path, "asked": "automatic", "words": words, "attempts": []},
        "checks": [
            {
                "name": "R-hat",
                "value": 1.003 if passed else 1.4,
                "limit": "below 1.01",
                "passed": passed,
                "meaning": "do the chains agree?",
                "next_step": "" if passed else "Draw longer chains.",
            }
        ],
    }


def _about(passed: bool, likelihood: str, quantity: str, exponent: float | None) -> dict[str, Any]:
    formula = "(1|subject) + (1|trial)" if exponent is None else "log(mass_kg) + (1|subject) + (1|trial)"
    return {
        "program": "bayestissue",
        "format": FORMAT,
        "command": "fit",
        "kind": "fit",
        "dataset": "made up",
        "description": "Nothing was measured.",
        "quantity": quantity,
        "versions": {"python": "3.12", "bayestissue": "0.2.0", "numpy": "2.3", "numpyro": "0.19"},
        "model": {
            "name": likelihood,
            "description": "A made-up model.",
            "likelihood": likelihood,
            "signal": {"window": "peak"},
            "reference_mass_kg": 0.7,
            "formula": {"K": formula, "C": formula},
            "residual_correlation": True,
            "priors": {
                "intercept": {"K": {"distribution": "normal", "mean": 7.0, "sd": 3.0}},
                "atanh_theta1": {"distribution": "normal", "mean": 0.0, "sd": 1.5},
            },
        },
        "uncertainty": {"relative_mass_sd": 0.002, "velocity_sd_m_s": 0.005, "relative_gain_sd": 0.0},
        "terms_left_out": [],
        "columns_not_used": [],
        "left_out": ["traces, impact t9-s9: found 3; expected 8 samples. Record faster."],
        "seed": 0,
        "input_hash": "0123456789abcdef",
        "started": "2026-01-01T00:00:00+00:00",
        "wall_time_s": 61.5,
        "verdict": {
            "passed": passed,
            "words": "All checks passed." if passed else "R-hat is 1.4: the chains disagree.",
            "doubts": "All checks passed." if passed else "R-hat is 1.4: the chains disagree.",
        },
    }


def _write(path: Path, content: dict[str, object]) -> None:
    path.write_text(json.dumps(content, ensure_ascii=False), encoding="utf-8")
