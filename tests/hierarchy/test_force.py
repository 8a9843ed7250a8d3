"""A force beside the deceleration as a fit takes it: its rows, what it says of the mass, when it can't."""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import jax
import numpy as np
import pytest
import xarray as xr

from bayestissue.inference.checking.findings import headline
from bayestissue.inference.checking.mass_checks import judge_force
from bayestissue.inference.factors.expansions import first_guess
from bayestissue.model.hierarchy.force_data import PreparedForce
from bayestissue.model.hierarchy.trace_data import Prepared, prepare
from bayestissue.model.hierarchy.trace_models import impact_likelihood
from bayestissue.recordings.dataset.model import Dataset
from bayestissue.studies.fitting import resolve
from bayestissue.studies.simulation import Simulation, simulate
from campaigns import FOUR_BY_FOUR

FORCE = {"noise_relative_to_peak": 0.005, "offset_sd_N": 0.5, "relative_gain_sd": 0.01, "tip_mass_kg": 0.05}


NOISE_ALONE = {
    "score": 0.3,
    "structured": False,
    "impacts": {"p": {}, "below": 0, "tested": 16, "combined": 0.5, "structured": False, "names": []},
}


def campaign(force: dict[str, float] | None = FORCE, **recording: float) -> Dataset:
    content = tomllib.loads(FOUR_BY_FOUR)
    content["recording"] |= recording | ({} if force is None else {"force": force})
    return simulate(Simulation.model_validate(content)).dataset("made")


def prepared(dataset: Dataset, model: str = "impact") -> Prepared:
    specification, source = resolve(model)
    return prepare(dataset, specification, source=source)


def of_force(dataset: Dataset) -> PreparedForce:
    force = prepared(dataset).force
    assert force is not None
    return force


@pytest.fixture(scope="module")
def heavier() -> Dataset:
    return campaign(mass_factor=1.1, relative_mass_sd=0.0)


def test_its_rows_begin_with_contact_and_end_with_the_window(heavier: Dataset) -> None:
    ready = prepared(heavier)
    assert ready.force is not None
    rows, record = ready.force.rows, ready.data.record
    # The two share a clock: the same samples.
    np.testing.assert_array_equal(rows.n_samples, record.n_samples)
    np.testing.assert_allclose(rows.first_time, record.first_time, atol=1e-9)
    # 1.1 M - m behind the tip for M - m: F / M is (1.1 - m / M) d but for the gain and noise.
    mass = heavier.impacts["mass_kg"].to_numpy()
    ratio = (rows.y * np.asarray(record.d)).sum(axis=1) / (np.asarray(record.d) ** 2).sum(axis=1)
    assert ratio == pytest.approx(1.1 - 0.05 / mass, rel=0.03)
    assert np.exp(ready.force.log_ratio) == pytest.approx(1.1, rel=0.03)


def test_a_force_at_its_limit_is_not_used(heavier: Dataset) -> None:
    (forces,) = heavier.further
    limit = 0.8 * max(trace.value.max() for trace in forces)
    traces = [
        replace(trace, value=np.minimum(trace.value, limit), clipped=(trace.value >= limit).astype(np.int8))
        for trace in forces
    ]
    ready = prepared(replace(heavier, further=(traces,)))
    assert ready.force is None
    reached = sum(bool((trace.value >= limit).any()) for trace in forces)
    assert ready.force_unused == f"it stands at its sensor's limit in {reached} of {len(traces)} impacts"
    # What it lies at before and after the impact is no part of the window.
    held = [replace(trace, clipped=(np.arange(len(trace.value)) < 3).astype(np.int8)) for trace in forces]
    assert prepared(replace(heavier, further=(held,))).force is not None


