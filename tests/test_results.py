"""Result folders: whole or not there, one writer at a time, and nothing replaced but earlier results."""

from __future__ import annotations

import json
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from bayestissue.base.errors import InputError
from bayestissue.base.results.files import whole_file
from bayestissue.base.results.manifest import require_free, require_place
from bayestissue.base.results.output_folder import GO_ON, claim

MARK = ".bayestissue.json"


@contextmanager
def results_at(out: Path, *, overwrite: bool = False, inputs: tuple[Path, ...] = ()) -> Iterator[Path]:
    with claim(out, overwrite=overwrite, command="fit", inputs=inputs) as place, place.folder() as folder:
        yield folder


def write(out: Path, text: str = "old", *, overwrite: bool = False, name: str = "table.csv") -> None:
    with results_at(out, overwrite=overwrite) as folder:
        (folder / name).write_text(text)


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


@contextmanager
def parts_of(job: str, out: Path) -> Iterator[Path]:
    with claim(out, command="fit") as place, place.unfinished(job) as parts:
        yield parts


def left_half_way(job: str, out: Path) -> pytest.ExceptionInfo[RuntimeError]:
    """A job that fails when it has finished a part of it, and half of another."""
    with pytest.raises(RuntimeError) as raised, parts_of(job, out) as parts:  # noqa: PT012 - it fails half way
        (parts / "segment").write_text("1")
        (parts / ".segment.partial-0123abcd").write_text("half")
        raise RuntimeError
    return raised


def refused(out: Path, **options: object) -> str:
    with pytest.raises(InputError) as raised, results_at(out, overwrite=True, **options):  # type: ignore[arg-type]
        pytest.fail("the block must not run")
    return str(raised.value)


def test_a_finished_folder_takes_its_name_and_leaves_nothing_beside_it(tmp_path: Path) -> None:
    out = tmp_path / "deep" / "run"
    with results_at(out) as folder:
        (folder / "a.csv").write_text("x\n1\n")
        assert not out.exists()
    assert (out / "a.csv").read_text() == "x\n1\n"
    assert names(out.parent) == ["run"]
    assert json.loads((out / MARK).read_text())["sha256"].keys() == {"a.csv"}


@pytest.mark.parametrize("earlier", [False, True])
def test_a_failure_inside_leaves_everything_as_it_was(tmp_path, earlier) -> None:
    out = tmp_path / ("run" if earlier else "deep/run")
    if earlier:
        write(out)
    with pytest.raises(KeyboardInterrupt), results_at(out, overwrite=earlier) as folder:  # noqa: PT012
        (folder / "table.csv").write_text("half")
        raise KeyboardInterrupt
    assert names(tmp_path) == ["run"] * earlier
    assert not earlier or (out / "table.csv").read_text() == "old"


@pytest.mark.parametrize("linked", [True, False])
def test_overwriting_replaces_the_whole_folder(tmp_path: Path, linked: bool) -> None:
    """Also of a dataset that `simulate` wrote; a link to it stays a link."""
    out = tmp_path / "run"
    (tmp_path / "disk").mkdir()
    if linked:
        out.symlink_to(tmp_path / "disk")
    write(out, 'name = "simulated"', name="dataset.toml")
    write(out, "new", overwrite=True)
    assert out.is_symlink() == linked
    assert names(out) == [MARK, "table.csv"]
    assert names(tmp_path) == ["disk", "run"]


@pytest.mark.parametrize("fails", [1, 2])
def test_earlier_results_are_never_lost_where_a_rename_fails(tmp_path, monkeypatch, fails) -> None:
    """Of the renames that put new results in the place of old ones, each one in turn."""
    out, rename, calls = tmp_path / "run", Path.rename, 0

    def spoilt(self: Path, target: Path) -> Path:
        nonlocal calls
        calls += 1
        if calls == fails:
            raise OSError(5, "Input/output error")
        return rename(self, target)

    write(out)
    with monkeypatch.context() as patched:
        patched.setattr(Path, "rename", spoilt)
        with pytest.raises(OSError, match="Input/output error"):
            write(out, "new", overwrite=True)
    assert (out / "table.csv").read_text() == "old"
    assert names(tmp_path) == ["run"]


def test_old_results_that_a_killed_command_was_replacing_come_back(tmp_path: Path) -> None:
    """As a kill between the two renames leaves it: the old results aside, the new ones without their name."""
    out = tmp_path / "run"
    write(out)
    out.rename(tmp_path / ".run.replaced")
    (tmp_path / ".run.partial").mkdir()
    with pytest.raises(InputError, match="--overwrite"):
        write(out, "third")
    assert (out / "table.csv").read_text() == "old"
    assert names(tmp_path) == ["run"]


