"""Recorded impacts of every configuration, made by the dense oracle, and what was declared of each."""

from __future__ import annotations

from functools import cache, partial
from typing import Any

import jax.numpy as jnp
import numpy as np
from dense_impact import Recorded, correlation, reading, record_of

from bayestissue.mechanics.elements import element, element_names
from bayestissue.model.hierarchy.recorder_noise import filtered_noise, low_pass_of
from bayestissue.model.likelihood.impact import MeasuredImpact, NoiseParameters
from bayestissue.model.likelihood.noise import colour_of, discrepancy_modes
from bayestissue.model.likelihood.record import Contact, DecelerationRecord, ForceRows, UnevenTimes
from bayestissue.model.likelihood.recorder import Colour
from bayestissue.recordings.dataset.dataset_file import LowPassFilter
from bayestissue.recordings.signal.filters import autocorrelation
from tissues import path

LOW_PASS = LowPassFilter(low_pass_hz=500.0)
THERE_AND_BACK = LowPassFilter(low_pass_hz=500.0, order=2, zero_phase=True)
SAE = LowPassFilter(low_pass_hz=2.0775 * 180, zero_phase=True, sae_class=180, applied="analog")


def measured(
    name: str, values: dict[str, Any], sigma: Any, record: DecelerationRecord, **noise: Any
) -> MeasuredImpact:
    """Impacts on an element of these values; ``noise`` has further parameters of it, of every impact."""
    every = jnp.ones(len(record.d))
    parameters = jnp.stack([values[each.name] * every for each in element(name).parameters])
    further = {key: value * every for key, value in noise.items()}
    return MeasuredImpact(
        element(name), parameters, NoiseParameters(jnp.log(sigma * every), **further), record
    )


@cache
def two_impacts(
    name: str,
    tissue: str | None = None,
    *,
    gravity: float | None = None,
    uniform: bool = False,
    merged: bool = False,
    uneven: bool = False,
    log_discrepancy: tuple[float, float] | None = None,
    log_gain: tuple[float, float] | None = None,
) -> Recorded:
    """Traces of different lengths, of an element unless of another ``tissue``; errors in them."""
    mass, velocity, count = np.array([0.5, 1.2]), np.array([1.5, 1.0]), np.array([38, 45])
    dt, first, width = np.array([4e-4, 5e-4]), np.array([1e-4, 4e-4]), 45
    typical = {each.name: each.typical for which in map(element, element_names()) for each in which.extra}
    values = typical | {"K": 2500.0, "C": 30.0, "stiffening_depth_m": 0.015}
    place = np.tile(np.arange(width, dtype=float), (2, 1))
    if uneven:
        # Jitter of 15 % of a step, and one sample lost.
        place += 0.15 * np.random.default_rng(3).uniform(-1, 1, place.shape)
        place[:, 20:] += 1
    later = (place - place[:, :1]) * dt[:, None]
    motions = [path(tissue or name, values, mass[i], 0.99 * velocity[i], 0.1, gravity or 0.0) for i in (0, 1)]
    d = np.stack([motions[i].deceleration(first[i] + later[i]) for i in (0, 1)]) + 0.3
    d += 0.5 * np.random.default_rng(4).standard_normal(d.shape)
    error_sd = np.array([[0.01, 0.02, 0.5, 1e-4], [0.02, 0.01, 0.2, 5e-5]])
    further: dict[str, Any] = {}
    if uneven:
        further["uneven"] = UnevenTimes(jnp.asarray(later), jnp.zeros((2, 0)))
    noise = {} if log_gain is None else {"log_gain": jnp.array(log_gain)}
    if log_discrepancy is not None:
        further["discrepancy"] = discrepancy_modes(count, np.tile(np.arange(width), (2, 1)))
        noise["log_discrepancy"] = jnp.array(log_discrepancy)
    record = record_of(
        d,
        first,
        dt,
        velocity,
        error_sd=np.delete(error_sd, 1, axis=1) if merged else error_sd,
        mass=mass,
        count=count,
        contact=Contact.known(np.array([uniform, False])),
        gravity=gravity,
        **further,
    )
    return Recorded(measured(name, values, np.array([0.4, 0.6]), record, **noise))


