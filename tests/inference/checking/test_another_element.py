"""Whether a stiffening spring is tried before a discrepancy: where the law fails at some levels alone."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from bayestissue.base.resources import shared
from bayestissue.inference.checking import model_form
from bayestissue.inference.checking.findings import Finding
from bayestissue.model.hierarchy.recorded import Recorded
from bayestissue.model.hierarchy.specification import read_specification

PADS = np.repeat(["A", "B", "C"], 4)
NAMES = np.array([f"i{number}" for number in range(len(PADS))])


def recorded(formula: str = "pad") -> Recorded:
    rows = pd.DataFrame({"subject": "tower", "trial": "t", "mass_kg": 5.0, "pad": PADS})
    return Recorded(rows, {"K": formula, "C": "1"}, 5.0)


def form(**of_pads: float) -> dict:
    p = {name: of_pads.get(pad, 0.5) for name, pad in zip(NAMES, PADS, strict=True)}
    return {"score": 31.4, "structured": True, "impacts": {"p": p}}


def test_where_the_law_fails_at_some_levels_the_depth_is_by_these() -> None:
    told = model_form.instead(form(C=1e-6), NAMES, recorded())
    assert told["formula"] == "pad"
    assert (told["instead_of"], told["score_without"]) == ("kelvin_voigt", 31.4)
    assert "a linear spring does not describe pad C (31.4 standard" in told["words"]
    model = read_specification(shared("models", "impact.toml"))
    stiffens = model_form.stiffening_by(model, told["formula"])
    assert stiffens is not None
    assert stiffens.element == "stiffening"
    assert stiffens.formula.further == ("stiffening_depth_m",)
    assert stiffens.formula.K is None
    assert stiffens.priors.intercept.K == model.priors.intercept.K
    assert model_form.stiffening_by(read_specification(shared("models", "wall.toml")), "pad") is None


@pytest.mark.parametrize(
    ("fails", "formula"), [({}, "pad"), ({"A": 0.0, "B": 0.0, "C": 0.0}, "pad"), ({"C": 0.0}, "1")]
)
def test_nothing_is_tried_where_it_fails_nowhere_or_everywhere_or_no_formula_has_levels(fails, formula):
    assert model_form.instead(form(**fails), NAMES, recorded(formula)) == {}


@pytest.mark.parametrize(
    ("changed", "explains"),
    [
        ({}, True),
        ({"passed": False}, False),
        ({"model_form": Finding("model-form", passed=False).record()}, False),
        ({"model_form": Finding("structured-residuals", passed=False).record()}, False),
        ({"pooled_parameters": [Finding("pooled-parameter", passed=False).record()]}, False),
    ],
)
def test_a_spring_that_leaves_doubt_is_not_taken(changed: dict, explains: bool) -> None:
    sound = {"passed": True, "model_form": {"structured": False}, "pooled_parameters": []}
    assert model_form.explains(sound | changed) == explains