def test_a_gain_and_a_mass_share_the_ratio_by_what_is_declared(heavier: Dataset) -> None:
    random = np.random.default_rng(0)
    force = replace(of_force(heavier), mass_sd=0.03, gain_sd=0.04)
    log_f, g = 0.03 * random.standard_normal(40_000), 0.04 * random.standard_normal(40_000)
    drawn = force.log_mass_factor(log_f + g, random.standard_normal(40_000))
    # Given a, what is drawn is as the truth is: alike in law, and in their covariance with a.
    se = 3 / np.sqrt(40_000)
    assert drawn.std() == pytest.approx(0.03, rel=4 * se)
    assert np.mean(drawn * (log_f + g)) == pytest.approx(0.03**2, rel=6 * se)
    assert (drawn < log_f).mean() == pytest.approx(0.5, abs=se)


def test_a_mass_that_is_declared_exact_is_not_moved(heavier: Dataset) -> None:
    force = replace(of_force(heavier), mass_sd=0.0, gain_sd=0.0)
    assert force.share == 0
    assert (force.log_mass_factor(np.array([0.1]), np.array([2.0])) == 0).all()


def test_what_keeps_a_fit_from_using_it_is_said(heavier: Dataset) -> None:
    ready = prepared(heavier, "arma")
    assert ready.force is None
    assert "no place" in ready.force_unused
    assert not ready.model.force


def without_a_known_contact(recorder: dict[str, Any], model: str, force: dict[str, Any] = FORCE) -> Prepared:
    content = tomllib.loads(FOUR_BY_FOUR) | ({"recorder": recorder} if recorder else {})
    content["recording"] |= {"force": force}
    if model != "impact":
        content["tissue"] |= {"element": model, "C_N_s_per_m": 60.0}
    return prepared(simulate(Simulation.model_validate(content)).dataset("made"), model)


@pytest.mark.parametrize(
    ("recorder", "model"),
    [
        pytest.param({}, "hunt_crossley", marks=pytest.mark.slow),
        ({"low_pass_hz": 400.0, "zero_phase": True}, "impact"),
    ],
)
@pytest.mark.slow
def test_its_rows_begin_once_contact_must_have_been(recorder: dict[str, Any], model: str) -> None:
    ready = without_a_known_contact(recorder, model)
    assert ready.force is not None
    rows, record = ready.force.rows, ready.data.record
    assert record.contact.reach
    # From contact in any cell to the first of its rows, and on until the last of the longest.
    since = rows.first_time - np.asarray(record.first_time) + np.asarray(record.cells)
    width = rows.dt / len(record.phase)
    assert ((since >= 0) & (since.min(axis=0) < width)).all()
    assert ((since.max(axis=0) / rows.dt + rows.n_samples) < rows.y.shape[1] - 1).all()
    assert record.error_sd.shape[1] == len(record.errors) == 6
    at = partial(impact_likelihood, ready.model, ready.data)
    assert np.isfinite(jax.jit(lambda u: at(list(u)).log_density())(first_guess(ready).T)).all()


def test_behind_a_low_pass_of_its_own_it_is_then_not_used() -> None:
    force = FORCE | {"recorder": {"low_pass_hz": 800.0}}
    ready = without_a_known_contact({"low_pass_hz": 400.0}, "impact", force)
    assert ready.force is None
    assert "does not show when contact was" in ready.force_unused
    assert not ready.model.force


def test_a_force_that_lags_is_not_used(heavier: Dataset) -> None:
    (forces,) = heavier.further
    late = [replace(trace, time_s=trace.time_s + 0.002) for trace in forces]
    ready = prepared(replace(heavier, further=(late,)))
    assert ready.force is None
    assert "2 ms behind the deceleration: correct time_offset_s by -0.002 s" in ready.force_unused


@pytest.fixture(scope="module")
def smooth() -> Dataset:
    """Behind a low-pass at 400 Hz with its noise."""
    content = tomllib.loads(FOUR_BY_FOUR)
    force = FORCE | {"recorder": {"low_pass_hz": 400.0, "noise": "before"}}
    content["recording"] |= {"sampling_rate_hz": 20_000.0, "force": force, "noise_relative_to_peak": 0.002}
    return simulate(Simulation.model_validate(content)).dataset("made")


