"""Fits that differ from the stored one in what a page says of it."""

from __future__ import annotations

import numpy as np
import pandas as pd
import xarray as xr

from bayestissue import Fit
from bayestissue.inference.checking.findings import Finding, headline
from bayestissue.inference.checking.model_form import stated
from make_fit_run import CHAINS, DRAWS, PEOPLE, changed, with_draws


def contradicted(run: Fit) -> Fit:
    words, first = "They ask for a velocity 11 % higher.", "the traces contradict the measuring chain"
    chain = Finding("measuring-chain", False, words, first).record(impacts=[], of=12)
    return with_headline(changed(run, diagnostics={"measuring_chain": chain}))


def undescribed(run: Fit) -> Fit:
    form = stated({"score": 9.0, "undescribed": True, "discrepancy": 0.3})
    return with_headline(changed(run, diagnostics={"model_form": form}))


def with_headline(run: Fit) -> Fit:
    return changed(run, record={"verdict": {"headline": headline(run.diagnostics), "warned": True}})


def at_no_common_depth(run: Fit) -> Fit:
    drawn = run.posterior["posterior"].to_dataset()
    return changed(run, groups={"posterior": drawn.drop_vars("mass_exponent_K_common_depth")})


def interaction(run: Fit) -> Fit:
    """A ratio of ratios, and a column that goes with the sides."""
    of = {"factor": "group:session", "level": "treated:after/before", "against": "control:after/before"}
    of |= {"ratio": 1.22, "low": 1.1, "high": 1.35, "p_direction": 0.98, "p_equivalent": 0.12}
    further = pd.DataFrame([of | {"quantity": q, "kind": "interaction", "note": ""} for q in "KC"])
    noted = run.contrasts.assign(note="also differs: pad (p1 against p2)")
    return changed(run, contrasts=pd.concat([noted, further], ignore_index=True))


def third_level(run: Fit) -> Fit:
    """A side on which all is twice as large as on the left."""
    twice = run.levels[run.levels["level"] == "left"].assign(level="middle")
    twice[["median", "low", "high"]] *= 2
    against = [run.contrasts.assign(level=level, against="middle") for level in ("left", "right")]
    return changed(
        run,
        levels=pd.concat([run.levels, twice], ignore_index=True),
        contrasts=pd.concat([*against, run.contrasts], ignore_index=True),
    )


def largely_prior(run: Fit) -> Fit:
    rows = run.reliability
    agreement = rows["form"].str.startswith(("ICC(A,1", "agreement")) & (rows["quantity"] == "K")
    return changed(run, reliability=rows.assign(prior_overlap=np.where(agreement, 0.62, 0.2)))


def other_noise(run: Fit) -> Fit:
    """Noise that neighbours share, by a fit that has tested none; and theta1 near its edge."""
    observed = run.posterior["observed_data"].to_dataset()
    value = observed["deceleration"]
    white = np.random.default_rng(1).standard_normal((len(value), value.shape[1] + 3)).cumsum(axis=1)
    observed["deceleration"] = value + white[:, 3:] - np.pad(white, ((0, 0), (1, 0)))[:, :-4]
    run = with_draws(run, {"theta1": xr.full_like(run.posterior["posterior"]["K"], -0.9991)})
    return changed(run, groups={"observed_data": observed})


def own_exponents(run: Fit) -> Fit:
    """Effects of people's sides, a third parameter, and mass exponents of each person."""
    rng, shape = np.random.default_rng(3), (CHAINS, DRAWS)
    drawn = run.posterior["posterior"].to_dataset()
    sides = [f"s{person}:{side}" for person in range(PEOPLE) for side in ("left", "right")]
    effect = ("chain", "draw", "subject:side"), 0.1 * rng.standard_normal((*shape, len(sides)))
    of_people = xr.zeros_like(drawn["subject_effect_K"])
    own = of_people + 0.3 * np.linspace(-1, 1, PEOPLE) + 0.05 * rng.standard_normal((*shape, PEOPLE))
    sd = 0.3 + 0 * drawn["sd_subject_K"]
    moved = {
        "subject_mass_exponent_K": drawn["mass_exponent_K"] + own,
        "sd_subject_mass_exponent_K": sd,
        "subject_side_effect_K": xr.DataArray(effect[1], {"subject:side": sides}, effect[0]),
        "K_subject_side": xr.DataArray(2500 * np.exp(effect[1]), {"subject:side": sides}, effect[0]),
        "sd_subject_side_K": sd,
        "subject_effect_thickness_m": drawn["subject_effect_K"],
        "sd_subject_thickness_m": sd,
        "log_thickness_m_mean": drawn["intercept_K"],
        "subject_mass_exponent_thickness_m": own,
        "sd_subject_mass_exponent_thickness_m": sd,
        "thickness_m_subject": drawn["K_subject"].assign_attrs(unit="m"),
    }
    formula = {"K": "1", "C": "1", "thickness_m": "(log(mass_kg)|subject)"}
    return changed(with_draws(run, moved), record={"model": {"formula": formula}})


def of_many(run: Fit) -> Fit:
    """As a fit of many impacts is kept: draws of single ones along kept_draw, a third of them predicted."""
    kept, groups = (
        range(0, DRAWS, 20),
        {name: part.to_dataset() for name, part in run.posterior.children.items()},
    )
    drawn = groups["posterior"]
    single = [name for name, array in drawn.data_vars.items() if "impact" in array.dims]
    few = drawn[single].isel(draw=kept).rename(draw="kept_draw").assign_coords(kept_draw=kept)
    groups["posterior"] = drawn.drop_vars(single).drop_dims("impact", errors="ignore").merge(few)
    for name in ("posterior_predictive", "observed_data"):
        groups[name] = groups[name].isel(impact=slice(0, None, 3))
    unknown = run.summary["variable"].isin(single).to_numpy()
    ends = {name: run.summary[name].mask(unknown) for name in ("ess_bulk", "ess_tail", "r_hat")}
    return changed(
        run,
        groups=groups,
        summary=run.summary.assign(**ends),
        record={"kept_draws_of_an_impact": 2 * len(kept)},
    )


FALL = {"mass_kg": 5.0, "velocity_m_s": 0.93}


# Of heel pads: what each drop came to, and what Kinoshita et al. found.
OWN = {"peak_deceleration": 9.0, "peak_depth": 0.0113, "energy_share_with_gravity": 0.2}


def of_displacement(run: Fit) -> Fit:
    """A displacement that was recorded, with replicates as exact as its samples."""
    replicates = run.posterior["posterior_predictive"].to_dataset()
    depth = run.posterior["observed_data"]["displacement"].to_dataset(name="displacement")
    replicates["displacement"] = depth["displacement"] + 1e-6 * replicates["deceleration"]
    return changed(run, groups={"posterior_predictive": replicates}, record={"quantity": "displacement"})


def heavy_drops(run: Fit, motion: dict[str, float] = FALL) -> Fit:
    constants, drawn = (run.posterior[name].to_dataset() for name in ("constant_data", "posterior"))
    for name, value in motion.items():
        constants[name] = 0 * constants[name] + value
    moved = {name: xr.full_like(drawn["K"], value) for name, value in OWN.items()}
    return changed(with_draws(run, moved), groups={"constant_data": constants})
