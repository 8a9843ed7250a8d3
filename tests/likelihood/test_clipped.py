"""Replicates of clipped samples."""

from __future__ import annotations

from dataclasses import replace

import jax
import numpy as np
import pytest
from recorded_impacts import clipped

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_replicate_is_cut_where_the_trace_was(sign: float) -> None:
    measured = clipped(sign=sign).measured
    replicate = sign * np.asarray(measured.replicate(jax.random.PRNGKey(1))["deceleration"])
    limit = (sign * np.asarray(measured.record.d)).max(axis=1)
    # Both would go beyond: by a quarter of the peak, and by the noise of many samples near it.
    np.testing.assert_array_equal(replicate.max(axis=1), limit)
    never = replace(measured, record=measured.record._replace(clipped=None))
    uncut = never.replicate(jax.random.PRNGKey(1))["deceleration"]
    np.testing.assert_allclose(replicate, np.minimum(sign * np.asarray(uncut), limit[:, None]), rtol=1e-12)
