from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from causes_bench import design, specification, work

from bayestissue.elements import impact
from bayestissue.thesis.causes.batches import Batch, batches, run_batch
from bayestissue.thesis.causes.campaigns import decelerations, draw_truth, peak_over

pytestmark = pytest.mark.slow


def test_a_batch_depends_on_seed_cause_and_number_alone() -> None:
    small = specification("centring", "anticipation")
    both = {batch.name: run_batch(batch) for batch in batches(design(), small, seed=1)[:3]}
    alone = Batch(design(), specification("centring"), "centring", 1, 1)
    pd.testing.assert_frame_equal(run_batch(alone), both["centring-00001"], check_exact=True)
    other = run_batch(Batch(design(), small, "centring", 1, 2))
    assert not np.array_equal(other["zeta_median"], both["centring-00001"]["zeta_median"])


def test_the_last_batch_is_cut_to_the_number_asked_for() -> None:
    jobs = work("centring", each=45, batch=10)
    assert len(jobs) == 5
    assert len(run_batch(jobs[-1])) == 5


def test_each_mechanism_leaves_its_mark() -> None:
    found = {
        name: pd.concat([run_batch(b) for b in work(name, each=40, batch=20)]).median(numeric_only=True)
        for name in ("none", "centring", "own_time", "anticipation", "reflex_energy", "moving_mass")
    }
    # Forty campaigns with exponents scattered by some 0.15 have a median good to 0.03.
    assert abs(found["none"]["mass_exponent_K"]) < 0.1
    assert abs(found["none"]["mass_exponent_C"]) < 0.1
    assert found["centring"]["mass_exponent_C"] > 0.2
    assert found["centring"]["K_over_M_mean"] > 1.5 * found["none"]["K_over_M_mean"]
    assert found["own_time"]["mass_exponent_K"] == pytest.approx(1, abs=0.15)
    assert found["anticipation"]["mass_exponent_K"] > 0.4
    assert abs(found["anticipation"]["velocity_exponent_K"]) < 0.1
    assert found["reflex_energy"]["velocity_exponent_K"] > 0.8
    # Of tissue of the impactor's mass the velocity, integrated from the stated one, never comes to 0.
    assert found["moving_mass"]["without_estimate"] > 0.2
    assert found["moving_mass"]["mass_exponent_K"] > found["none"]["mass_exponent_K"] + 0.1


def test_tissue_is_drawn_from_its_prior() -> None:
    small = specification("centring")
    truth = draw_truth(small.causes["centring"], small, design(), np.random.default_rng(0), 2000)
    log_K = np.log(truth.parameters["K"]).mean(axis=1)
    low, high = np.log(small.tissue.K_N_per_m.low), np.log(small.tissue.K_N_per_m.high)
    # A uniform distribution's mean and spread, and the people's share of the campaign's mean.
    assert log_K.mean() == pytest.approx((low + high) / 2, abs=4 * (high - low) / np.sqrt(12 * 2000))
    assert log_K.std() == pytest.approx((high - low) / np.sqrt(12), rel=0.05)
    assert np.all(truth.dt > 0)


@pytest.mark.parametrize(
    ("element", "extra"),
    [("wall", {"thickness_m": 0.03}), ("maxwell", {}), ("moving_mass", {"moving_mass_kg": 0.2})],
)
def test_recordings_are_impacts_on_the_element(element: str, extra: dict[str, float]) -> None:
    mass, velocity = np.array([0.5, 1.2]), np.array([1.2, 1.7])
    parameters = {name: np.full(2, value) for name, value in ({"K": 3000.0, "C": 30.0} | extra).items()}
    dt = np.full(2, 2e-4)
    d = np.asarray(decelerations(element, parameters, mass, velocity, np.zeros(2), dt, 512))
    known = impact(element, parameters, mass, velocity, np.arange(512) * dt[:, None])
    loading = np.arange(512) * dt[:, None] < np.asarray(known.time_to_peak)[:, None]
    # Cubics between steps of a sixtieth of the recording.
    np.testing.assert_allclose(d[loading], np.asarray(known.deceleration)[loading], rtol=1e-3, atol=1e-2)
    unit = np.full(2, 0.02)
    peak = np.asarray(peak_over(element, parameters, mass, velocity, unit)) * unit
    np.testing.assert_allclose(peak, np.minimum(known.time_to_peak, 0.08), atol=0.08 / 256)
