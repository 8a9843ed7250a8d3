"""A low-pass that software ran over the samples: the likelihood's mean beside what scipy makes of them."""

from __future__ import annotations

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from dense_impact import record_of
from scipy.signal import bessel, butter, sosfilt, sosfiltfilt

from bayestissue.mechanics.elements import element, impact
from bayestissue.model.likelihood.record import Contact, DecelerationRecord
from bayestissue.model.likelihood.recorder import LowPass
from bayestissue.model.likelihood.response import collision_of, response
from bayestissue.recordings.dataset.dataset_file import LowPassFilter
from bayestissue.recordings.signal.filters import ahead_s, decay, modes

DT, SAMPLES, VELOCITY = 5e-4, 40, 1.5
RATE = 1 / DT
QUARTER = RATE / 8
FILTERS = [
    LowPassFilter(low_pass_hz=QUARTER, applied="digital"),
    LowPassFilter(low_pass_hz=QUARTER, order=5, kind="bessel", applied="digital"),
    LowPassFilter(low_pass_hz=QUARTER, order=2, zero_phase=True),
    LowPassFilter(low_pass_hz=QUARTER, order=3, zero_phase=True),
    # One pole at a quarter of the sampling rate has a digital pole at 0.
    LowPassFilter(low_pass_hz=RATE / 4, order=1, zero_phase=True),
]
TISSUES = {"kelvin_voigt": {"K": 3000.0, "C": 25.0}, "hunt_crossley": {"K": 3000.0, "C": 60.0}}


def by_scipy(recorder: LowPassFilter, values: np.ndarray) -> np.ndarray:
    """As a lab filters its export: forwards, or forwards and backwards with the padding of `sosfiltfilt`."""
    design = {"butterworth": butter, "bessel": bessel}[recorder.kind]
    extra = {"norm": "mag"} if recorder.kind == "bessel" else {}
    sections = design(recorder.order, recorder.low_pass_hz, fs=RATE, output="sos", **extra)
    return (sosfiltfilt if recorder.zero_phase else sosfilt)(sections, values)


def sampled(name: str, time: np.ndarray) -> np.ndarray:
    """Force over mass at these times since contact, s; 0 before it."""
    parameters = {key: jnp.array([value]) for key, value in TISSUES[name].items()}
    one = np.ones(1)
    size = {} if name == "kelvin_voigt" else {"diameter": 0.0318 * one}
    motion = impact(name, parameters, 0.5 * one, VELOCITY * one, time[None], **size)
    return np.asarray(motion.deceleration)[0]


def likelihoods(recorder: LowPassFilter) -> tuple[LowPass, int]:
    poles, weights = modes(recorder)
    lead = max(3, int(np.ceil(ahead_s(recorder, np.array(DT)) / DT))) if recorder.zero_phase else 0
    ahead = jnp.zeros(lead) if recorder.zero_phase else None
    corner = jnp.asarray(2 * np.pi * recorder.low_pass_hz)
    return LowPass(jnp.asarray(poles), jnp.asarray(weights), jnp.array([0.5]), ahead, corner), lead


def record(first_time: float, low_pass: LowPass, cells: int = 0) -> DecelerationRecord:
    contact = Contact.anywhere(np.zeros((1, cells)), np.zeros(1)) if cells else None
    still = np.zeros((1, SAMPLES))
    return record_of(still, first_time, DT, VELOCITY, mass=0.5, contact=contact, low_pass=low_pass)


@partial(jax.jit, static_argnums=0)
def answered(which, parameters, recorded):
    return response(collision_of(which, parameters, recorded), recorded)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "recorder"),
    # One forwards, one with a pole at 0 and one of a tissue that is solved on a grid.
    [
        ("kelvin_voigt", FILTERS[1]),
        ("kelvin_voigt", FILTERS[4]),
        ("hunt_crossley", FILTERS[2]),
        *(pytest.param("kelvin_voigt", FILTERS[k], marks=pytest.mark.long) for k in (0, 2, 3)),
    ],
    ids=str,
)
def test_the_mean_is_what_scipy_makes_of_the_samples(name, recorder):
    """Contact at any phase and before any sample; beyond a filter's reach a thousandth of it is left out."""
    low_pass, lead = likelihoods(recorder)
    parameters = jnp.array([[value] for value in TISSUES[name].values()])
    place = np.arange(-300, 300)
    filtered = {
        since: by_scipy(recorder, sampled(name, (place + since) * DT)) for since in (0.5, 0.13, 2.4, -2.4)
    }
    peak = max(np.abs(values).max() for values in filtered.values())
    tail = 1e-3 if recorder.zero_phase else 1e-9
    # Of a force that a solver finds.
    solved = 1e-9 if name == "kelvin_voigt" else 1e-5
    # Two samples since contact before the first of the record among them.
    for since in (0.13, 2.4, -2.4) if recorder.zero_phase else (0.13, 2.4):
        answer = answered(element(name), parameters, record(since * DT, low_pass))
        expected = filtered[since][300 : 300 + SAMPLES]
        np.testing.assert_allclose(answer.d[0], expected, atol=(tail + solved) * peak)
    if name != "kelvin_voigt":
        return
    # In cells of contact, from as long before it as the filter looks ahead, half an interval before a sample.
    cells = answered(element(name), parameters, record(DT / 2, low_pass, lead + 3))
    expected = filtered[0.5][300 - lead : 300 - lead + cells.d.shape[1]]
    inside = slice(0, lead + SAMPLES)
    np.testing.assert_allclose(cells.d[0, inside], expected[inside], atol=(tail + solved) * peak)
    step = 1e-3
    moved = [by_scipy(recorder, sampled(name, (place + 0.5 + side) * DT)) for side in (-step, step)]
    slope = ((moved[1] - moved[0]) / (2 * step * DT))[300 - lead :][inside]
    np.testing.assert_allclose(cells.jerk[0, inside], slope, atol=(tail + 1e-4) * np.abs(slope).max())


@pytest.mark.parametrize("recorder", FILTERS[:4], ids=str)
def test_the_slowest_part_dies_away_as_the_filter_rings(recorder):
    """The answer to an impulse is at most its slowest pole's, which the samples far from it show."""
    impulse = np.zeros(401)
    impulse[200] = 1
    once = by_scipy(
        LowPassFilter(low_pass_hz=recorder.low_pass_hz, order=recorder.order, kind=recorder.kind), impulse
    )
    size = np.abs(once[200:])
    envelope = np.maximum.accumulate(size[::-1])[::-1]
    shown = -np.log(envelope[60] / envelope[20]) / (40 * DT)
    assert float(decay(recorder, DT)) == pytest.approx(shown, rel=0.05)