@cache
def side_by_side() -> Recorded:
    """Spring and damper, along gravity or not: complex roots, equal ones, real ones far apart."""
    first, dt = np.array([0.0, 3e-4, 9e-4, 2e-4, 1e-4]), np.array([5e-4, 2e-3, 1e-3, 1e-3, 4e-4])
    velocity, gravity = np.array([1.5, 1.2, 2.0, 0.7, 1.0]), np.array([9.80665, 0.0, 9.80665, -3.0, 0.0])
    omega_n, zeta = np.array([60.0, 150.0, 90.0, 120.0, 80.0]), np.array([0.3, 1.0, 2.5, 0.999, 0.0])
    d, count = np.random.default_rng(11).normal(size=(5, 50)), np.array([50, 3, 31, 22, 40])
    for i, n in enumerate(count):
        values = {"K": omega_n[i] ** 2, "C": 2 * zeta[i] * omega_n[i]}
        motion = path("kelvin_voigt", values, 1.0, velocity[i], 0.1, gravity[i])
        d[i, :n] += motion.deceleration(first[i] + np.arange(n) * dt[i])
    error_sd = [[0.02, 0.5, 1e-4], [0.05, 0.0, 2e-4], [0.0, 0.0, 0.0], [0.01, 1.0, 0.0], [0.1, 0.2, 1e-5]]
    uniform = Contact.known(np.array([False, True, False, False, True]))
    record = record_of(
        d, first, dt, velocity, error_sd=error_sd, count=count, contact=uniform, gravity=gravity
    )
    sigma = np.array([0.5, 1.0, 0.2, 2.0, 1.0])
    return Recorded(measured("kelvin_voigt", {"K": omega_n**2, "C": 2 * zeta * omega_n}, sigma, record))


@cache
def clipped(
    *, sign: float = 1.0, merged: bool = False, uneven: bool = False, discrepancy: bool = False
) -> Recorded:
    """An impact cut at 0.8 of its peak, a third of it, and at two samples; downwards where the sign is."""
    values, velocity, first, dt, count = {"K": 2500.0, "C": 12.0}, 1.5, 2e-4, 5e-4, 44
    later = dt * np.arange(count)
    d = path("kelvin_voigt", values, 0.5, 0.99 * velocity, 0.1).deceleration(first + later)
    d += 0.3 + 1.2 * np.random.default_rng(4).standard_normal(count)
    limit = np.array([[0.8], [0.995]]) * d.max()
    cut, even = np.tile(d, (2, 1)) >= limit, np.tile(later, (2, 1))
    modes = discrepancy_modes(np.full(2, count), np.tile(np.arange(count), (2, 1)))
    record = record_of(
        sign * np.where(cut, limit, d),
        first,
        dt,
        sign * velocity,
        error_sd=(0.03, 0.5, 1e-4) if merged else (0.02, 0.01, 0.5, 1e-4),
        mass=0.5,
        clipped=jnp.asarray(sign * cut),
        **({"uneven": UnevenTimes(jnp.asarray(even), jnp.zeros((2, 0)))} if uneven else {}),
        **({"discrepancy": modes} if discrepancy else {}),
    )
    noise = {"log_discrepancy": np.log(0.8)} if discrepancy else {}
    return Recorded(measured("kelvin_voigt", values, 1.2, record, **noise))


# Velocity, gain, the force's zero, its clock, the deceleration's zero, the time of contact.
WHITE = {"colour": Colour.white_noise(), "rate": jnp.zeros(1, int)}
OF_BOTH = (0.03, 0.02, 0.1, 5e-5, 0.2, 4e-5)
RATIO, TIP = 0.07, 0.1


