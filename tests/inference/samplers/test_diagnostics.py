from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from bayestissue.inference.checking.findings import (
    CONTRADICTED,
    ELEMENT_ALONE,
    NO_INTERVAL,
    Finding,
    headline,
    noted,
    verdict_in_words,
    warnings,
)
from bayestissue.inference.checking.model_form import marked_rows, stated
from bayestissue.inference.results.summary import UNSETTLED, diagnose, summarise

CHAINS, DRAWS = 4, 1000


def run(apart: float = 0.0) -> xr.DataTree:
    """Independent draws, as a perfect sampler would make them; of the second the first chain is elsewhere."""
    good, planted = np.random.default_rng(0).standard_normal((2, CHAINS, DRAWS))
    planted[0] += apart
    dims = ("chain", "draw")
    posterior = xr.Dataset({"good": (dims, good), "planted": (dims, planted)})
    return xr.DataTree.from_dict({"posterior": posterior})


def diagnosed(tree: xr.DataTree) -> dict[str, Any]:
    return diagnose(summarise(tree["posterior"].dataset))


def test_independent_draws_pass() -> None:
    found = diagnosed(run())
    assert found["passed"]
    assert verdict_in_words(found).startswith("R-hat at most 1.0")
    assert {"r_hat", "ess_bulk", "ess_tail"} == set(found["worst"])


def test_a_chain_elsewhere_is_named() -> None:
    found = diagnosed(run(3.0))
    assert "R-hat" in [check["name"] for check in found["checks"] if not check["passed"]]
    assert not found["passed"]
    assert found["worst"]["r_hat"]["variable"] == "planted"
    assert found["worst"]["ess_bulk"]["variable"] == "planted"
    assert "Do not use these numbers" in verdict_in_words(found)


def test_what_nobody_asked_for_fails_no_fit_and_its_row_says_so() -> None:
    summary = summarise(run(3.0)["posterior"].dataset)
    found = diagnose(summary, unasked=["planted"])
    assert found["passed"]
    assert found["unsettled"] == ["planted"]
    assert found["worst"]["r_hat"]["variable"] == "good"
    assert noted(summary, found)["note"].tolist() == ["", UNSETTLED]
    # What is asked for is judged, and what has settled is judged either way.
    assert not diagnose(summary, unasked=["good"])["passed"]
    sound = summarise(run()["posterior"].dataset)
    assert diagnose(sound, unasked=["planted"]) == diagnose(sound)


def test_the_verdict_names_what_holds_the_chains_up() -> None:
    impacts = np.random.default_rng(1).standard_normal((CHAINS, DRAWS, 3))
    impacts[0, :, 1] += 3.0
    of_each = (("chain", "draw", "impact"), impacts)
    posterior = run()["posterior"].dataset.assign(K=of_each).assign_coords(impact=["a", "spoilt", "c"])
    found = diagnose(summarise(posterior), of_impacts=["K"])
    assert "Impact spoilt holds the chains up: K of spoilt has an R-hat of 1." in verdict_in_words(found)
    assert "reason may be" not in verdict_in_words(found)
    assert "The reason may be what the warning says. WARNING: The chain." in verdict_in_words(
        found | contradicted(["a"], 2)
    )
    assert "planted holds the chains up: R-hat 1." in verdict_in_words(diagnosed(run(3.0)))
    assert not diagnosed(run())["cause"]


def contradicted(impacts: list[str], of: int) -> dict[str, Any]:
    rows = ".*" if len(impacts) == of else impacts
    first = "the traces contradict the measuring chain"
    return {"measuring_chain": Finding("measuring-chain", False, "The chain.", first, rows).record()}


def test_a_contradicted_chain_comes_first_and_the_sampler_s_verdict_does_not_stand_alone() -> None:
    form = {"model_form": Finding("model-form", passed=False, words="The form.").record()}
    found = diagnosed(run()) | contradicted(["a"], 2) | form
    assert found["passed"]
    assert warnings(found) == ["The chain.", "The form."]
    assert verdict_in_words(found).endswith(". WARNING: The chain. WARNING: The form.")
    assert headline(found) == "The sampler passed, but the traces contradict the measuring chain."
    assert headline(diagnosed(run()) | {"measuring_chain": {"passed": None}}) == "Diagnostics passed."


def test_no_element_at_all_is_said_before_anything_but_a_failed_sampler() -> None:
    form = {"model_form": stated({"score": 9.0, "undescribed": True, "discrepancy": 0.3})}
    found = diagnosed(run()) | contradicted(["a"], 2) | form
    assert "No element of this program describes these traces" in headline(found)
    assert headline(found | {"passed": False}).startswith("DIAGNOSTICS FAILED")


def test_structure_in_some_impacts_is_a_warning_and_its_code_their_own() -> None:
    impacts = {"structured": True, "tested": 9, "below": 2, "names": ["a", "b"]}
    form = {"score": 0.3, "structured": False, "impacts": impacts}
    found = diagnosed(run()) | {"model_form": stated(form)}
    assert [warning.code for warning in warnings(found)] == ["structured-residuals"]
    assert "2 of 9 impacts" in warnings(found)[0]
    assert "structure that the model does not explain" in headline(found)
    sound = stated(form | {"impacts": impacts | {"structured": False}})
    assert warnings(diagnosed(run()) | {"model_form": sound}) == []


def test_rows_of_the_summary_say_where_an_interval_is_none() -> None:
    table = pd.DataFrame({"variable": ["K", "K", "intercept_K"], "label": ["a", "b", ""]})
    assert noted(table, {})["note"].tolist() == ["", "", ""]
    assert noted(table, contradicted(["b"], 2))["note"].tolist() == ["", CONTRADICTED, ""]
    assert noted(table, contradicted(["a", "b"], 2))["note"].tolist() == [CONTRADICTED] * 3
    form = {"discrepancy": 0.1, "undescribed": False, "undescribed_impacts": ["a"]}
    notes = noted(table, {"rows": marked_rows(form)})["note"].tolist()
    assert notes == [NO_INTERVAL, ELEMENT_ALONE, ELEMENT_ALONE]
    every = form | {"undescribed": True, "undescribed_impacts": []}
    assert noted(table, {"rows": marked_rows(every)})["note"].tolist() == [NO_INTERVAL] * 3


def test_beside_a_discrepancy_rows_of_k_say_that_it_is_the_element_s_own() -> None:
    of_element = ["K", "K_subject", "K_new", "K_tangent", "intercept_K", "mass_exponent_K", "sd_trial_K"]
    of_element += ["subject_effect_K", "effect_of_side[right]_K"]
    others = ["C", "mass_exponent_C", "K_secant", "K_secant_of_subject", "K_common_depth", "omega_n"]
    others += ["mass_exponent_K_secant", "mass_exponent_K_common_depth", "discrepancy"]
    table = pd.DataFrame({"variable": [*of_element, *others], "label": "a"})
    form = {"discrepancy": 0.05, "undescribed": False, "undescribed_impacts": []}
    notes = noted(table, {"rows": marked_rows(form)})["note"].tolist()
    assert notes == [ELEMENT_ALONE] * len(of_element) + [""] * len(others)
    assert noted(table, {"rows": marked_rows({"score": 1.0})})["note"].eq("").all()
