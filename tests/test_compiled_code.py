"""Compiled code is kept for later processes, and forgotten before it holds more mappings than allowed."""

from __future__ import annotations

from pathlib import Path

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


def test_a_block_keeps_what_it_compiles_and_leaves_the_settings_of_jax(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", str(tmp_path / "compiled"))
    before = jax.config.jax_compilation_cache_dir
    jax.config.update("jax_compilation_cache_dir", None)
    try:
        with runtime.compiled_kept():
            jax.jit(lambda x: 5 * x + 2)(1.0)
        assert jax.config.jax_compilation_cache_dir is None
        assert list((tmp_path / "compiled").glob("*-cache"))
    finally:
        jax.config.update("jax_compilation_cache_dir", before)


def test_a_block_leaves_a_folder_that_jax_has_been_given(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", str(tmp_path / "other"))
    with runtime.compiled_kept():
        jax.jit(lambda x: 7 * x + 2)(1.0)
    assert not (tmp_path / "other").exists()
