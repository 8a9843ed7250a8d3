from __future__ import annotations

from dataclasses import replace
from typing import Any

import jax
import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose

from bayestissue.base.errors import InputError, Problem
from bayestissue.mechanics.oscillator import impact_motion, spring_damper
from bayestissue.model.hierarchy.specification import Formulas, ModelSpecification
from bayestissue.model.hierarchy.trace_data import Prepared, prepare, with_discrepancy
from bayestissue.model.hierarchy.trace_models import Kind, log_likelihood, physical
from bayestissue.model.likelihood.record import CONTACT, DecelerationRecord
from bayestissue.recordings.dataset import Dataset, Trace, Uncertainty
from bayestissue.recordings.signal import SignalOptions
from dataset_bench import settings_of

MASS = np.tile([0.5, 1.2], 3)
PLAIN = Formulas(K="log(mass_kg) + (1|subject)", C="log(mass_kg) + (1|subject)")
CHAIN = Uncertainty(relative_mass_sd=0.01, velocity_sd_m_s=0.02, relative_gain_sd=0.03, offset_sd=0.4)


def dataset(rate: float = 5000.0, **changes: Any) -> Dataset:
    """Three people in two conditions, with a quiet part before contact and a little noise."""
    rows = pd.DataFrame(
        {
            "impact": [f"i{i}" for i in range(6)],
            "subject": np.repeat(["a", "b", "c"], 2),
            "trial": np.tile(["x", "y"], 3),
            "mass_kg": MASS,
            "velocity_m_s": 1.5,
        }
    )
    omega_n, zeta = np.sqrt(3000 / MASS), 25 / (2 * np.sqrt(3000 * MASS))
    time = np.arange(-0.01, 0.06, 1 / rate) + 0.3 / rate
    motion = impact_motion(np.maximum(time, 0), omega_n[:, None], zeta[:, None], 1.5)
    part = motion.displacement if changes.get("quantity") == "displacement" else motion.deceleration
    values = np.where(time >= 0, np.asarray(part), 0.0)
    values += 1e-3 * values.max() * np.random.default_rng(1).normal(size=values.shape)
    usual = {"quantity": "deceleration", "uncertainty": CHAIN, "contact": "between"}
    traces = [Trace(time, row) for row in values]
    return Dataset(settings_of(**usual | changes), rows, traces)


def specification(likelihood: str, **changes: Any) -> ModelSpecification:
    return ModelSpecification(name="m", likelihood=likelihood, **({"formula": PLAIN} | changes))  # type: ignore[arg-type]


def prepared(kind: Kind, data: Dataset | None = None, **changes: Any) -> Prepared:
    return prepare(data or dataset(), specification(kind, **changes), source="m.toml")


def refused(data: Dataset, model: ModelSpecification) -> tuple[Problem, ...]:
    with pytest.raises(InputError) as caught:
        prepare(data, model, source="m.toml")
    for problem in caught.value.problems:
        assert problem.file
        assert problem.expected
        assert problem.remedy.endswith((".", ")"))
        assert problem.column
    return caught.value.problems


@pytest.mark.slow
def test_a_model_of_published_estimates_is_sent_elsewhere() -> None:
    (problem,) = refused(dataset(), specification("published-estimates"))
    assert (problem.file, problem.column, problem.value) == ("m.toml", "likelihood", "published-estimates")
    assert "bayestissue reproduce" in problem.remedy


def test_the_impact_likelihood_reads_decelerations() -> None:
    (problem,) = refused(dataset(quantity="displacement"), specification("impact"))
    assert (problem.file, problem.column) == ("m.toml", "likelihood")
    assert "models/arma.toml" in problem.remedy


@pytest.mark.slow
def test_too_few_samples_name_every_impact() -> None:
    problems = refused(dataset(rate=100.0), specification("arma"))
    # A time to peak of 20 and 30 ms holds 2 and 3 samples of 10 ms, and the rebound as many.
    assert [problem.impact for problem in problems] == [f"i{i}" for i in range(6)]
    assert {(problem.file, problem.column) for problem in problems} == {("m.toml", "signal.window")}
    assert all(isinstance(problem.value, int) and problem.value < 8 for problem in problems)


@pytest.mark.slow
def test_the_chains_errors_reach_the_displacement() -> None:
    made = prepared("arma")
    level, ramp, parabola = np.asarray(made.data.record.error_sd).T
    # The gain's error, of all impacts, is a parameter and no part of each trace's own.
    assert_allclose(ramp, 0.02)
    assert made.model.nuisance[-1] == "log_gain"
    assert (made.model.priors.log_gain.mean, made.model.priors.log_gain.sd) == (0.0, 0.03)
    own = prepared("arma", gain_error="impact")
    assert_allclose(np.asarray(own.data.record.error_sd)[:, 1], np.hypot(0.02, 0.03 * 1.5))
    # The quiet part tells the offset better than what was declared of it.
    assert_allclose(parabola, made.signal.quiet.offset_sd)
    assert (parabola < CHAIN.offset_sd).all()
    assert_allclose(level, 1.5 * made.signal.contact.sd)
    assert made.model.log_mass_sd == CHAIN.relative_mass_sd
    assert_allclose(np.exp(made.data.log_peak), made.signal.stop.x)


