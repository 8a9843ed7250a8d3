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
from designs import REFERENCE, impacts

V = 1.5
SHAPE = (2, 300)
SD_SUBJECT, SD_IMPACT = 0.2, 0.1
EFFECTS = {"s0": -0.3, "s1": 0.0, "s2": 0.1, "s3": 0.2}
ENDS = ["eti90_low", "median", "eti90_high"]


def run(name: str, log_K: float, mass: float = REFERENCE, *, discrepancy: bool = False) -> Study:
    rows = impacts().assign(velocity_m_s=V).drop(columns="impact")
    rng = np.random.default_rng(len(name))
    effects = np.array(list(EFFECTS.values())) + 0.01 * rng.standard_normal((*SHAPE, 4))
    posterior = xr.Dataset(
        {
            "intercept_K": (("chain", "draw"), log_K + 0.05 * rng.standard_normal(SHAPE)),
            "intercept_C": (("chain", "draw"), 3 + 0.05 * rng.standard_normal(SHAPE)),
            "subject_effect_K": (("chain", "draw", "subject"), effects),
            "sd_subject_K": (("chain", "draw"), np.full(SHAPE, SD_SUBJECT)),
            **{f"sd_impact_{q}": (("chain", "draw"), np.full(SHAPE, SD_IMPACT)) for q in "KC"},
        },
        {"subject": list(EFFECTS), "chain": np.arange(SHAPE[0]), "draw": np.arange(SHAPE[1])},
    )
    recorded = Recorded(rows, {"K": "(1|subject)", "C": "1"}, mass)
    return Study(posterior, recorded, Law(described=not discrepancy))


def runs(**further: bool) -> dict[str, Study]:
    return {"soft": run("soft", 7.5), "stiffer": run("stiffer", 8.0, **further)}


def depth(run: Study, person: str = "") -> np.ndarray:
    posterior = run.draws
    log_K = posterior["intercept_K"]
    if person:
        log_K = log_K + posterior["subject_effect_K"].sel(subject=person)
    return depth_of(log_K.to_numpy(), posterior["intercept_C"].to_numpy())


def depth_of(log_K: np.ndarray, log_C: np.ndarray) -> np.ndarray:
    omega = np.sqrt(np.exp(log_K) / REFERENCE)
    zeta = np.exp(log_C) / (2 * REFERENCE * omega)
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
    rng, count = np.random.default_rng(5), 100_000
    log_K = 7.5 + np.sqrt(0.05**2 + SD_SUBJECT**2 + SD_IMPACT**2) * rng.standard_normal(count)
    log_C = 3 + np.hypot(0.05, SD_IMPACT) * rng.standard_normal(count)
    true, p = depth_of(log_K, log_C), np.array([0.05, 0.5, 0.95])
    shares = [(true < end).mean() for end in row[ENDS].astype(float)]
    draws = SHAPE[0] * SHAPE[1]
    assert (np.abs(shares - p) < 4 * np.sqrt(p * (1 - p) / draws)).all()


def test_the_same_questions_are_answered_by_each_run() -> None:
    limit = float(np.median(depth(runs()["stiffer"])))
    claim, number = f"peak_depth < {limit}", "peak_depth[subject=s2]"
    best = "best(subject, lowest peak_depth)"
    asked = numbered([claim, number, best])
    answers = same_questions({name: {"asked": ask_what_can_be(one, asked)} for name, one in runs().items()})
    of = answers.set_index(["question", "run"])
    for name, one in runs().items():
        assert of.loc[(claim, name), "value"] == (depth(one) < limit).mean()
        low, median, high = np.percentile(depth(one, "s2"), [5, 50, 95])
        assert_allclose(of.loc[(number, name), ["low", "value", "high"]].astype(float), [low, median, high])
        chosen = answers[answers["question"].str.startswith("best(") & (answers["run"] == name)]
        assert_allclose(chosen["value"].sum(), 1.0)
        assert len(chosen) == len(EFFECTS)


def test_a_run_without_an_answer_has_no_row() -> None:
    asked = {
        name: {"asked": ask_what_can_be(one, numbered(["peak_depth"]))}
        for name, one in runs(discrepancy=True).items()
    }
    assert asked["stiffer"]["asked"]["note"].str.contains("no answer").all()
    assert set(same_questions(asked)["run"]) == {"soft"}
