"""Parabolas by least squares, where a trace leaves a direction open."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np

from bayestissue.inference.factors.sites import _MOST_GAIN as MOST_GAIN
from bayestissue.inference.factors.sites import _parabola, nearest_parabolas
from bayestissue.model.hierarchy.gaussian.factor import GaussianFactor


def test_a_parabola_is_found_as_it_is() -> None:
    rng = np.random.default_rng(0)
    z = rng.standard_normal((300, 3, 4))
    root = rng.standard_normal((3, 4, 4))
    bend = root @ root.swapaxes(1, 2)
    slope, level = rng.standard_normal((3, 4)), rng.standard_normal(3)
    value = (
        level
        + np.einsum("ia,pia->pi", slope, z)
        - np.einsum("pia,iab,pib->pi", z, bend, z, optimize=True) / 2
    )
    weight = rng.uniform(0.1, 1.0, value.shape)
    # Points without weight do not count.
    value[:50], weight[:50] = -1e6, 0.0
    found = _parabola(z, value, weight)
    # A ridge of a millionth beside weights that add up to more than a hundred.
    for part, true in zip(found, (level, slope, bend), strict=True):
        np.testing.assert_allclose(part, true, atol=1e-6 * np.abs(bend).max())


def test_a_sloping_likelihood_that_opens_upwards_promises_no_more_than_is_believable() -> None:
    """Along the first of three axes; level there, a summary would promise the more the further away."""
    u = np.random.default_rng(4).standard_normal((400, 1, 3))
    value = 3.0 * u[..., 0] + 0.2 * u[..., 0] ** 2 - 2.0 * u[..., 1] ** 2 - 0.5 * u[..., 2] ** 2
    centre, slope, precision, level = nearest_parabolas(u, value, np.ones((400, 1)))
    # The slope is met where the points are; the tolerance is that of their mean, times the bend.
    np.testing.assert_allclose(slope[0], [3.0, 0.0, 0.0], atol=5 * 4 / 400**0.5)
    most = slope[0] @ np.linalg.solve(precision[0], slope[0]) / 2
    assert most < 1.1 * MOST_GAIN
    held = GaussianFactor(*map(jnp.asarray, (centre, slope, precision, level)))
    far = np.zeros((3, 1, 3))
    far[:, 0, 0] = 10.0, 1000.0, 100_000.0
    gain = (np.asarray(held.log_density(far)) - level)[:, 0]
    assert (gain <= most).all()
    assert (gain[1:] < 0).all()
    np.testing.assert_allclose(np.diag(precision[0])[1:], [4.0, 1.0], rtol=0.1)
