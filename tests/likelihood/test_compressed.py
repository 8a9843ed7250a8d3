"""Traces at a few nodes have the log density of all samples, within a bound that is known beforehand."""

from __future__ import annotations

from dataclasses import replace
from math import factorial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from dense_impact import record_of
from numpy.testing import assert_allclose, assert_array_equal

from bayestissue.mechanics.elements import element
from bayestissue.mechanics.oscillator import impact_motion, time_to_peak
from bayestissue.model.likelihood.compressed import (
    LANES,
    RADIUS,
    TERMS,
    CompressedTraces,
    log_density,
    within,
)
from bayestissue.model.likelihood.impact import MeasuredImpact, NoiseParameters
from bayestissue.model.likelihood.noise import discrepancy_modes
from bayestissue.model.likelihood.record import Contact, DecelerationRecord
from bayestissue.model.likelihood.recorder import Colour

TISSUE = element("kelvin_voigt")
RNG = np.random.default_rng(3)
IMPACTS = 60
# From light damping through critical damping, and at it and next to it, to strong damping.
ZETA = np.concatenate([[1.0, 1 - 1e-9, 1 + 1e-9], np.geomspace(0.05, 3.0, IMPACTS - 3)])
# Shorter than the nodes are many, even and odd, and long.
SAMPLES = np.resize([8, 15, 27, 28, 29, 57, 120, 373, 1001], IMPACTS)
MASS, VELOCITY = RNG.uniform(0.3, 2.0, IMPACTS), RNG.uniform(0.8, 2.0, IMPACTS)
OMEGA_N = RNG.uniform(30.0, 200.0, IMPACTS)
NOISE = 0.005
# Each node's value is a sum of so many terms, and so many nodes are summed: as often is a square rounded.
ROUNDINGS = TERMS**2


def record(*, gravity: bool, modes: bool, uniform: bool) -> DecelerationRecord:
    """Impacts until their peak; with modes of a discrepancy, and then with four errors, or with three."""
    window = np.asarray(time_to_peak(OMEGA_N, ZETA))
    dt = window / SAMPLES
    first = dt * RNG.uniform(0.0, 1.0, IMPACTS)
    along = np.full(IMPACTS, 9.80665 if gravity else 0.0)
    time = first[:, None] + dt[:, None] * np.arange(SAMPLES.max())
    at = OMEGA_N[:, None], ZETA[:, None], VELOCITY[:, None], along[:, None]
    clean = np.where(np.arange(SAMPLES.max()) < SAMPLES[:, None], impact_motion(time, *at).deceleration, 0.0)
    peak = np.abs(clean).max(1, keepdims=True)
    d = clean + NOISE * peak * RNG.normal(size=clean.shape)
    sd = np.stack([np.full(IMPACTS, 0.01), np.full(IMPACTS, 0.2), dt / np.sqrt(12)], axis=1)
    if modes:
        sd = np.insert(sd, 1, 0.005, axis=1)
    number = np.broadcast_to(np.arange(SAMPLES.max()), d.shape)
    return record_of(
        d,
        first,
        dt,
        VELOCITY,
        error_sd=sd,
        mass=MASS,
        count=SAMPLES,
        contact=Contact.known(np.full(IMPACTS, uniform)),
        gravity=along if gravity else None,
        **({"discrepancy": discrepancy_modes(SAMPLES, number)} if modes else {}),
    )


def impacts(of: DecelerationRecord, width: float = 0.0, *, gain: bool = False) -> MeasuredImpact:
    """At the tissue's own parameters, or at random ones about these, seen through a gain or not."""
    K, C = MASS * OMEGA_N**2, 2 * ZETA * OMEGA_N * MASS
    away = np.exp(width * RNG.normal(size=(2, IMPACTS)))
    log_peak = jnp.log(jnp.abs(of.d).max(1))
    log_sigma = log_peak + np.log(NOISE) + width * RNG.normal(size=IMPACTS)
    modes = log_peak - 4 if of.discrepancy.basis.shape[1] else None
    log_gain = jnp.linspace(-0.05, 0.05, IMPACTS) if gain else None
    noise = NoiseParameters(log_sigma, modes, log_gain=log_gain)
    return MeasuredImpact(TISSUE, jnp.asarray([K, C] * away), noise, of)


@jax.jit
def both(traces: CompressedTraces, of: MeasuredImpact) -> tuple[Any, ...]:
    return of.log_density(), log_density(traces, of), within(traces, of)


def compressed(of: DecelerationRecord) -> CompressedTraces:
    traces = CompressedTraces.of(TISSUE, of)
    assert traces is not None
    return traces


