from __future__ import annotations

from functools import partial
from typing import Any

import jax
import numpy as np
import pandas as pd
import pytest

import bayestissue as bt
from bayestissue.inference.points.notes import said_once
from bayestissue.inference.points.point_fit import PointFit, fit_points
from bayestissue.mechanics.oscillator import impact_motion, spring_damper_inverse, time_to_peak
from bayestissue.recordings.dataset import Dataset, Trace
from bayestissue.recordings.signal import SignalOptions, displacements
from dataset_bench import settings_of

thesis = partial(bt.estimate, method="dds")


def about_rest(dataset: Dataset) -> PointFit:
    """Least squares of displacements by the default signal chain, whose errors it then has."""
    signal = displacements(dataset)
    return fit_points(signal.x, signal.n_samples, signal.dt, signal.mass)


@jax.jit
def deceleration(time: jax.Array, omega_n: jax.Array, zeta: jax.Array) -> jax.Array:
    return impact_motion(time, omega_n, zeta, 1.5).deceleration


def recorded(
    K: np.ndarray,
    C: np.ndarray,
    mass: np.ndarray,
    rate: float,
    *,
    noise: float = 0.0,
    before: float = 30.37,
    after: float = 0.3,
    **columns: object,
) -> Dataset:
    """Decelerations from ``before`` intervals before contact to ``after`` times to peak past the peak."""
    omega_n, zeta = (np.asarray(p) for p in spring_damper_inverse(K, C, mass))
    longest = float(np.max(time_to_peak(omega_n, zeta)))
    time = np.arange(int((1 + after) * longest * rate + before) + 3) / rate
    since = time - before / rate
    # Of a length that other recordings have too, which is compiled once.
    longer = np.pad(np.maximum(since, 0), (0, 2 ** len(since).bit_length() - len(since)))
    motion = np.asarray(deceleration(longer, omega_n[:, None], zeta[:, None]))
    d = np.where(since >= 0, motion[:, : len(since)], 0.0)
    d += noise * d.max(1, keepdims=True) * np.random.default_rng(0).normal(size=d.shape)
    impacts = pd.DataFrame({"impact": [f"i{i}" for i in range(len(K))], "subject": "s", "trial": "t"})
    impacts = impacts.assign(mass_kg=mass, velocity_m_s=1.5, **columns)
    settings = settings_of(quantity="deceleration")
    return Dataset(settings, impacts, [Trace(time, row) for row in d])


def alike(count: int, mass: object = 0.5, rate: float = 1e4, noise: float = 0.005, **more: Any) -> Dataset:
    """Impacts of one tissue, by one mass or by masses one after the other."""
    K, C = np.full(count, 3000.0), np.full(count, 25.0)
    return recorded(K, C, np.resize(mass, count), rate, noise=noise, **more)


# The slowest and the fastest by default, each of a width of its own to compile; all in the long suite.
@pytest.mark.slow
@pytest.mark.parametrize("rate", [2e3, pytest.param(1e4, marks=pytest.mark.long), 5e4])
@pytest.mark.parametrize(
    ("before", "after"),
    [(30.0, 0.3), (30.37, 0.3), (30.95, 0.3), (30.37, 0.0), (0.0, 0.0)],
)
def test_noise_free_decelerations_give_back_stiffness_and_damping(rate, before, after) -> None:
    masses, ratios = [0.1, 0.375, 1.0, 5.0], [0.02, 0.05, 0.2, 0.5, 0.75, 1.0, 1.5, 2.0]
    mass, zeta = (a.ravel() for a in np.meshgrid(masses, ratios))
    K = np.full(len(mass), 3000.0)
    C = 2 * zeta * np.sqrt(K * mass)
    fit = about_rest(recorded(K, C, mass, rate, before=before, after=after))
    # the promise of the default: a tenth of a per cent
    np.testing.assert_allclose(fit.K, K, rtol=1e-3)
    np.testing.assert_allclose(fit.C, C, rtol=1e-3)


def test_flags_say_what_to_doubt() -> None:
    table = thesis(alike(3, tissue_thickness_m=["0.1", "0.001", ""]))
    assert list(table["flags"]) == ["", "deeper than the tissue is thick", ""]


def test_what_every_sound_impact_shows_is_a_note_and_no_flag() -> None:
    table = thesis(alike(3))
    assert list(table["flags"]) == [""] * 3
    said = said_once(table["notes"])
    assert len(said) == 1
    assert "K and C imply another peak displacement than recorded in 3 of 3 impacts" in said[0]
    assert "method `impact`" in said[0]


def test_without_a_quiet_part_the_offset_is_a_note() -> None:
    table = thesis(alike(2, before=2.5))
    assert list(table["flags"]) == ["", ""]
    assert all("no quiet part" in note for note in table["notes"])


def test_a_window_too_short_to_fit_has_a_row_without_numbers() -> None:
    table = thesis(alike(2, [0.05, 5.0], 4e3, 1e-3), options=SignalOptions(window=0.25))
    assert table["n_samples"][0] < 8
    assert np.isnan(table["K_N_per_m"][0])
    assert "fewer than 8 samples" in table["flags"][0]
    assert np.isfinite(table["K_N_per_m"][1])
