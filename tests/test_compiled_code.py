"""Compiled code is forgotten before a process holds more memory mappings than the system allows."""

from __future__ import annotations

import jax
import pytest

from bayestissue import runtime


@pytest.mark.parametrize(("most", "compiled"), [(10_000_000, 1), (0, 0)])
def test_compiled_code_is_forgotten_where_it_holds_too_many_mappings(most: int, compiled: int) -> None:
    double = jax.jit(lambda x: 2 * x)
    double(1.0)
    runtime.release_compiled(most)
    assert double._cache_size() == compiled
    assert double(3.0) == 6.0
