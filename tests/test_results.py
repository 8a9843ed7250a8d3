from __future__ import annotations

from pathlib import Path

import pytest

from bayestissue.errors import InputError
from bayestissue.results import require_free, whole_file, whole_folder


def test_a_finished_folder_takes_its_name_and_leaves_nothing_beside_it(tmp_path: Path) -> None:
    out = tmp_path / "deep" / "run"
    with whole_folder(out) as folder:
        (folder / "a.csv").write_text("x\n1\n")
        assert not out.exists()
    assert (out / "a.csv").read_text() == "x\n1\n"
    assert [path.name for path in out.parent.iterdir()] == ["run"]


@pytest.mark.parametrize("failure", [RuntimeError, KeyboardInterrupt, SystemExit])
def test_a_failure_inside_leaves_neither_folder_nor_staging(
    tmp_path: Path, failure: type[BaseException]
) -> None:
    with pytest.raises(failure), whole_folder(tmp_path / "run") as folder:  # noqa: PT012 - it fails half way
        (folder / "half.csv").write_text("half")
        raise failure
    assert list(tmp_path.iterdir()) == []


def test_a_failed_replacement_leaves_the_old_folder_as_it_was(tmp_path: Path) -> None:
    out = tmp_path / "run"
    out.mkdir()
    (out / "old.csv").write_text("old")
    with pytest.raises(RuntimeError), whole_folder(out, overwrite=True) as folder:  # noqa: PT012 - it fails half way
        (folder / "new.csv").write_text("new")
        raise RuntimeError
    assert [path.name for path in tmp_path.rglob("*")] == ["run", "old.csv"]


def test_overwriting_replaces_the_whole_folder(tmp_path: Path) -> None:
    out = tmp_path / "run"
    out.mkdir()
    (out / "old.csv").write_text("old")
    with whole_folder(out, overwrite=True) as folder:
        (folder / "new.csv").write_text("new")
    assert [path.name for path in tmp_path.rglob("*")] == ["run", "new.csv"]


def test_a_full_folder_is_refused_before_the_block_runs(tmp_path: Path) -> None:
    (tmp_path / "kept.csv").write_text("kept")
    with pytest.raises(InputError, match="--overwrite"), whole_folder(tmp_path):
        pytest.fail("the block must not run")
    assert [path.name for path in tmp_path.iterdir()] == ["kept.csv"]


def test_an_empty_folder_is_free_and_a_file_never_is(tmp_path: Path) -> None:
    require_free(tmp_path, overwrite=False)
    file = tmp_path / "file"
    file.write_text("")
    with pytest.raises(InputError, match="a file"):
        require_free(file, overwrite=True)


def test_a_whole_file_appears_only_when_its_block_ends_well(tmp_path: Path) -> None:
    path = tmp_path / "page.html"
    with pytest.raises(RuntimeError), whole_file(path) as staging:  # noqa: PT012 - it fails half way
        staging.write_text("half")
        raise RuntimeError
    assert list(tmp_path.iterdir()) == []
    with whole_file(path) as staging:
        staging.write_text("whole")
    assert [entry.name for entry in tmp_path.iterdir()] == ["page.html"]
    assert path.read_text() == "whole"
