"""How often a chain's likelihood reads its arrays, and its operations a sample: the same on any machine."""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bayestissue.model.likelihood.displacements import MeasuredDisplacement, displacement_record

IMPACTS, SAMPLES = 90, 256


@pytest.fixture(scope="module")
def cost() -> dict[str, float]:
    """What XLA counts of the density that a chain by `arma` evaluates, which asks for no gradient."""
    one = np.ones(IMPACTS)
    x = np.cumsum(np.random.default_rng(0).normal(size=(IMPACTS, SAMPLES)), axis=1)
    record = displacement_record(x, SAMPLES * one.astype(int), 0 * one, one, np.zeros((IMPACTS, 3)))
    parameters = jnp.stack([0.005 * one, 0.3 * one, -0.27 * one, 0 * one])
    density: Callable = lambda p, record: MeasuredDisplacement(*p, record).log_density().sum()  # noqa: E731
    counted = jax.jit(density).lower(parameters, record).compile().cost_analysis()
    arrays = sum(column.nbytes for column in (*record.columns, record.spread))
    return {"readings": counted["bytes accessed"] / arrays, "operations": counted["flops"] / x.size}


def test_a_value_reads_its_arrays_as_seldom_as_it_did(cost):
    # 1.47 as XLA counts, part by part of the program; a tenth is let pass.
    assert cost["readings"] <= 1.62


def test_a_value_computes_as_little_as_it_did(cost):
    # 33.1 operations a sample; a tenth is let pass.
    assert cost["operations"] <= 36.4