@pytest.mark.parametrize("state", ["replaced", "not marked yet", "whole", "half removed"])
def test_what_a_killed_command_left_is_removed_in_whatever_state(tmp_path: Path, state: str) -> None:
    left = tmp_path / f".run.{'replaced' if state == 'replaced' else 'partial'}"
    if state == "not marked yet":
        left.mkdir()
    else:
        write(left)
    if state == "replaced":
        (left / MARK).write_text('{"unfinished": true}')
    if state == "half removed":
        (left / "table.csv").unlink()
    write(tmp_path / "run", "new")
    assert (tmp_path / "run" / "table.csv").read_text() == "new"
    assert names(tmp_path) == ["run"]


def test_an_empty_folder_is_free_and_a_full_one_and_a_file_are_not(tmp_path: Path) -> None:
    require_free(tmp_path, overwrite=False)
    file, run = tmp_path / "file", tmp_path / "run"
    file.write_text("")
    write(run)
    with pytest.raises(InputError, match="--overwrite"), results_at(run):
        pytest.fail("the block must not run")
    with pytest.raises(InputError, match="a file"):
        require_free(file, overwrite=True)
    assert "a file above it" in refused(file / "run")
    assert "too long" in refused(tmp_path / ("n" * 250))
    assert names(tmp_path) == ["file", "run"]


MINE = 'name = "mine"'
# What was written as results, what came to it, and what is found; None is a link.
NOT_OURS: dict[str, tuple[dict[str, str], dict[str, str | None], str]] = {
    "a dataset": ({}, {"dataset.toml": MINE}, "a dataset"),
    "a note beside": ({"table.csv": "old"}, {"note.txt": "mine"}, "note.txt"),
    "a dataset below": ({"table.csv": "old"}, {"data/dataset.toml": MINE}, "data/"),
    "a link": ({"table.csv": "old"}, {"posterior.nc": None}, "posterior.nc (a link)"),
    "unmarked": (
        {},
        {"run.json": '{"program": "bayestissue 0.1.0"}'},
        "nothing that says that bayestissue wrote",
    ),
    "recordings in a simulated dataset": (
        {"dataset.toml": MINE, "traces.csv": "simulated"},
        {"traces.csv": "recorded!"},
        "a dataset that was changed",
    ),
    "a dataset of a version that had one hash for all": (
        {"dataset.toml": MINE},
        {MARK: '{"program": "bayestissue", "files": {"dataset.toml": 1}, "content_hash": "0"}'},
        "a dataset",
    ),
}


@pytest.mark.parametrize(("written", "came", "found"), NOT_OURS.values(), ids=list(NOT_OURS))
def test_overwrite_replaces_nothing_that_the_program_did_not_write(tmp_path, written, came, found) -> None:
    out = tmp_path / "run"
    if written:
        with results_at(out) as folder:
            for name, text in written.items():
                (folder / name).write_text(text)
    for name, content in came.items():
        (out / name).parent.mkdir(parents=True, exist_ok=True)
        if content is None:
            (out / name).symlink_to(tmp_path)
        else:
            (out / name).write_text(content)
    before = sorted(path.relative_to(tmp_path) for path in tmp_path.rglob("*"))
    assert found in refused(out)
    assert sorted(path.relative_to(tmp_path) for path in tmp_path.rglob("*")) == before


def test_results_never_stand_in_the_place_of_what_matters(tmp_path, monkeypatch) -> None:
    home, data = tmp_path / "home", tmp_path / "lab" / "data"
    for folder in (home / "work", data):
        folder.mkdir(parents=True)
    monkeypatch.setenv("HOME", str(home))
    monkeypatch.chdir(data)
    for out in ("", ".", "..", "/", tmp_path, home):
        with pytest.raises(InputError):
            require_place(Path(out))
    monkeypatch.chdir(home / "work")
    link = tmp_path / "link"
    link.symlink_to(data)
    for out in (data, data.parent, link):
        assert "what this command reads" in refused(out, inputs=(data / "model.toml",))
    assert "what this command reads" in refused(data, inputs=(link,))
    (data / "model.toml").touch()
    assert "what this command reads" in refused(data, inputs=(str(data / "model.toml"),))
    write(tmp_path / "run", "old")
    assert "inside other results" in refused(tmp_path / "run" / "more")
    assert require_place(data / "results", (data,)) == data / "results"
    # The name of a model of the program is no file.
    assert require_place(Path("impact"), ("impact", None)) == home / "work" / "impact"


def test_a_second_command_is_refused_and_told_who_writes(tmp_path: Path) -> None:
    out = tmp_path / "run"
    with results_at(out) as folder:
        (folder / "table.csv").write_text("first")
        with pytest.raises(InputError, match=f"in use by process {os.getpid()}"):
            write(out, "second")
    assert (out / "table.csv").read_text() == "first"
    assert names(tmp_path) == ["run"]


