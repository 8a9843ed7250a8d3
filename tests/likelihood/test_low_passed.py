"""A recorder's low-pass against closed forms."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from dense_impact import record_of
from scipy.signal import bessel, butter, freqs

from bayestissue.mechanics.elements import element
from bayestissue.model.likelihood.record import Contact, DecelerationRecord
from bayestissue.model.likelihood.recorder import Flow, LowPass
from bayestissue.model.likelihood.response import collision_of, motion, response
from bayestissue.recordings.dataset.dataset_file import LowPassFilter
from bayestissue.recordings.signal.filters import delay, modes

FILTERS = [
    LowPassFilter(low_pass_hz=500.0),
    LowPassFilter(low_pass_hz=800.0, order=1),
    LowPassFilter(low_pass_hz=700.0, order=5, kind="bessel"),
    LowPassFilter(low_pass_hz=500.0, order=2, zero_phase=True),
    LowPassFilter(low_pass_hz=900.0, order=3, zero_phase=True),
]
# A spring and damper's deceleration is A e^(p t) and its conjugate.
K, C, MASS, VELOCITY, DT = 30_000.0, 60.0, 0.5, 1.5, 1e-4


def closed_form(recorder: LowPassFilter, time: np.ndarray) -> np.ndarray:
    """The filter's answer to the impact, term by term; the impact is 0 before contact and never ends."""
    own = np.roots([1, C / MASS, K / MASS])
    size = VELOCITY * own**2 * np.array([-1, 1]) / (own[0] - own[1])
    poles, weights = modes(recorder)
    found = np.zeros(time.shape, complex)
    for pole, weight in zip(poles, weights, strict=True):
        for other, amplitude in zip(own, size, strict=True):
            # The real part of the weight times the whole, real, answer's integral: both conjugates are in it.
            late, early = np.maximum(time, 0), np.minimum(time, 0)
            part = amplitude * (np.exp(other * late) - np.exp(pole * late)) / (other - pole)
            found += weight * np.where(time > 0, part, 0)
            if recorder.zero_phase:
                found -= weight * amplitude / (other + pole) * np.exp(other * late) * np.exp(-pole * early)
    return found.real


def low_pass(recorder: LowPassFilter, phases: int = 1, lead: int = 0) -> LowPass:
    poles, weights = modes(recorder)
    ahead = jnp.zeros(lead) if recorder.zero_phase else None
    return LowPass(jnp.asarray(poles), jnp.asarray(weights), (jnp.arange(phases) + 0.5) / phases, ahead)


def record(
    first_time: float, filters: LowPass, samples: int, contact: Contact | None = None
) -> DecelerationRecord:
    still = np.zeros((1, samples))
    return record_of(still, first_time, DT, VELOCITY, mass=MASS, contact=contact, low_pass=filters)


PARAMETERS = jnp.array([[K], [C]])
TISSUE = element("kelvin_voigt")
compiled = jax.jit(lambda record: response(collision_of(TISSUE, PARAMETERS, record), record))


@pytest.mark.parametrize("recorder", FILTERS, ids=str)
def test_modes_are_those_of_the_filter(recorder):
    frequency = 2 * np.pi * np.array([0.0, 100.0, recorder.low_pass_hz, 2000.0])
    design = {"butterworth": butter, "bessel": bessel}[recorder.kind]
    extra = {"norm": "mag"} if recorder.kind == "bessel" else {}
    _, once = freqs(
        *design(recorder.order, 2 * np.pi * recorder.low_pass_hz, analog=True, **extra), worN=frequency
    )
    poles, weights = modes(recorder)
    both = np.concatenate([poles, poles.conj()]), np.concatenate([weights, weights.conj()]) / 2
    at = 1j * frequency[:, None]
    found = (both[1] / (at - both[0])).sum(1)
    if recorder.zero_phase:
        found = found - (both[1] / (at + both[0])).sum(1)
        once = np.abs(once) ** 2
    np.testing.assert_allclose(found, once, rtol=1e-10, atol=1e-12)
    assert np.abs(found[0]) == pytest.approx(1)
    assert np.abs(found[2]) == pytest.approx(0.5 if recorder.zero_phase else 0.5**0.5)


def test_the_delay_is_when_a_step_is_half_there():
    # 1 - e^(-t / T) of one pole.
    assert delay(LowPassFilter(low_pass_hz=500.0, order=1)) == pytest.approx(
        np.log(2) / (2 * np.pi * 500.0), rel=1e-4
    )
    assert delay(LowPassFilter(low_pass_hz=500.0, zero_phase=True)) == 0


@pytest.mark.slow
@pytest.mark.parametrize("recorder", FILTERS[1::3], ids=str)
def test_an_impact_behind_a_filter_is_the_closed_form(recorder):
    """To (omega dt)^4 / 384 of the peak, on samples and in the finer cells of contact, and its slope."""
    samples, lead = 40, 60 if recorder.zero_phase else 0
    first = -3.63 * DT if recorder.zero_phase else 2.37 * DT
    given = low_pass(recorder, phases=2, lead=lead)
    peak = closed_form(recorder, np.arange(80) * DT).max()
    # Beyond the samples a forward and backward filter has the impact for `lead` more, and then nothing.
    tail = np.exp(modes(recorder)[0].real.max() * lead * DT) if lead else 0.0
    found = compiled(record(first, given, samples))
    expected = closed_form(recorder, first + np.arange(samples) * DT)
    np.testing.assert_allclose(found.d[0], expected, atol=(1e-6 + tail) * peak)
    np.testing.assert_allclose(found.by_velocity[0], expected / VELOCITY, atol=(1e-6 + tail) * peak)
    anywhere = Contact.anywhere(np.zeros((1, lead + 4)), np.zeros(1))
    cells = record(first, given, samples, anywhere)
    fine = compiled(cells)
    time = (np.arange(fine.d.shape[1]) + 0.5) * DT / 2 - lead * DT
    inside = time < 40 * DT
    np.testing.assert_allclose(
        fine.d[0, inside], closed_form(recorder, time[inside]), atol=(1e-6 + tail) * peak
    )
    step = 1e-8
    slope = (closed_form(recorder, time + step) - closed_form(recorder, time - step)) / (2 * step)
    np.testing.assert_allclose(fine.jerk[0, inside], slope[inside], atol=(1e-5 + tail) * np.abs(slope).max())


def test_the_motion_is_in_flight_until_contact():
    given = low_pass(FILTERS[3], lead=20)
    flown = record(-2.5 * DT, given, 10)
    x, v, d = jax.jit(motion)(collision_of(TISSUE, PARAMETERS, flown), flown)
    since = (np.arange(10) - 2.5) * DT
    np.testing.assert_allclose(x[0, :3], VELOCITY * since[:3])
    np.testing.assert_allclose(d[0, :3], 0)
    assert (np.diff(x[0]) > 0).all()
    np.testing.assert_allclose(d[0, 3], -np.gradient(v[0], DT)[4], rtol=0.1)


def test_a_force_that_has_fallen_to_0_stays_there():
    flow = Flow(jnp.array([[0.0, 1.0, -0.1, 2.0]]), jnp.ones((1, 4)), jnp.array([DT])).while_pushing()
    np.testing.assert_array_equal(flow.d, [[0.0, 1.0, 0.0, 0.0]])
    np.testing.assert_array_equal(flow.jerk, [[1.0, 1.0, 0.0, 0.0]])