@cache
def force_beside(
    recorder: LowPassFilter | None = None,
    white: float = 1.0,
    first: float = 3e-4,
    *,
    below: bool = False,
    log_gain: float | None = None,
) -> Recorded:
    """A force at other times than the deceleration's; behind a filter the first three samples don't count."""
    values, mass, velocity, dt, rows = {"K": 3000.0, "C": 25.0}, 0.8, 1.4, 7e-4, 25
    random = np.random.default_rng(3)
    motion = path("kelvin_voigt", values, mass, velocity, 0.2)
    d = motion.deceleration(2e-4 + 5e-4 * np.arange(40)) + random.normal(0, 0.4, 40)
    y = (np.exp(RATIO) - TIP) * reading(motion, recorder, dt)(first + dt * np.arange(rows))
    further: dict[str, Any] = WHITE
    if recorder is not None:
        usable = (np.arange(rows + 1) >= 3) & (np.arange(rows + 1) < rows)
        low_pass = low_pass_of(recorder, np.array([dt]))._replace(phase=jnp.full(1, 0.5))
        further = WHITE | {"usable": jnp.asarray(usable[None]), "low_pass": low_pass}
        if white < 1:
            colour, rate, _ = filtered_noise(recorder, white, rows, np.array([dt]))
            further |= {"colour": colour, "rate": jnp.asarray(rate)}
    # Of a row that is longer than the trace, what is behind its end says nothing.
    seen = np.append(y + random.normal(0, 0.9, rows), 9.0)
    parts = (jnp.asarray(seen[None]), *(jnp.array([part]) for part in (rows, first, dt, TIP)))
    force = ForceRows(*parts, **further)
    ratio, name = RATIO, "kelvin_voigt"
    if below:
        # Where 0.3 kg moves along, as M / (M + m) of K, C and V does, it reads (M + m) / M times M d.
        name, moves = "moving_mass", 0.3
        values = {key: value * (mass + moves) / mass for key, value in values.items()}
        velocity *= (mass + moves) / mass
        values["moving_mass_kg"], force = moves, force._replace(tip=None)
        ratio = np.log((np.exp(RATIO) - TIP) * mass / (mass + moves))
    record = record_of(d[None], 2e-4, 5e-4, velocity, error_sd=OF_BOTH, mass=mass, force=force)
    noise = {"log_force_sigma": np.log(0.9), "log_force_ratio": ratio}
    noise |= {} if log_gain is None else {"log_gain": log_gain}
    return Recorded(measured(name, values, 0.4, record, **noise), (None, recorder), (1.0, white))


VALUES = {
    "kelvin_voigt": {"K": 3000.0, "C": 25.0},
    "maxwell": {"K": 3000.0, "C": 120.0},
    "standard_linear": {"K": 2000.0, "C": 30.0, "arm_ratio": 2.0},
    "hunt_crossley": {"K": 3000.0, "C": 60.0},
}


@cache
def contact_open(
    name: str,
    reach: int,
    earlier: tuple[float, float] | None = None,
    *,
    sigma: float = 0.3,
    lead: float = 2.6,
) -> Recorded:
    """Contact is in any of so many intervals, of some only three samples early, of which one was quiet.

    Or so many intervals ``earlier`` than the middle of each, as a parameter says.
    """
    mass, velocity, dt = np.array([0.6, 0.9]), np.array([1.2, 1.1]), 2e-4
    time = (np.arange(-reach, 60) + lead) * dt
    read = [reading(path(name, VALUES[name], mass[i], velocity[i], 0.1), None, dt) for i in (0, 1)]
    traces = np.stack([of(time) for of in read])
    traces += sigma * np.random.default_rng(1).standard_normal(traces.shape)
    n_before, n_quiet = np.minimum([100, 3], reach), np.array([2, 1])
    record = record_of(
        traces[:, reach:],
        dt / 2,
        dt,
        velocity,
        error_sd=(0.02, 0.01, 0.1, reach * dt / np.sqrt(12)),
        mass=mass,
        count=np.array([60, 48]),
        contact=Contact.anywhere(traces[:, :reach], n_before, np.full(2, 0.25), n_quiet=n_quiet),
    )
    if earlier is not None:
        known = record.contact._replace(uniform=record.contact.uniform & False)
        record = record._replace(contact=known, interval=record.dt).with_contact_earlier(jnp.array(earlier))
    return Recorded(measured(name, VALUES[name], sigma, record), quiet_sd=0.25)