def test_recorded_displacements_have_an_offset_but_need_no_velocity() -> None:
    recorded = dataset(quantity="displacement", uncertainty=Uncertainty(offset_sd=1e-4))
    made = prepared("arma", replace(recorded, impacts=recorded.impacts.assign(velocity_m_s=np.nan)))
    level, ramp, parabola = np.asarray(made.data.record.error_sd).T
    assert (level >= 1e-4).all()
    assert not ramp.any()
    assert not parabola.any()


@pytest.mark.slow
def test_the_impact_likelihood_reads_the_deceleration_itself() -> None:
    made = prepared("impact")
    velocity, offset, contact = np.asarray(made.data.record.error_sd).T
    assert_allclose(velocity, 0.02)
    assert_allclose(offset, made.signal.quiet.offset_sd)
    assert_allclose(contact, made.signal.contact.bracket_sd)
    assert_allclose(made.data.record.first_time, made.signal.contact.bracket_s)
    assert_allclose(np.exp(made.data.log_peak), np.abs(made.signal.deceleration).max(1))
    assert made.data.record.d.shape == made.signal.deceleration.shape


@pytest.mark.slow
def test_a_discrepancy_adds_a_parameter_and_the_modes_of_every_window() -> None:
    model = specification("impact")
    plain = prepare(dataset(), model, source="m.toml")
    assert not plain.model.discrepancy
    found = with_discrepancy(dataset(), model, plain)
    assert found.model.discrepancy
    assert found.model.nuisance == ("noise", "log_gain", "discrepancy")
    assert found.signal is plain.signal
    assert "discrepancy_mean" in found.model.locations.parts
    record = found.data.record
    assert isinstance(record, DecelerationRecord)
    impacts, samples = record.d.shape
    assert record.discrepancy.basis.shape == (impacts, 6, samples)
    assert_allclose(record.discrepancy.share.sum(1), plain.signal.n_samples)
    other = prepared("impact", element="hunt_crossley", discrepancy="always")
    assert other.model.nuisance == ("noise", "log_gain", "discrepancy")
    # A discrepancy takes up what a wrong moment of contact does.
    assert not other.data.record.contact.reach


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["arma", "impact"])
def test_parameters_become_those_of_the_likelihood_each_impacts_its_own(kind: Kind) -> None:
    made = prepared(kind)
    middle = np.array([8.0, 3.0, -3.0, *[0.3] * (len(made.model.nuisance) - 1)])
    u = middle[:, None] + 0.1 * np.random.default_rng(6).normal(size=(len(middle), len(MASS)))
    at = physical(made.model, made.data, list(u))
    assert_allclose(np.log(spring_damper(at.omega_n, at.zeta, MASS)), u[:2], rtol=1e-12)
    noise = at.log_sigma
    if kind == "arma":
        assert_allclose(np.arctanh(at.theta1), u[3], rtol=1e-12)
        noise = noise + np.log(1 + at.theta1**2) / 2
    assert_allclose(noise, u[2] + made.data.log_peak, rtol=1e-12)
    density, row = jax.jit(log_likelihood), np.array([1])
    alone = density(made.model, made.data.impacts(row), list(u[:, row]))
    assert_allclose(alone, density(made.model, made.data, list(u))[row], rtol=1e-10)


def test_contact_that_does_not_show_may_be_in_any_of_some_cells() -> None:
    made = prepared("impact", element="hunt_crossley")
    record, signal = made.data.record, made.signal
    assert isinstance(record, DecelerationRecord)
    assert made.model.nuisance == ("noise", "log_gain")
    impacts, reach = record.contact.before.shape
    assert impacts == len(signal.x)
    assert reach * signal.dt.min() >= signal.before.reach_s.max() - 1e-12
    assert_allclose(record.contact.before, signal.before.value[:, -reach:])
    assert_allclose(record.error_sd[:, CONTACT], reach * signal.dt / np.sqrt(12))
    assert np.asarray(record.contact.uniform).all()


def test_contact_that_is_given_is_known() -> None:
    made = prepared("impact", element="hunt_crossley", signal=SignalOptions(contact="time-zero"))
    assert not made.data.record.contact.reach
    assert not np.asarray(made.data.record.error_sd)[:, CONTACT].any()


def test_elements_whose_stiffness_depends_on_depth_have_one_depth_that_all_impacts_reach() -> None:
    made = dataset()
    found = prepare(made, specification("impact", element="stiffening"), source="m.toml")
    depth = np.asarray(found.data.record.common_depth)  # type: ignore[union-attr]
    assert_allclose(depth, found.signal.stop.x.min(), rtol=0.01)
    assert (depth <= found.signal.stop.x).all()
    assert np.ptp(depth) == 0
    straight = prepare(made, specification("impact", element="maxwell"), source="m.toml")
    assert not straight.model.depends_on_depth
    beside = with_discrepancy(made, specification("impact", element="maxwell"), straight)
    assert found.model.depends_on_depth
    assert beside.model.depends_on_depth
    assert_allclose(beside.data.record.common_depth, depth)  # type: ignore[union-attr]
