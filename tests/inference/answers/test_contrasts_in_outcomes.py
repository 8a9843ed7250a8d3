"""Comparisons in what an impact comes to, against closed forms of spring and damper."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from numpy.testing import assert_allclose

from bayestissue.base.outcome_table import REFERENCE_OUTCOMES
from bayestissue.inference.answers import contrasts as contrasts_module
from bayestissue.inference.answers import study
from bayestissue.inference.answers.integration import SETTINGS
from bayestissue.inference.answers.law import Law
from bayestissue.inference.answers.questions import ask, numbered
from bayestissue.inference.answers.study import Study
from bayestissue.model.hierarchy.recorded import Recorded
from designs import REFERENCE, contrasts, impacts, normal_draws

V = 1.5
LAW = Law("kelvin_voigt", 0.0)


def recorded(**formulas: str) -> Recorded:
    rows = impacts().assign(velocity_m_s=V).drop(columns="impact")
    return Recorded(rows, formulas, REFERENCE)


def draws_of(seed: int, values: dict[str, float], sd: float = 0.05) -> xr.Dataset:
    return normal_draws(seed, sd, values, (2, 300))


def closed_forms(K: np.ndarray, C: np.ndarray, M: float) -> dict[str, np.ndarray]:
    """Of a damping ratio below 1/2, where the greatest force is after contact."""
    omega = np.sqrt(K / M)
    zeta = C / (2 * M * omega)
    assert (zeta < 0.5).all()
    phi = np.arccos(zeta)
    peak = phi / (omega * np.sin(phi))
    return {
        "peak_force": M * omega * V * np.exp(-zeta * (3 * phi - np.pi) / np.sin(phi)),
        "peak_depth": V / omega * np.exp(-zeta * omega * peak),
        "energy_absorbed": M * V**2 / 2 * (1 - np.exp(-4 * zeta * omega * peak)),
    }


SIDES = {"intercept_K": 8.0, "intercept_C": 3.0, "effect_of_side[right]_K": -0.3}


def test_levels_are_compared_in_outcomes_of_the_reference_impact_after_k_and_c() -> None:
    draws, of = draws_of(1, SIDES | {"effect_of_side[right]_C": 0.2}), recorded(K="side", C="side")
    plain = contrasts(draws, of, ["K", "C"], 0.1)
    table = contrasts(draws, of, ["K", "C"], 0.1, law=LAW)
    pd.testing.assert_frame_equal(table[: len(plain)], plain)
    outcome = table[len(plain) :].set_index("quantity")
    assert list(outcome.index) == list(REFERENCE_OUTCOMES)
    assert set(zip(outcome["level"], outcome["against"], strict=True)) == {("left", "right")}
    assert_allclose(outcome[["mass_kg", "velocity_m_s"]], np.tile([REFERENCE, V], (3, 1)))
    logs = [(draws[f"intercept_{q}"], draws[f"effect_of_side[right]_{q}"]) for q in "KC"]
    K, C = ([np.exp(left).to_numpy(), np.exp(left + effect).to_numpy()] for left, effect in logs)
    left, right = map(closed_forms, K, C, [REFERENCE] * 2)
    for name, row in outcome.iterrows():
        ratio = left[name] / right[name]
        assert_allclose([row["low"], row["ratio"], row["high"]], np.percentile(ratio, [5, 50, 95]))
        assert row["p_direction"] == max((ratio > 1).mean(), (ratio < 1).mean())
        assert row["p_equivalent"] == (abs(np.log(ratio)) < np.log(1.1)).mean()
        # As a question has it.
        asked = ask(Study(draws, of), numbered([f"{name}[side=left] / {name}[side=right]"])).iloc[0]
        assert_allclose([asked["low"], asked["median"], asked["high"]], np.percentile(ratio, [5, 50, 95]))


def test_what_any_formula_compares_is_compared_in_outcomes_once() -> None:
    values = SIDES | {"intercept_C": 2.5, "effect_of_operator[y]_C": 0.5, "effect_of_side[right]_C": 0.1}
    values |= {"effect_of_side[right]:operator[y]_C": 0.4}
    draws, of = draws_of(2, values, sd=0.0), recorded(K="side", C="side*operator")
    table = contrasts(draws, of, ["K", "C"], 0.1, law=LAW)
    force = table[table["quantity"] == "peak_force"]
    assert sorted(force["factor"]) == ["operator", "side", "side:operator"]
    K = {"left": 8.0, "right": 7.7}
    # The first row has operator y.
    C = {("left", "x"): 2.0, ("left", "y"): 2.5, ("right", "x"): 2.1, ("right", "y"): 3.0}
    F = {
        at: float(closed_forms(np.exp([K[at[0]]]), np.exp([c]), REFERENCE)["peak_force"][0])
        for at, c in C.items()
    }
    row = force[force["kind"] == "interaction"].iloc[0]
    assert (row["level"], row["against"]) == ("left:x/y", "right:x/y")
    expected = (F["left", "x"] / F["right", "x"]) / (F["left", "y"] / F["right", "y"])
    assert row["ratio"] == pytest.approx(expected)


def test_without_a_law_or_a_velocity_there_are_no_outcomes() -> None:
    draws, of = draws_of(3, SIDES), recorded(K="side", C="1")
    assert set(contrasts(draws, of, ["K", "C"], 0.1)["quantity"]) == {"K"}
    still = Recorded(of.rows.assign(velocity_m_s=np.nan), of.formulas, REFERENCE)
    assert set(contrasts(draws, still, ["K", "C"], 0.1, law=LAW)["quantity"]) == {"K"}


def test_a_law_without_a_closed_form_says_how_many_draws_were_simulated(monkeypatch) -> None:
    draws, of = draws_of(4, SIDES), recorded(K="side", C="1")
    monkeypatch.setattr(Law, "in_closed_form", False)
    few = replace(SETTINGS, simulated=400, of_a_condition=150)
    for module in (study, contrasts_module):
        monkeypatch.setattr(module, "SETTINGS", few)
    thinned = contrasts(draws, of, ["K", "C"], 0.1, law=LAW)
    notes = thinned.set_index("quantity")["note"]
    assert notes["K"] == ""
    assert notes["peak_force"] == "200 of 600 draws were simulated"