@pytest.mark.parametrize(
    "kinds",
    [
        {"gravity": False, "modes": False, "uniform": True},
        pytest.param({"gravity": True, "modes": True, "uniform": True, "gain": True}, marks=pytest.mark.slow),
        pytest.param({"gravity": True, "modes": False, "uniform": False}, marks=pytest.mark.slow),
        pytest.param({"gravity": True, "modes": True, "uniform": True}, marks=pytest.mark.slow),
    ],
)
def test_nodes_have_the_density_of_all_samples(kinds: dict[str, bool]) -> None:
    gain = kinds.get("gain", False)
    here = record(**{name: kind for name, kind in kinds.items() if name != "gain"})
    traces, known = compressed(here), 0
    assert {leaf.dtype for leaf in jax.tree.leaves(traces)} == {np.dtype(float)}
    for width in (0.0, 0.01, 0.1, 0.4):
        at = impacts(here, width, gain=gain)
        # Contact in its interval and a little beyond its end, as a place that is estimated may be.
        later = np.where(np.arange(IMPACTS) % 2, -np.asarray(here.first_time) - 0.05 * here.dt, 0.0)
        for moved in (here, here.with_first_time(here.first_time + later)):
            exact, found, inside = map(np.asarray, both(traces, replace(at, record=moved)))
            assert found.dtype == float
            assert np.isfinite(found[inside]).all()
            squares = (here.d**2).sum(1) / np.exp(2 * at.noise_parameters.log_sigma)
            unit = np.finfo(float).eps * (np.asarray(squares) + np.abs(exact))
            assert (np.abs(found - exact) < ROUNDINGS * unit)[inside].all()
            assert (np.abs(found - exact) < 1e-5)[inside & (width < 0.1)].all()
            known += inside.sum()
    # Up to the peak all but the most unlikely parameters are within the bound.
    assert known > 0.95 * 8 * IMPACTS


@pytest.mark.slow
def test_many_impacts_are_summed_block_by_block() -> None:
    here = record(gravity=False, modes=False, uniform=True)
    at, rows = impacts(here, 0.01), np.resize(np.arange(IMPACTS), 5 * LANES // 2)
    parameters, log_sigma = at.parameters[:, rows], at.noise_parameters.log_sigma[rows]
    many = MeasuredImpact(TISSUE, parameters, NoiseParameters(log_sigma), here.impacts(rows))
    traces = compressed(many.record)
    assert traces.later.shape == (5, TERMS // 2, LANES // 2)
    one_block, blocks = jax.jit(log_density)(compressed(here), at), jax.jit(log_density)(traces, many)
    assert_allclose(blocks, np.asarray(one_block)[rows], rtol=1e-12)


def test_what_is_left_out_within_the_bound_is_less_than_rounding() -> None:
    most = RADIUS**TERMS / factorial(TERMS) / (1 - RADIUS / (TERMS + 1))
    assert most < 2.0**-53
    tail = sum(RADIUS**k / factorial(k) for k in range(TERMS, 2 * TERMS))
    assert tail < most


def test_the_bound_is_of_the_norm_of_the_motion_s_matrix() -> None:
    here = record(gravity=False, modes=False, uniform=False)
    traces = compressed(here)
    for scale in (1.0, 4.0, 30.0):
        K, C = scale * MASS * OMEGA_N**2, scale * 2 * ZETA * OMEGA_N * MASS
        at = MeasuredImpact(TISSUE, jnp.asarray([K, C]), NoiseParameters(jnp.zeros(IMPACTS)), here)
        half = np.maximum(np.asarray(traces.half), np.asarray(here.first_time + traces.half))
        root, p = np.sqrt(K / MASS) * half, C / MASS * half
        norm = [np.linalg.norm([[0.0, a], [-a, -b]], 2) for a, b in zip(root, p, strict=True)]
        assert_array_equal(within(traces, at), np.array(norm) <= RADIUS)
    outside = MeasuredImpact(
        TISSUE, jnp.full((2, IMPACTS), jnp.nan), NoiseParameters(jnp.zeros(IMPACTS)), here
    )
    assert not within(traces, outside).any()


def test_no_other_traces_are_compressed() -> None:
    here = record(gravity=False, modes=False, uniform=False)
    number = len(here.d)
    reach = Contact.anywhere(np.zeros((number, 2)), np.zeros(number, int))
    coloured = Colour(*(jnp.ones((1, 2, 2)), jnp.ones((1, 3)), jnp.ones((1, 4)), jnp.zeros(1)))
    others: list[dict[str, Any]] = [{"contact": reach}, {"colour": coloured}, {"clipped": here.d}]
    others += [{"uneven": object()}, {"low_pass": object()}, {"force": object()}]
    others += [{"d": here.d[:, : 2 * TERMS - 1]}]
    for other in others:
        assert CompressedTraces.of(TISSUE, here._replace(**other)) is None
    for name in ("maxwell", "hunt_crossley", "moving_mass"):
        assert CompressedTraces.of(element(name), here) is None
