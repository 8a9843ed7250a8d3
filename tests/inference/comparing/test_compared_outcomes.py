"""Runs side by side in outcomes of the reference impact, against spring and damper."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.testing import assert_allclose

from bayestissue.inference.answers.law import Law
from bayestissue.inference.answers.predictions import predict
from bayestissue.inference.answers.questions import ask_what_can_be, numbered
from bayestissue.inference.answers.study import Study
from bayestissue.inference.model_comparison import posteriors_by_run, same_questions
from bayestissue.model.hierarchy.recorded import Recorded
from bayestissue.reports.pages.comparison import outcome_figures
from designs import REFERENCE, impacts, normal_draws

V = 1.5
SHAPE = (2, 300)
EFFECTS = {"s0": -0.3, "s1": 0.0, "s2": 0.1, "s3": 0.2}
ENDS = ["eti90_low", "median", "eti90_high"]


def run(name: str, log_K: float, mass: float = REFERENCE, *, discrepancy: bool = False) -> Study:
    rows = impacts().assign(velocity_m_s=V).drop(columns="impact")
    values = {"intercept_K": log_K, "intercept_C": 3.0, "subject_effect_K": list(EFFECTS.values())}
    people = {"subject_effect_K": ("subject", list(EFFECTS))}
    posterior = normal_draws(len(name), 0.02, values, SHAPE, **people)
    spread = xr.full_like(posterior["intercept_K"], 0.1)
    posterior = posterior.assign(sd_subject_K=2 * spread, sd_impact_K=spread, sd_impact_C=spread)
    recorded = Recorded(rows, {"K": "(1|subject)", "C": "1"}, mass)
    return Study(posterior, recorded, Law(described=not discrepancy))


def runs(**further: bool) -> dict[str, Study]:
    return {"soft": run("soft", 7.5), "stiffer": run("stiffer", 8.0, **further)}


def depth(run: Study, person: str = "") -> np.ndarray:
    log_K = run.draws["intercept_K"]
    if person:
        log_K = log_K + run.draws["subject_effect_K"].sel(subject=person)
    omega = np.sqrt(np.exp(log_K) / REFERENCE)
    zeta = np.exp(run.draws["intercept_C"]) / (2 * REFERENCE * omega)
    phi = np.arccos(zeta)
    return V / omega * np.exp(-zeta * phi / np.sin(phi))


def test_outcomes_of_a_typical_and_of_each_person_stand_side_by_side() -> None:
    table = posteriors_by_run(runs()).set_index(["variable", "label", "run"])
    for name, one in runs().items():
        typical = table.loc["peak_depth_typical_person", "", name]
        assert_allclose(typical[ENDS].astype(float), np.percentile(depth(one), [5, 50, 95]))
        assert typical["of"] == "a typical person at the reference impact"
        assert typical["unit"] == "m"
        own = table.loc["peak_depth_subject", "s2", name]
        assert_allclose(own[ENDS].astype(float), np.percentile(depth(one, "s2"), [5, 50, 95]))
    alone = posteriors_by_run({"soft": run("soft", 7.5, discrepancy=True)})
    assert not alone["variable"].str.startswith("peak").any()


def test_outcomes_of_a_new_person_hold_how_people_and_impacts_differ() -> None:
    one = run("soft", 7.5)
    table = posteriors_by_run({"soft": one}).set_index("variable")
    row = table.loc["peak_depth_new"]
    assert row["of"] == "a new impact on a new person at the reference impact"
    # One route: what `predict` says of an impact of which nothing is given.
    column = "peak_displacement_m"
    told = predict(one, [{}]).iloc[0][[f"{column}_low", column, f"{column}_high"]]
    assert_allclose(row[ENDS].astype(float), told.astype(float))
    figure, *_ = outcome_figures(posteriors_by_run(runs()))
    assert list(figure.data["label"].drop_duplicates()) == ["typical", "new", *EFFECTS]


def test_a_run_without_an_answer_has_no_row() -> None:
    asked = {
        name: {"asked": ask_what_can_be(one, numbered(["peak_depth"]))}
        for name, one in runs(discrepancy=True).items()
    }
    assert asked["stiffer"]["asked"]["note"].str.contains("no answer").all()
    assert set(same_questions(asked)["run"]) == {"soft"}