@cache
def both_open(name: str, of_d: LowPassFilter | None, dt: float, first: float) -> Recorded:
    """A force beside a deceleration that does not show when contact was: 2.3 intervals before its first."""
    mass, velocity, of_trace, samples, rows = 0.8, 1.4, 5e-4, 40, 25
    low_pass = None if of_d is None else low_pass_of(of_d, np.array([of_trace]))
    reach, random = 8 + (0 if low_pass is None else low_pass.lead), np.random.default_rng(3)
    motion, true = path(name, VALUES[name], mass, velocity, 0.2), 2.3 * of_trace
    trace = reading(motion, of_d, of_trace)(true + of_trace * np.arange(-reach, samples))
    trace += random.normal(0, 0.4, len(trace))
    y = (np.exp(RATIO) - TIP) * reading(motion, None, dt)(true + first + dt * np.arange(rows))
    y += 0.5 * random.normal(size=rows)
    longer = 3 + int(np.ceil((first + reach * of_trace) / dt))
    y = jnp.asarray(np.pad(y, (0, longer))[None])
    parts = (jnp.array([part]) for part in (rows, of_trace / 2 + first, dt, TIP))
    record = record_of(
        trace[None, reach:],
        of_trace / 2,
        of_trace,
        velocity,
        error_sd=(*OF_BOTH[:5], 0.0),
        mass=mass,
        contact=Contact.anywhere(trace[None, :reach], np.array([reach]), np.array([0.4])),
        force=ForceRows(y, *parts, **WHITE),
        low_pass=low_pass,
    )
    noise = {"log_force_sigma": np.log(0.5), "log_force_ratio": RATIO}
    return Recorded(measured(name, VALUES[name], 0.4, record, **noise), (of_d, None), quiet_sd=0.4)


@cache
def filtered(
    recorder: LowPassFilter,
    white: float,
    contact: float,
    cells: int = 0,
    log_discrepancy: float | None = None,
) -> Recorded:
    """A stiff impact behind a filter, as is all noise but the white part; contact is known, or in some cell.

    Cells are before the first sample, and those in which the filter looks ahead.
    """
    values, mass, velocity, dt, samples, sigma = {"K": 30_000.0, "C": 60.0}, 0.5, 1.5, 1e-4, 50, 2.0
    low_pass = low_pass_of(recorder, np.array([dt]))
    reach, first = (cells + low_pass.lead, dt / 2) if cells else (0, contact * dt)
    motion = path("kelvin_voigt", values, mass, velocity, 0.03)
    trace = reading(motion, recorder, dt)(dt * (np.arange(-reach, samples) + contact))
    # So much is taken for white at least.
    own = max(white, 1e-3)
    factor = np.linalg.cholesky(correlation(recorder, own, len(trace), dt))
    trace += sigma * factor @ np.random.default_rng(3).standard_normal(len(trace))
    quiet_sd = sigma if cells and white == 1 else None
    early = trace[None, :reach], np.array([reach]), None if quiet_sd is None else np.full(1, quiet_sd)
    further: dict[str, Any] = {"low_pass": low_pass}
    noise = {}
    if white < 1:
        lags = partial(autocorrelation, recorder, dt=dt)
        further["colour"] = colour_of(white, [lags], reach + samples)
    if log_discrepancy is not None:
        further["discrepancy"] = discrepancy_modes(np.array([samples]), np.arange(samples)[None])
        noise["log_discrepancy"] = log_discrepancy
    record = record_of(
        trace[None, reach:],
        first,
        dt,
        velocity,
        error_sd=(0.0, 0.0, 0.0, reach * dt / 12**0.5) if cells else (0.01, 0.02, 0.5, 1e-5),
        mass=mass,
        contact=Contact.anywhere(*early) if cells else None,
        **further,
    )
    given = measured("kelvin_voigt", values, sigma, record, **noise)
    return Recorded(given, (recorder, None), (own, 1.0), quiet_sd)