@pytest.mark.parametrize("overwrite", [False, True])
def test_what_took_the_name_meanwhile_stays(tmp_path: Path, overwrite: bool) -> None:
    """And finished parts of the job too, for the same command again."""
    out = tmp_path / "run"
    with (  # noqa: PT012 - it fails half way
        pytest.raises(InputError) as raised,
        claim(out, command="fit", overwrite=overwrite) as place,
        place.unfinished("job") as parts,
    ):
        (parts / "segment").write_text("1")
        with place.folder() as folder:
            (folder / "table.csv").write_text("finished")
            out.mkdir()
            (out / "mine.txt").write_text("mine")
    assert raised.value.problems[0].code == "out-taken"
    assert raised.value.__notes__ == [GO_ON]
    assert names(out) == ["mine.txt"]
    assert names(tmp_path) == [".run.unfinished", "run"]


def test_parts_of_a_job_wait_for_the_next_run_of_the_same_job(tmp_path: Path) -> None:
    out = tmp_path / "run"
    assert left_half_way("one", out).value.__notes__ == [GO_ON]
    with parts_of("one", out) as parts:
        assert names(parts) == ["segment"]
    assert names(tmp_path) == []
    left_half_way("one", out)
    with parts_of("another", out) as parts:
        assert names(parts.parent) == [MARK, "another"]
    with pytest.raises(KeyboardInterrupt) as raised, parts_of("one", out):
        raise KeyboardInterrupt
    # Without parts nothing is promised.
    assert not hasattr(raised.value, "__notes__")
    assert names(tmp_path) == []


def test_a_power_cut_leaves_the_old_file_or_the_whole_new_one(tmp_path, monkeypatch) -> None:
    steps: list[str] = []
    synced, replaced = os.fsync, os.replace

    def sync(descriptor: int) -> None:
        is_folder = stat.S_ISDIR(os.fstat(descriptor).st_mode)
        steps.append("folder" if is_folder else f"{os.fstat(descriptor).st_size} bytes")
        synced(descriptor)

    def replace(*args: Any) -> None:
        steps.append("name")
        replaced(*args)

    monkeypatch.setattr(os, "fsync", sync)
    monkeypatch.setattr(os, "replace", replace)
    monkeypatch.setattr(Path, "replace", lambda self, target: replace(self, target))
    with whole_file(tmp_path / "new" / "table.csv") as staging:
        staging.write_text("12345")
    assert steps == ["5 bytes", "name", "folder", "folder"]


def test_a_whole_file_appears_only_when_its_block_ends_well(tmp_path: Path) -> None:
    path = tmp_path / "page.html"
    with pytest.raises(RuntimeError), whole_file(path) as staging:  # noqa: PT012 - it fails half way
        staging.write_text("half")
        raise RuntimeError
    assert list(tmp_path.iterdir()) == []
    with whole_file(path) as staging:
        staging.write_text("whole")
    assert names(tmp_path) == ["page.html"]
    assert path.read_text() == "whole"


@pytest.mark.parametrize("linked", [True, False])
@pytest.mark.parametrize(
    ("beside", "inside"),
    [("unfinished", "one/thesis.txt"), ("partial", "thesis.txt"), ("replaced", "thesis.txt"), ("lock", "")],
)
def test_what_no_command_left_beside_results_is_refused_and_stays(tmp_path, beside, inside, linked) -> None:
    """Links and a person's own, whatever they are called."""
    place, mine = tmp_path / f".run.{beside}", tmp_path / "mine"
    own = (mine if linked else place) / inside
    own.parent.mkdir(parents=True, exist_ok=True)
    own.write_text("mine")
    if linked:
        place.symlink_to(mine)
    with (
        pytest.raises(InputError, match="a link" if linked else "no command") as raised,
        claim(tmp_path / "run", overwrite=True, command="fit") as claimed,
        claimed.unfinished("one"),
        claimed.folder(),
    ):
        pytest.fail("the block must not run")
    assert raised.value.problems[0].code == "out-taken"
    assert own.read_text() == "mine"
    assert place.is_symlink() == linked


def test_links_among_parts_are_removed_and_not_what_they_lead_to(tmp_path: Path) -> None:
    out, mine = tmp_path / "run", tmp_path / "mine"
    mine.mkdir()
    (mine / "thesis.txt").write_text("mine")
    left_half_way("one", out)
    for name in ("two", "three"):
        (tmp_path / ".run.unfinished" / name).symlink_to(mine)
    with parts_of("two", out) as parts:
        assert names(parts) == []
        (parts / "thesis.txt").write_text("a part")
    assert names(tmp_path) == ["mine"]
    assert (mine / "thesis.txt").read_text() == "mine"
