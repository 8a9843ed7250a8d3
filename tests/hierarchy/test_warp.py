"""The map that makes skewed numbers normal: increasing, smooth, and what its docstring says it is."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

from bayestissue.hierarchy.warp import SinhArcsinh

WARPS = [(0.3, 1.2, bend) for bend in (-1.0, 0.0, 0.7)]
Y = np.linspace(-6.0, 6.0, 49)


@pytest.mark.parametrize("values", WARPS)
def test_its_slope_is_the_derivative_and_positive(values: tuple[float, float, float]) -> None:
    warp = SinhArcsinh(*values)
    assert_allclose(warp.slope(Y), jax.vmap(jax.grad(warp))(jnp.asarray(Y)), rtol=1e-12)
    assert (warp.slope(Y) > 0).all()
    assert warp(0.0) == warp.location
    assert warp.slope(0.0) == warp.along


@pytest.mark.parametrize("values", WARPS)
def test_it_is_a_sinh_arcsinh_map(values: tuple[float, float, float]) -> None:
    location, along, bend = values
    skew, scale = np.arctanh(bend / along), np.sqrt(along**2 - bend**2)
    known = location - bend + scale * np.sinh(np.arcsinh(Y) + skew)
    assert_allclose(SinhArcsinh(*values)(Y), known, rtol=1e-12, atol=1e-12)


def test_a_part_is_the_map_of_these_numbers() -> None:
    warp = SinhArcsinh(*np.random.default_rng(1).uniform(0.1, 1.0, (3, 4)))
    y = np.linspace(-1.0, 1.0, 4)
    assert_allclose(warp.part(slice(2))(y[:2]), warp(y)[:2], rtol=0)
    assert_allclose(warp.part(-1)(y[-1]), warp(y)[-1], rtol=0)
