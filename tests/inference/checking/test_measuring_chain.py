from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import xarray as xr

from bayestissue.inference.checking.measuring_chain import (
    AMPLITUDE,
    OFFSET,
    common_gain,
    estimated_error,
    judge,
)
from bayestissue.model.hierarchy.priors import normal
from bayestissue.model.hierarchy.specification import ModelSpecification
from bayestissue.model.hierarchy.trace_data import Prepared, prepare
from bayestissue.recordings.dataset import Dataset, Trace
from campaigns import RECORDER, simulated

MASSES, VELOCITIES = (0.4, 0.7, 1.0, 1.3), (1.2, 1.2, 1.0, 0.9)
RECORDING = RECORDER | {"sampling_rate_hz": 2000.0, "gain_error": "impact"}
# In standard errors.
FAR = 4.0


def recorded(people: int = 3, recording: dict[str, float] | None = None, **tissue: object) -> Dataset:
    """So many people in four conditions, errors of the measuring chain as large as declared."""
    made = simulated(
        {"sd_subject_K": 0.2, "sd_impact_K": 0.05, **tissue},
        RECORDING | (recording or {}),
        people=people,
        masses=MASSES,
        velocity=VELOCITIES,
        seed=4,
    )
    return made.dataset("chain")


class Prepare:
    """Prepared data of one likelihood, with one model, so that it is compiled once."""

    def __init__(self, likelihood: str, gain_error: str = "impact") -> None:
        self._specification = ModelSpecification.model_validate(
            {"name": "m", "likelihood": likelihood, "gain_error": gain_error}
        )
        self._model = None

    def __call__(self, dataset: Dataset) -> Prepared:
        made = prepare(dataset, self._specification, source="the model")
        self._model = self._model or made.model
        return replace(made, model=self._model)


_PREPARE = {likelihood: Prepare(likelihood) for likelihood in ("impact", "arma")}


@pytest.fixture(scope="module")
def impact() -> Prepare:
    return _PREPARE["impact"]


@pytest.fixture(scope="module")
def good() -> Dataset:
    return recorded()


def with_column(dataset: Dataset, name: str, factor: object) -> Dataset:
    return replace(dataset, impacts=dataset.impacts.assign(**{name: dataset.impacts[name] * factor}))


@pytest.mark.slow
@pytest.mark.parametrize("likelihood", list(_PREPARE))
def test_a_right_chain_raises_no_alarm(likelihood: str, good: Dataset) -> None:
    assert judge(_PREPARE[likelihood](good)) == {"passed": True, "of": 12}


# One of three by default; all in the long suite.
@pytest.mark.slow
@pytest.mark.parametrize(
    "factor", [1.1, *(pytest.param(factor, marks=pytest.mark.long) for factor in (1.06, 1 / 1.1))]
)
def test_a_velocity_is_named_before_a_zero_that_explains_the_traces_as_well(impact, factor) -> None:
    """Of 160 impacts; one wide normal left no number, and the zero was named alone."""
    chain = {
        "sampling_rate_hz": 5000.0,
        "offset_sd_m_s2": 0.0,
        "relative_gain_sd": 0.0,
        "relative_mass_sd": 0.0,
    }
    dataset = recorded(40, chain, sd_impact_K=0.08)
    found = judge(impact(with_column(dataset, "velocity_m_s", factor)))
    assert (found["passed"], found["error"], OFFSET in found["alike"]) == (False, AMPLITUDE, True)
    assert found["relative"] == pytest.approx(1 / factor - 1, abs=0.01)


@pytest.mark.slow
def test_the_error_that_was_made_is_found_to_its_standard_error(impact: Prepare, good: Dataset) -> None:
    stated = impact(with_column(good, "velocity_m_s", 1 / 1.1))
    found = estimated_error(stated, AMPLITUDE)
    made = found.error - stated.signal.velocity * 0.1
    assert np.abs(made / found.expected_sd).mean() < 1 + FAR / np.sqrt(12)


@pytest.mark.slow
def test_one_wrong_velocity_of_twelve_is_named(impact: Prepare, good: Dataset) -> None:
    factor = np.where(np.arange(12) == 7, 1.1, 1.0)
    found = judge(impact(with_column(good, "velocity_m_s", factor)))
    assert found["passed"] is False
    assert (found["kind"], found["impacts"]) == ("impact", [good.impacts["impact"].iloc[7]])
    assert "1 of 12 impacts" in found["words"]
    assert "lower than stated" in found["words"]


