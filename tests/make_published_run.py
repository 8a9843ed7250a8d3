"""A small run folder with the shape of a finished `reproduce` run; its numbers are invented."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import xarray as xr

from bayestissue.base.runtime import FORMAT
from made_once import made_once

CHAINS, DRAWS = 2, 150
TRIALS = [7, 8, 9, 16, 17, 18, 25, 26, 27]
LOST = [7, 25]
MASS = np.array([0.666, 0.489, 0.375, 1.0, 0.734, 0.562, 1.333, 0.979, 0.75])
VELOCITY = np.array([1.25, 1.5, 1.75] * 3)
ENERGY = np.repeat([0.75, 1.125, 1.5], 3)
SUBJECTS = [f"s{number:02d}" for number in range(1, 11)]
SD = {"K": (0.004, 0.02, 0.03), "C": (0.1, 0.1, 0.45)}
LEVEL, EXPONENT = {"K": 18.0, "C": 1.5}, {"K": 0.97, "C": 1.1}
EXPONENT_SD = {"K": 0.02, "C": 0.12}


@made_once
def make_published_run(
    folder: Path, *, passed: bool = True, exponent: float = EXPONENT["K"], seed: int = 1
) -> Path:
    """Write every file of the contract between analysis and report into ``folder``."""
    folder.mkdir(parents=True, exist_ok=True)
    tree = _posterior(np.random.default_rng(seed), exponent)
    tree.to_netcdf(folder / "posterior.nc", engine="h5netcdf")
    _summary(tree).to_csv(folder / "summary.csv", index=False)
    _hypotheses(tree).to_csv(folder / "hypotheses.csv", index=False)
    for name, frame in _tables().items():
        frame.to_csv(folder / f"{name}.csv", index=False)
    (folder / "diagnostics.json").write_text(json.dumps(_diagnostics(passed)), encoding="utf-8")
    (folder / "run.json").write_text(json.dumps(_run(passed)), encoding="utf-8")
    return folder


def _posterior(rng: np.random.Generator, exponent: float) -> xr.DataTree:
    shape = (CHAINS, DRAWS)
    kept = [i for i, trial in enumerate(TRIALS) if trial not in LOST]
    impact_trial = np.repeat(kept, 10)
    impact_subject = np.tile(np.arange(10), len(kept))
    posterior: dict[str, tuple] = {}
    predictive: dict[str, tuple] = {}
    observed: dict[str, tuple] = {}
    prior: dict[str, tuple] = {}
    for q in ("K", "C"):
        true = exponent if q == "K" else EXPONENT[q]
        beta = true + EXPONENT_SD[q] * rng.standard_normal(shape)
        level = np.log(LEVEL[q]) + 0.5 * EXPONENT_SD[q] * rng.standard_normal(shape)
        sd_subject, sd_trial, sd_impact = (sd * np.exp(0.2 * rng.standard_normal(shape)) for sd in SD[q])
        subject = sd_subject[..., None] * rng.standard_normal((*shape, 10))
        trial = sd_trial[..., None] * rng.standard_normal((*shape, 9))
        log_trial = level[..., None] + beta[..., None] * np.log(MASS / 0.75) + trial
        cell = log_trial[..., None, :] + subject[..., :, None]
        at_impact = cell[..., impact_subject, impact_trial]
        replicate = at_impact + sd_impact[..., None] * rng.standard_normal(at_impact.shape)
        truth = np.log(LEVEL[q]) + true * np.log(MASS / 0.75)
        data = np.exp(truth[impact_trial] + SD[q][2] * rng.standard_normal(len(impact_trial)))
        mean_slope = LEVEL[q] / 0.75
        posterior |= {
            q: (("chain", "draw", "impact"), np.exp(at_impact)),
            f"{q}_cell": (("chain", "draw", "subject", "trial"), np.exp(cell)),
            f"{q}_subject": (("chain", "draw", "subject"), np.exp(level[..., None] + subject)),
            f"{q}_trial": (("chain", "draw", "trial"), np.exp(log_trial)),
            f"{q}_new": (("chain", "draw"), np.exp(level + 0.04 * rng.standard_normal(shape))),
            f"mass_exponent_{q}": (("chain", "draw"), beta),
            f"subject_effect_{q}": (("chain", "draw", "subject"), subject),
            f"trial_effect_{q}": (("chain", "draw", "trial"), trial),
            f"sd_subject_{q}": (("chain", "draw"), sd_subject),
            f"sd_trial_{q}": (("chain", "draw"), sd_trial),
            f"sd_impact_{q}": (("chain", "draw"), sd_impact),
            f"intercept_{q}": (("chain", "draw"), level),
            f"{q}_typical_person": (("chain", "draw"), np.exp(level)),
            f"linear_intercept_{q}": (("chain", "draw"), 0.1 + 0.2 * rng.standard_normal(shape)),
            f"linear_slope_{q}": (("chain", "draw"), mean_slope * (1 + 0.02 * rng.standard_normal(shape))),
        }
        lost = [TRIALS.index(number) for number in LOST]
        predictive |= {
            f"{q}_observed": (("chain", "draw", "impact"), np.exp(replicate)),
            f"{q}_average": (("chain", "draw", "averaged_trial"), np.exp(log_trial[..., lost])),
            f"{q}_sd": (("chain", "draw", "averaged_trial"), 0.5 + 0 * log_trial[..., lost]),
        }
        observed |= {
            f"{q}_observed": (("impact",), data),
            f"{q}_average": (("averaged_trial",), np.exp(truth[lost])),
            f"{q}_sd": (("averaged_trial",), np.full(2, 0.5)),
        }
        prior[f"mass_exponent_{q}"] = (("chain", "draw"), 0.5 + rng.standard_normal(shape))
    posterior["residual_correlation"] = (("chain", "draw"), np.tanh(rng.standard_normal(shape)))
    coords = {
        "chain": np.arange(CHAINS),
        "draw": np.arange(DRAWS),
        "impact": [
            f"t{TRIALS[t]:02d}-{SUBJECTS[s]}" for t, s in zip(impact_trial, impact_subject, strict=True)
        ],
        "subject": SUBJECTS,
        "trial": [str(number) for number in TRIALS],
        "averaged_trial": [str(number) for number in LOST],
    }
    constant = {
        "mass_kg": ("trial", MASS),
        "velocity_m_s": ("trial", VELOCITY),
        "energy_J": ("trial", ENERGY),
        "reference_mass_kg": ((), 0.75),
        "impact_subject": ("impact", impact_subject),
        "impact_trial": ("impact", impact_trial),
    }
    stats = {
        "diverging": (("chain", "draw"), np.zeros(shape, dtype=bool)),
        "energy": (("chain", "draw"), 40 + 5 * rng.standard_normal(shape)),
        "acceptance_rate": (("chain", "draw"), np.full(shape, 0.9)),
        "tree_depth": (("chain", "draw"), np.full(shape, 4)),
    }
    terms = {
        "estimates": (("chain", "draw", "impact"), -1 + 0.1 * rng.standard_normal((*shape, 70))),
        "averages": (("chain", "draw", "averaged_trial"), -1 + 0.1 * rng.standard_normal((*shape, 2))),
    }
    groups = {
        "posterior": posterior,
        "sample_stats": stats,
        "log_likelihood": terms,
        "log_prior": {"mass_exponent_K": (("chain", "draw"), np.zeros(shape))},
        "prior": prior,
        "prior_predictive": predictive,
        "posterior_predictive": predictive,
        "observed_data": observed,
        "constant_data": constant,
    }
    return xr.DataTree.from_dict({name: _dataset(content, coords) for name, content in groups.items()})


def _dataset(content: dict[str, tuple], coords: dict[str, object]) -> xr.Dataset:
    used = {dim for dims, _ in content.values() for dim in ([dims] if isinstance(dims, str) else dims)}
    return xr.Dataset(content, {name: values for name, values in coords.items() if name in used})


def _summary(tree: xr.DataTree) -> pd.DataFrame:
    rows = []
    for name, array in tree["posterior"].dataset.data_vars.items():
        flat = array.to_numpy().reshape(CHAINS * DRAWS, -1)
        labels = array[array.dims[2]].to_numpy() if array.ndim == 3 else [""] * flat.shape[1]
        low, high = np.percentile(flat, [5, 95], axis=0)
        quarter, median, three_quarters = np.percentile(flat, [25, 50, 75], axis=0)
        rows.append(
            pd.DataFrame(
                {
                    "variable": name,
                    "label": labels,
                    "unit": {"K": "N/m", "C": "N s/m"}.get(str(name)[0], "1"),
                    "mean": flat.mean(0),
                    "sd": flat.std(0),
                    "median": median,
                    "eti50_low": quarter,
                    "eti50_high": three_quarters,
                    "eti90_low": low,
                    "eti90_high": high,
                    "ess_bulk": 1000.0,
                    "ess_tail": 900.0,
                    "r_hat": 1.001,
                    "mcse_mean": flat.std(0) / np.sqrt(1000),
                }
            )
        )
    return pd.concat(rows)


def _hypotheses(tree: xr.DataTree) -> pd.DataFrame:
    rows = []
    for q in ("K", "C"):
        beta = tree[f"posterior/mass_exponent_{q}"].to_numpy().ravel()
        inside = {value: float(np.mean(np.abs(beta - value) < 0.1)) for value in (0.0, 1.0)}
        rows += [
            (q, "fixed stiffness", 0.0, -0.1, 0.1, inside[0.0]),
            (q, "constant natural frequency", 1.0, 0.9, 1.1, inside[1.0]),
            (q, "between", "", 0.1, 0.9, float(np.mean((beta > 0.1) & (beta < 0.9)))),
            (q, "outside", "", "", "", float(np.mean((beta < -0.1) | (beta > 1.1)))),
        ]
    return pd.DataFrame(
        rows, columns=["quantity", "hypothesis", "value", "rope_low", "rope_high", "probability"]
    )


def _tables() -> dict[str, pd.DataFrame]:
    reproduction = pd.DataFrame(
        [
            ("5.10", 2, "K average, trial 8", "11.859", 11.8594, True, ""),
            ("5.10", 5, "K sd, trial 17", "1.977", 0.6292, False, "equals the printed range"),
            ("5.14", 11, "correlation of K with Skin Fold", "-0.191", "", "", "never tabulated"),
        ],
        columns=["table", "row", "quantity", "published", "reproduced", "agrees", "note"],
    )
    audit = pd.DataFrame(
        [
            (
                "Tables 5.2-5.9",
                "K against the mass of the impactor",
                "K free",
                "CV 1.4 %",
                "major",
                "K/M is constant.",
            ),
            ("Tables 5.2-5.9", "energy <is> not ½MV²", "0.75 J", "0.57 J", "major", "They do not agree."),
            ("Chapter 5", "implied penetration", "5 mm", "254 mm", "major", "Deeper than an arm is thick."),
            ("Table 5.10", "sd equals range", "1.977", "0.629", "minor", "A slip."),
            ("Section 6.2", "digits", ".0122", "0.121", "note", "A misplaced point."),
        ],
        columns=["where", "what", "published", "implied", "severity", "explanation"],
    )
    schemes, models = ("leave one impact out", "leave one trial out"), ("log mass", "mass", "energy", "none")
    comparison = pd.DataFrame(
        [
            (
                s,
                m,
                100.0 - 20 * i,
                8.0,
                -20.0 * i,
                4.0 * (i > 0),
                9.0,
                float(i == 0),
                "high Pareto k" * (i == 3),
            )
            for s in schemes
            for i, m in enumerate(models)
        ],
        columns=[
            *("scheme", "model", "elpd", "se", "elpd_difference", "se_difference"),
            *("p_effective", "weight", "warning"),
        ],
    )
    sensitivity = pd.DataFrame(
        [
            ("mass_exponent_K", 0.01, 0.2, "✓"),
            ("mass_exponent_C", 0.02, 0.12, "✓"),
            ("sd_trial_K", 0.12, 0.2, "potential prior-data conflict"),
        ],
        columns=["variable", "prior", "likelihood", "diagnosis"],
    )
    checks = pd.DataFrame(
        [
            ("smallest", "K", 8.8, 8.9, 8.5, 9.2, 0.4),
            ("largest sd within a condition", "C", 1.0, 0.9, 0.6, 1.5, 0.01),
        ],
        columns=[
            *("statistic", "quantity", "observed"),
            *("predicted_median", "predicted_low", "predicted_high", "p_value"),
        ],
    )
    return {
        "reproduction": reproduction,
        "audit": audit,
        "comparison": comparison,
        "sensitivity": sensitivity,
        "predictive_checks": checks,
    }


def _diagnostics(passed: bool) -> dict[str, object]:
    worst = 1.003 if passed else 1.4
    return {
        "passed": passed,
        "checks": [
            {
                "name": "largest R-hat",
                "value": worst,
                "limit": 1.01,
                "passed": passed,
                "meaning": "the chains tell the same story",
                "next_step": "" if passed else "Draw longer chains.",
            }
        ],
        "worst": {"r_hat": worst},
    }


def _run(passed: bool) -> dict[str, object]:
    return {
        "program": "bayestissue",
        "format": FORMAT,
        "command": "reproduce",
        "kind": "published",
        "versions": {"python": "3.12", "numpy": "2.3"},
        "model": {
            "name": "published",
            "description": "A made-up model.",
            "reference_mass_kg": 0.75,
            "formula": {"K": "log(mass_kg) + (1|subject)", "C": "log(mass_kg)"},
            "residual_correlation": True,
            "priors": {
                "mass_exponent": {
                    "K": {"distribution": "normal", "mean": 0.5, "sd": 1.0},
                    "C": {"distribution": "normal", "mean": 0.5, "sd": 1.0},
                },
                "residual_correlation": {"distribution": "lkj", "concentration": 2.0},
            },
            "sampler": {"chains": 4, "effective": 400},
        },
        "seed": 0,
        "input_hash": "0123456789abcdef",
        "wall_time_s": 61.5,
        "started": "2026-01-01T00:00:00+00:00",
        "verdict": {
            "passed": passed,
            "words": "All checks of the sampler passed." if passed else "R-hat is 1.4: the chains disagree.",
        },
    }
