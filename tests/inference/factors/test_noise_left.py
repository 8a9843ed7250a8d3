"""The residuals of what the model made, and of what it did not."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

import bayestissue as bt
from bayestissue.inference.checking.model_form import SMALL_P, stated, with_impacts
from bayestissue.inference.points.notes import STRUCTURED
from campaigns import simulated, spreads

pytestmark = pytest.mark.slow

CHAIN = {
    "relative_mass_sd": 0.005,
    "velocity_sd_m_s": 0.0075,
    "relative_gain_sd": 0.005,
    "offset_sd_m_s2": 0.2,
}
FORM = stated({"score": 0.3, "structured": False})
SOUND = FORM["words"]


def estimated(impacts: int, tissue: dict, recording: dict) -> pd.DataFrame:
    chain = {"noise_relative_to_peak": 0.005, "sampling_rate_hz": 5000.0, **recording}
    return bt.estimate(simulated(spreads(impact=0.2) | tissue, chain, people=impacts, seed=1).dataset("made"))


@pytest.mark.parametrize(
    ("impacts", "chain"),
    [
        pytest.param(1000, CHAIN, marks=pytest.mark.long, id="errors as declared"),
        pytest.param(400, CHAIN, id="fewer"),
    ],
)
def test_of_a_hundred_sound_impacts_one_looks_structured(impacts: int, chain: dict) -> None:
    """The trace's own errors of the chain, and what was fitted to it, are no structure."""
    p = estimated(impacts, {}, chain)["whiteness_p"].to_numpy()
    assert np.isfinite(p).all()
    standard_error = np.sqrt(0.015 * 0.985 / len(p))
    assert (p < SMALL_P).mean() <= 0.015 + standard_error
    assert (p < 0.5).mean() == pytest.approx(0.5, abs=4 * np.sqrt(0.25 / len(p)))
    verdicts = [
        with_impacts(FORM, [str(name) for name in range(20)], part)["words"] for part in p.reshape(-1, 20)
    ]
    assert sum(words.startswith("Nothing against the model") for words in verdicts) >= 0.95 * len(verdicts)


def test_a_stiffening_tissue_is_structure_in_every_impact() -> None:
    tissue = {"element": "stiffening", "parameters": {"stiffening_depth_m": 0.02}}
    table = estimated(40, tissue, CHAIN)
    p = table["whiteness_p"].to_numpy()
    assert (p < 0.001).all()
    assert table["flags"].str.contains(STRUCTURED).all()
    found = with_impacts(FORM, [f"i{k}" for k in range(40)], p)
    assert found["impacts"]["structured"]
    assert found["impacts"]["below"] == 40
    assert "structure that the model does not explain: 40 of 40 impacts" in found["words"]


def test_a_verdict_of_few_counts_on_chance() -> None:
    names = [f"i{k}" for k in range(10)]
    p = np.full(10, 0.4)
    assert not with_impacts(FORM, names, p)["impacts"]["structured"]
    p[0] = 0.005
    found = with_impacts(FORM, names, p)
    assert (found["impacts"]["below"], found["impacts"]["structured"]) == (1, False)
    assert found["words"].endswith(SOUND)
    p[0] = 1e-5
    found = with_impacts(FORM, names, p)
    assert found["impacts"]["names"] == ["i0"]
    assert "(i0)" in found["words"]
    # What is said of another law stands; too short a trace is not counted.
    law = FORM | {"structured": True}
    p[1] = np.nan
    found = with_impacts(law, names, p)
    assert (found["words"], found["impacts"]["tested"]) == (stated(FORM | {"structured": True})["words"], 9)
    assert not with_impacts(FORM, names, np.full(10, np.nan))["impacts"]["structured"]


def test_what_is_slight_in_every_impact_shows_in_all_of_them_together() -> None:
    """Against Fisher's own example: p of 0.145, 0.263 and 0.087 come to 0.076 together."""
    found = with_impacts(FORM, ["a", "b", "c"], np.array([0.145, 0.263, 0.087]), together=True)["impacts"]
    assert found["combined"] == pytest.approx(0.076, abs=0.0005)
    names, p = [f"i{k}" for k in range(20)], np.full(20, 0.15)
    assert not with_impacts(FORM, names, p)["impacts"]["structured"]
    assert with_impacts(FORM, names, p, together=True)["impacts"]["structured"]
    none = with_impacts(FORM, names, np.full(20, np.nan), together=True)["impacts"]
    assert (none["structured"], none["combined"]) == (False, 1.0)
    assert with_impacts(FORM, names, np.append(p[1:], 0.0), together=True)["impacts"]["structured"]