def test_a_force_behind_a_low_pass_of_its_own_is_used(smooth: Dataset) -> None:
    ready = prepared(smooth)
    assert ready.force is not None
    rows = ready.force.rows
    assert rows.low_pass is not None
    assert rows.colour is not None
    # Some 2.6 ms after contact the filter has settled.
    begins = rows.first_time + np.asarray(rows.inside()).argmax(axis=1) * rows.dt
    assert begins == pytest.approx(0.0026, abs=0.0002)
    # The deceleration passed through the same filter: the two agree, without a lag.
    assert ready.force.comparison.ratio == pytest.approx(1, rel=0.03)
    assert not ready.force.comparison.lags
    channel = smooth.channels[0].model_copy(update={"recorder": None})
    undeclared = smooth.with_settings(channel=(channel,))
    assert "it went through a low-pass of some 4" in prepared(undeclared).force_unused


@pytest.fixture
def verdict(heavier: Dataset) -> Callable[..., dict[str, Any]]:
    """By draws of the ratio's log, of the factor of all masses, and of each mass over what is declared."""
    draws, declared = ("chain", "draw"), heavier.impacts["mass_kg"].to_numpy()

    def of(force: PreparedForce, a: np.ndarray, factor: np.ndarray, mass: np.ndarray) -> dict[str, Any]:
        parts = {"log_force_ratio_mean": (draws, a), "mass_factor": (draws, factor)}
        posterior = xr.Dataset(parts | {"mass": ((*draws, "impact"), declared * mass)})
        return judge_force(force, posterior, declared, NOISE_ALONE)

    return of


@pytest.mark.parametrize(
    ("mass_sd", "passed", "words"),
    [
        (0.1, True, "by the force all masses are 1."),
        (0.002, False, "the force is 10 % more than declared mass times deceleration"),
    ],
)
def test_the_verdict_names_the_size(heavier, verdict, mass_sd: float, passed: bool, words: str) -> None:
    force = replace(of_force(heavier), mass_sd=mass_sd, gain_sd=0.01)
    random = np.random.default_rng(0)
    a = np.log(1.1) + 0.001 * random.standard_normal((4, 1000))
    factor = np.exp(force.log_mass_factor(a, random.standard_normal(a.shape)))
    each = np.exp(0.002 * random.standard_normal((1, 1, len(heavier.impacts))))
    account = verdict(force, a, factor, factor[..., None] * each)
    assert account["slope"] == 0
    assert account["passed"] is passed
    assert words in headline({"passed": True, "channels": account})


def test_ratios_that_differ_by_many_of_their_errors_are_said_first(heavier, verdict) -> None:
    (forces,) = heavier.further
    high = [replace(trace, value=trace.value * (1.1 if i < 5 else 1)) for i, trace in enumerate(forces)]
    force = of_force(replace(heavier, further=(high,)))
    assert force.comparison.apart.sum() == 5
    a = 0.03 + 0.001 * np.random.default_rng(0).standard_normal((4, 500))
    account = verdict(replace(force, mass_sd=0.1), a, np.exp(a), np.ones((4, 500, 1)))
    assert not account["passed"]
    assert "differs from impact to impact" in headline({"passed": True, "channels": account})
    assert "each known to" in account["words"]


def test_masses_that_lack_one_arm_are_not_off_by_one_factor(heavier, verdict) -> None:
    force = replace(of_force(heavier), mass_sd=0.1, gain_sd=0.01)
    random, declared = np.random.default_rng(0), heavier.impacts["mass_kg"].to_numpy()
    off = np.log1p(0.05 / declared) + 0.002 * random.standard_normal((4, 500, 1))
    account = verdict(force, off.mean(-1), np.exp(off.mean(-1)), np.exp(off))
    # From 0.4 to 1.3 kg an arm of 0.05 kg is 12 to 4 %.
    slope = (np.log1p(0.05 / 1.3) - np.log1p(0.05 / 0.4)) / np.log(1.3 / 0.4)
    assert account["slope"] == pytest.approx(slope, rel=0.1)
    assert not account["passed"]
    assert "not off by one factor" in account["words"]
