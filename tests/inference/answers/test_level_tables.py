"""What impacts do on compared levels: ranks by hand, loops and curves by an independent integration."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from numpy.testing import assert_allclose
from scipy.optimize import brentq

from bayestissue.base.results.tables import columns_of
from bayestissue.inference.answers.contrasts import Contrasts, contrasts_table
from bayestissue.inference.answers.law import Law
from bayestissue.inference.answers.level_tables import (
    curves_table,
    levels_table,
    loops_table,
    measured_motions,
)
from bayestissue.inference.answers.questions import ask, numbered
from bayestissue.inference.answers.study import Study
from bayestissue.model.hierarchy.recorded import Recorded
from designs import normal_draws
from tissues import path

SHAPE = (2, 200)
MASS, G = 5.0, 9.80665
VELOCITIES = (1.534, 1.981)
PADS = {"A": (14_500.0, 80.0), "B": (12_800.0, 81.0), "D": (17_500.0, 100.0)}
RESPONSES = ("K", "C")


def recorded(formula: str = "pad", **further: object) -> Recorded:
    rows = pd.DataFrame(
        [
            {"subject": "tower", "trial": f"{V}", "mass_kg": MASS, "velocity_m_s": V, "pad": pad}
            for pad in PADS
            for V in VELOCITIES
        ]
    )
    return Recorded(rows.assign(**further), dict.fromkeys(RESPONSES, formula), MASS)


def draws_of(sd: float, *, pads: bool = True) -> xr.Dataset:
    first, others = PADS["A"], list(PADS)[1:] if pads else []
    values = {f"intercept_{q}": np.log(first[at]) for at, q in enumerate(RESPONSES)}
    for pad in others:
        values |= {
            f"effect_of_pad[{pad}]_{q}": np.log(PADS[pad][at] / first[at]) for at, q in enumerate(RESPONSES)
        }
    return normal_draws(1, sd, values, SHAPE)


def dropped(pad: str, V: float) -> tuple[Callable[..., tuple[np.ndarray, np.ndarray]], float, float]:
    """Depth and force at times since contact, when it is deepest and when it is left, by DOP853."""
    p = dict(zip("KC", PADS[pad], strict=True))
    states = path("kelvin_voigt", p, MASS, V, 0.2, G).states

    def at(time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        x, v, _ = states(time)
        return x, p["K"] * x + p["C"] * v

    time = np.linspace(0, 0.2, 2001)
    after = int(np.argmax(at(time)[1] < 0))
    end = brentq(lambda t: at(t)[1], time[after - 1], time[after])
    return at, brentq(lambda t: states(t)[1], 0, end), end


def greatest(pad: str, V: float) -> float:
    at, _, end = dropped(pad, V)
    return at(np.linspace(0, end, 20_001))[1].max()


@pytest.mark.slow
def test_loops_and_curves_are_those_of_an_independent_integration() -> None:
    compared = Contrasts(Study(draws_of(0.0), recorded(), Law("kelvin_voigt", G)))
    table = loops_table(compared)
    assert set(table["level"]) == set(PADS)
    assert_allclose(sorted(set(table["velocity_m_s"])), VELOCITIES)
    for (pad, V), rows in table.groupby(["level", "velocity_m_s"]):
        (at, peak, end), of = dropped(pad, V), dict(iter(rows.groupby("branch")))
        for branch, ends in (("in", (0, peak)), ("out", (peak, end))):
            depth, force = at(np.linspace(*ends, len(of[branch])))
            # Between the nodes of a path the motion is a cubic; at the end the force falls fast.
            assert_allclose(of[branch]["depth_m"], depth, atol=1e-6 * depth.max())
            assert_allclose(of[branch]["force_N"], force, atol=1e-6 * greatest(pad, V))
    curves = curves_table(compared)
    assert list(curves["beyond"][:6]) == [1, 0, 0, 0, 0, 1]
    for row in curves[curves["quantity"] == "peak_force"].itertuples():
        assert row.median == pytest.approx(greatest(row.level, row.velocity_m_s), rel=1e-6)
    assert_allclose(curves["drop_height_cm"], 100 * curves["velocity_m_s"] ** 2 / (2 * G))


@pytest.mark.parametrize("quantity", ["K", "peak_force"])
def test_ranks_and_chances_are_those_of_a_question(quantity: str) -> None:
    compared = Contrasts(Study(draws_of(0.05), recorded(), Law("kelvin_voigt", 0.0)))
    table = levels_table(compared).set_index(["quantity", "level"]).loc[quantity]
    lowest, highest = (
        ask(compared.study, numbered([f"best(pad, {which} {quantity})"])).set_index("level")
        for which in ("lowest", "highest")
    )
    assert_allclose(table["p_lowest"], lowest["posterior"].loc[table.index])
    assert_allclose(table["p_highest"], highest["posterior"].loc[table.index])
    assert_allclose(table["above_lowest"], lowest["expected_loss"].loc[table.index])
    same = ["rank", "rank_low", "rank_high", "low", "median", "high"]
    assert_allclose(table[same].astype(float), lowest.loc[table.index, same].astype(float))
    assert_allclose(table["velocity_m_s"].astype(float), np.nan if quantity == "K" else np.mean(VELOCITIES))


def test_a_loop_is_of_the_medians_of_the_draws() -> None:
    draws = draws_of(0.1)
    compared = Contrasts(Study(draws, recorded(), Law("kelvin_voigt", 0.0)))
    table = loops_table(compared)
    rows = table[(table["level"] == "B") & (table["velocity_m_s"] == VELOCITIES[0])]
    assert set(rows["draws"]) == {SHAPE[0] * SHAPE[1]}
    # At contact the force is C V.
    C = np.exp(draws["intercept_C"] + draws["effect_of_pad[B]_C"]).to_numpy()
    assert rows.iloc[0]["force_N"] == pytest.approx(np.median(C) * VELOCITIES[0])


def test_without_a_factor_a_typical_person_has_loops_alone() -> None:
    # One impact leaves K and C of a typical person open over decades: many draws are overdamped, and a loop
    # ends where they do not rise again together.
    compared = Contrasts(Study(draws_of(4.0, pads=False), recorded("1")))
    assert levels_table(compared).empty
    assert curves_table(compared).empty
    table = loops_table(compared)
    assert set(table["factor"]) == set(table["level"]) == {""}
    assert np.isfinite(table[["depth_m", "force_N"]].to_numpy(float)).all()
    assert set(columns_of("loops")) == set(table.columns)


def test_without_a_law_levels_have_k_and_c_and_no_pictures() -> None:
    compared = Contrasts(Study(draws_of(0.05), recorded(), Law(described=False)))
    assert set(levels_table(compared)["quantity"]) == {"K", "C"}
    assert loops_table(compared).empty
    assert curves_table(compared).empty


def test_a_parameter_of_the_element_that_differs_by_pad_has_its_levels_in_its_unit() -> None:
    depth = "stiffening_depth_m"
    draws = draws_of(0.05)
    draws[f"log_{depth}_mean"] = np.log(0.012) + 0.1 * draws["intercept_K"]
    for pad in list(PADS)[1:]:
        draws[f"effect_of_pad[{pad}]_{depth}"] = 0.1 + 0 * draws["intercept_K"]
    by_pad = replace(recorded(), formulas=dict.fromkeys((*RESPONSES, depth), "pad"))
    compared = Contrasts(Study(draws, by_pad, Law("stiffening", described=False)))
    table = levels_table(compared).set_index("quantity")
    assert set(table.loc[depth, "unit"]) == {"m"}
    median = table.loc[depth].set_index("level")["median"]
    assert_allclose(median, np.exp(np.median(draws[f"log_{depth}_mean"]) + np.array([0.0, 0.1, 0.1])))
    assert {"K", "C", depth} <= set(contrasts_table(compared, 0.1)["quantity"])


def test_of_many_conditions_few_motions_are_drawn_and_many_masses_have_no_curves() -> None:
    rows = recorded().rows
    many = recorded(mass_kg=np.linspace(1, 6, len(rows)), trial=[f"t{at}" for at in range(len(rows))])
    motions = measured_motions(many)
    assert len(motions) == 3
    assert [one["mass_kg"] for one in motions] == sorted(one["mass_kg"] for one in motions)
    compared = Contrasts(Study(draws_of(0.0), many, Law("kelvin_voigt", 0.0)))
    assert curves_table(compared).empty


def test_a_tissue_that_is_never_left_has_a_loop_without_an_end() -> None:
    draws = draws_of(0.0)
    draws = draws.assign(intercept_C=draws["intercept_C"] + np.log(20))
    compared = Contrasts(Study(draws, recorded(), Law("kelvin_voigt", G)))
    table = loops_table(compared)
    rest = MASS * G / PADS["A"][0]
    rows = table[table["level"] == "A"]
    assert np.isfinite(rows[["depth_m", "force_N"]].to_numpy(float)).all()
    out = rows[rows["branch"] == "out"]
    assert (out["force_N"] > 0.9 * MASS * G).all()
    assert out["depth_m"].min() >= rest - 1e-3
