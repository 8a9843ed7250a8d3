"""The chain's likelihoods by compressed traces, and by all samples where these are not within their bound."""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from bayestissue.base.impact_arrays import padded_impacts
from bayestissue.inference.chain.target import Target
from bayestissue.inference.factors.expansions import expanded
from bayestissue.model.hierarchy.trace_data import Prepared, prepare
from bayestissue.studies.fitting import resolve
from campaigns import simulated, spreads

RECORDING = {
    "sampling_rate_hz": 5000.0,
    "before_contact_s": 0.01,
    "noise_relative_to_peak": 0.005,
    "velocity_sd_m_s": 0.005,
}


def prepared() -> Prepared:
    """Three people hit by three masses, at 5 kHz: more than twice as many samples as nodes."""
    made = simulated(spreads(subject=0.2), RECORDING, people=3, masses=(0.5, 0.8, 1.2), seed=5)
    specification, source = resolve(
        {"likelihood": "impact", "formula": {"K": "(1|subject)", "C": "(1|subject)"}}
    )
    return prepare(made.dataset("small"), specification, source=source)


@jax.jit
def log_likelihood(target: Target, u: jax.Array) -> jax.Array:
    return target.log_likelihood(u)


@pytest.mark.slow
def test_one_trace_that_is_not_within_the_bound_has_all_asked_of_all_samples() -> None:
    made = prepared()
    target, u = Target.from_prepared(made), jnp.asarray(padded_impacts(expanded(made)).centre).T
    assert target.compressed is not None
    plain = replace(target, compressed=None)
    # Traces that are not the recorded ones, so that it shows which are asked.
    others = replace(target, compressed=target.compressed._replace(left=target.compressed.left + 1e3))
    exact = log_likelihood(plain, u)
    assert_allclose(log_likelihood(target, u), exact, atol=1e-8)
    assert (np.asarray(log_likelihood(others, u) - exact)[np.asarray(target.present)] < -1).all()
    for parameter, value in ((0, 14.0), (1, 9.0), (0, np.nan), (2, np.nan)):
        outside = u.at[parameter, 4].set(value)
        assert_array_equal(log_likelihood(others, outside), log_likelihood(plain, outside))
    # Impacts that only fill up are wherever the chain has them.
    last = len(target.present) - 1
    assert not target.present[last]
    filled = u.at[0, last].set(14.0)
    assert_array_equal(log_likelihood(others, filled), log_likelihood(others, u))
