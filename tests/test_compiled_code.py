"""Compiled code is kept for later processes, and forgotten before it holds more mappings than allowed."""

from __future__ import annotations

import os
import warnings
from pathlib import Path

import jax
import pytest

from bayestissue.base import runtime

HASH = "0123456789abcdef" * 4


@pytest.mark.parametrize(("most", "compiled"), [(10_000_000, 1), (0, 0)])
def test_compiled_code_is_forgotten_where_it_holds_too_many_mappings(most: int, compiled: int) -> None:
    double = jax.jit(lambda x: 2 * x)
    double(1.0)
    runtime.release_compiled(most)
    assert double._cache_size() == compiled
    assert double(3.0) == 6.0


def test_what_was_used_least_lately_is_removed_from_a_folder_that_is_too_large(tmp_path: Path) -> None:
    for number in range(10):
        entry = tmp_path / f"jit_{number}-{HASH}-cache"
        entry.write_bytes(b"-" * 100)
        # The first three were written first, and the second of them was read since.
        os.utime(entry, (100 if number == 1 else number, number))
    (tmp_path / "my-cache").write_bytes(b"-" * 10_000)
    (tmp_path / f"jit_link-{HASH}-cache").symlink_to(tmp_path / "my-cache")
    runtime._remove_unused(tmp_path, most=1000, target=800)
    assert len(list(tmp_path.iterdir())) == 12
    runtime._remove_unused(tmp_path, most=999, target=800)
    left = {*range(10)} - {0, 2}
    assert {path.name for path in tmp_path.iterdir()} == {"my-cache", f"jit_link-{HASH}-cache"} | {
        f"jit_{number}-{HASH}-cache" for number in left
    }


def test_a_block_keeps_what_it_compiles_and_an_entry_that_is_not_whole_is_compiled_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", str(tmp_path))
    before = jax.config.jax_compilation_cache_dir
    jax.config.update("jax_compilation_cache_dir", None)
    try:
        for _ in range(2):
            with runtime.compiled_kept(), warnings.catch_warnings():
                warnings.simplefilter("ignore")
                assert jax.jit(lambda x: 11 * x + 2)(1.0) == 13.0
            entries = list(tmp_path.glob("*-cache"))
            assert entries
            assert jax.config.jax_compilation_cache_dir is None
            for entry in entries:
                # As another process sees it that reads while it is written.
                entry.write_bytes(entry.read_bytes()[:20])
    finally:
        jax.config.update("jax_compilation_cache_dir", before)