def test_a_condition_s_wrong_velocity_is_named(impact: Prepare, good: Dataset) -> None:
    factor = np.where(good.impacts["trial"] == "t2", 1.06, 1.0)
    found = judge(impact(with_column(good, "velocity_m_s", factor)))
    assert (found["passed"], found["kind"], found["groups"]) == (False, "trial", ["t2"])
    assert "impacts of trial t2 (3 of 12)" in found["words"]


@pytest.mark.parametrize("likelihood", list(_PREPARE))
def test_a_gain_of_all_impacts_counts_once(likelihood: str) -> None:
    """Of twelve impacts; the same error in each by itself would be 3.5 standard deviations of their mean."""
    shared, declared = Prepare(likelihood, "all"), 0.005
    exact = recorded(recording={"relative_gain_sd": 0.0})
    exact = exact.with_settings(
        uncertainty=exact.uncertainty.model_copy(update={"relative_gain_sd": declared})
    )

    def through(gain: float) -> Dataset:
        return replace(exact, traces=[Trace(trace.time_s, gain * trace.value) for trace in exact.traces])

    told = normal(np.log1p(declared), 1e-3)
    assert judge(shared(through(1 + declared)), None, told) == {"passed": True, "of": 12}
    # One velocity that is wrong besides, and a gain that is another than was declared.
    wrong = np.where(np.arange(12) == 7, 1.1, 1.0)
    found = judge(shared(with_column(through(1 + declared), "velocity_m_s", wrong)), None, told)
    assert found["passed"] is False
    assert exact.impacts["impact"].iloc[7] in found["impacts"]
    assert len(found["impacts"]) <= 4
    found = judge(shared(through(1.05)))
    assert (found["passed"], found["error"], found["kind"]) == (False, AMPLITUDE, "all")
    assert found["relative"] == pytest.approx(0.05, abs=0.02)


def test_the_gain_that_a_fit_tells_is_believed_as_far_as_it_was_declared(good: Dataset) -> None:
    prepared = Prepare("impact", "all")(good)
    rng, prior = np.random.default_rng(1), prepared.model.priors.log_gain

    def common(mean: float, sd: float) -> tuple[float, float]:
        drawn = mean + sd * rng.standard_normal((2, 2000))
        posterior = xr.Dataset({"log_gain_mean": (("chain", "draw"), drawn)})
        found = common_gain(prepared, xr.DataTree.from_dict({"posterior": posterior}))
        assert found is not None
        return found.mean, found.sd

    assert common(0.008, 0.001) == pytest.approx((0.008, 0.001), abs=1e-4)
    # Four standard deviations off, and nothing told.
    assert common(0.02, 0.001) == (prior.mean, prior.sd)
    assert common(0.0, prior.sd) == pytest.approx((0.0, prior.sd), abs=4e-4)
    assert common_gain(_PREPARE["impact"](good), xr.DataTree()) is None


def test_a_zero_that_moves_at_contact_is_named(impact: Prepare, good: Dataset) -> None:
    traces = []
    for trace in good.traces:
        begun = np.argmax(trace.value > 0.1 * trace.value.max())
        traces.append(Trace(trace.time_s, trace.value + 1.5 * (np.arange(trace.value.size) >= begun - 1)))
    found = judge(impact(replace(good, traces=traces)))
    # Velocity and zero do much the same to a trace until its peak, and both are named.
    assert found["passed"] is False
    assert OFFSET in {found["error"], *found["alike"]}
    assert "a zero of the recorder off by" in found["words"]


def test_a_wrong_mass_does_not_show(impact: Prepare, good: Dataset) -> None:
    assert judge(impact(with_column(good, "mass_kg", 1.1)))["passed"] is True


@pytest.mark.slow
def test_an_undeclared_error_is_one_without_a_standard_deviation(impact: Prepare, good: Dataset) -> None:
    bare = good.with_settings(
        uncertainty=good.uncertainty.model_copy(update={"velocity_sd_m_s": 0.0, "relative_gain_sd": 0.0})
    )
    found = judge(impact(with_column(bare, "velocity_m_s", 1.1)))
    assert (found["passed"], found["declared_sds"]) == (False, None)
    assert "no error was declared" in found["words"]


@pytest.mark.slow
def test_another_law_is_not_blamed_on_the_chain(impact: Prepare) -> None:
    tissue = {"element": "standard_linear", "K_N_per_m": 2000.0, "parameters": {"arm_ratio": 2.0}}
    found = judge(impact(recorded(**tissue)))
    assert found["passed"] is None
    assert "can't be told" in found["words"]


def test_what_has_no_known_rate_of_false_alarms_is_not_asked(good: Dataset) -> None:
    specification = ModelSpecification(name="m", likelihood="impact", element="standard_linear")
    assert judge(prepare(good, specification, source="the model")) == {}
