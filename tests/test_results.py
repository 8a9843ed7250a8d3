"""Result folders: whole or not there, one writer at a time, and nothing replaced but earlier results."""

from __future__ import annotations

import json
import os
import stat
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from bayestissue.base.errors import InputError
from bayestissue.base.results.files import whole_file
from bayestissue.base.results.manifest import require_free, require_place
from bayestissue.base.results.output_folder import GO_ON, claim


@contextmanager
def results_at(out: Path, *, overwrite: bool = False, inputs: tuple[Path, ...] = ()) -> Iterator[Path]:
    with claim(out, overwrite=overwrite, command="fit", inputs=inputs) as place, place.folder() as folder:
        yield folder


def write(out: Path, text: str, *, overwrite: bool = False) -> None:
    with results_at(out, overwrite=overwrite) as folder:
        (folder / "table.csv").write_text(text)


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


@contextmanager
def parts_of(job: str, out: Path) -> Iterator[Path]:
    with claim(out, command="fit") as place, place.unfinished(job) as parts:
        yield parts


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
    assert json.loads((out / ".bayestissue.json").read_text())["sha256"].keys() == {"a.csv"}


@pytest.mark.parametrize("failure", [RuntimeError, KeyboardInterrupt, SystemExit])
def test_a_failure_inside_leaves_neither_folder_nor_staging(
    tmp_path: Path, failure: type[BaseException]
) -> None:
    with pytest.raises(failure), results_at(tmp_path / "deep" / "run") as folder:  # noqa: PT012 - it fails half way
        (folder / "half.csv").write_text("half")
        raise failure
    assert list(tmp_path.iterdir()) == []


def test_a_failed_replacement_leaves_the_old_results_as_they_were(tmp_path: Path) -> None:
    out = tmp_path / "run"
    write(out, "old")
    with pytest.raises(RuntimeError), results_at(out, overwrite=True) as folder:  # noqa: PT012 - it fails half way
        (folder / "table.csv").write_text("new")
        raise RuntimeError
    assert (out / "table.csv").read_text() == "old"
    assert names(tmp_path) == ["run"]


def test_overwriting_replaces_the_whole_folder(tmp_path: Path) -> None:
    out = tmp_path / "run"
    with results_at(out) as folder:
        (folder / "other.csv").write_text("old")
    write(out, "new", overwrite=True)
    assert names(out) == [".bayestissue.json", "table.csv"]
    assert names(tmp_path) == ["run"]


@pytest.mark.parametrize("fails", [1, 2])
def test_earlier_results_are_never_lost_where_a_rename_fails(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fails: int
) -> None:
    """Of the renames that put new results in the place of old ones, each one in turn."""
    out, rename, calls = tmp_path / "run", Path.rename, 0

    def spoilt(self: Path, target: Path) -> Path:
        nonlocal calls
        calls += 1
        if calls == fails:
            raise OSError(5, "Input/output error")
        return rename(self, target)

    write(out, "old")
    with monkeypatch.context() as patched:
        patched.setattr(Path, "rename", spoilt)
        with pytest.raises(OSError, match="Input/output error"):
            write(out, "new", overwrite=True)
    assert (out / "table.csv").read_text() == "old"
    assert names(tmp_path) == ["run"]


def test_old_results_that_a_killed_command_was_replacing_come_back(tmp_path: Path) -> None:
    """As a kill between the two renames leaves it: the old results aside, the new ones without their name."""
    out = tmp_path / "run"
    write(out, "old")
    out.rename(tmp_path / ".run.replaced")
    (tmp_path / ".run.partial").mkdir()
    with pytest.raises(InputError, match="--overwrite"):
        write(out, "third")
    assert (out / "table.csv").read_text() == "old"
    assert names(tmp_path) == ["run"]


def test_old_results_that_a_killed_command_had_replaced_go(tmp_path: Path) -> None:
    """As a kill while they are removed leaves them."""
    out, replaced = tmp_path / "run", tmp_path / ".run.replaced"
    write(replaced, "old")
    (replaced / ".bayestissue.json").write_text('{"unfinished": true}')
    write(out, "new")
    assert (out / "table.csv").read_text() == "new"
    assert names(tmp_path) == ["run"]


def test_a_full_folder_is_refused_before_the_block_runs(tmp_path: Path) -> None:
    out = tmp_path / "run"
    write(out, "old")
    with pytest.raises(InputError, match="--overwrite"), results_at(out):
        pytest.fail("the block must not run")
    assert names(tmp_path) == ["run"]


def test_an_empty_folder_is_free_and_a_file_never_is(tmp_path: Path) -> None:
    require_free(tmp_path, overwrite=False)
    file = tmp_path / "file"
    file.write_text("")
    with pytest.raises(InputError, match="a file"):
        require_free(file, overwrite=True)
    assert "a file above it" in refused(file / "run")
    assert "too long" in refused(tmp_path / ("n" * 250))
    assert names(tmp_path) == ["file"]


def a_dataset(out: Path) -> str:
    out.mkdir()
    (out / "dataset.toml").write_text('name = "mine"')
    return "a dataset"


def results_and_a_note(out: Path) -> str:
    write(out, "old")
    (out / "note.txt").write_text("mine")
    return "note.txt"


def results_and_a_dataset_below(out: Path) -> str:
    write(out, "old")
    (out / "data").mkdir()
    (out / "data" / "dataset.toml").write_text('name = "mine"')
    return "data/"


def results_and_a_link(out: Path) -> str:
    write(out, "old")
    (out / "posterior.nc").symlink_to(out.parent)
    return "posterior.nc (a link)"


def someone_elses(out: Path) -> str:
    out.mkdir()
    (out / "run.json").write_text('{"program": "another"}')
    return "nothing that says that bayestissue wrote it"


def a_simulated_dataset_with_recordings_put_in(out: Path) -> str:
    with results_at(out) as folder:
        (folder / "dataset.toml").write_text('name = "simulated"')
        (folder / "traces.csv").write_text("simulated")
    (out / "traces.csv").write_text("recorded!")
    return "a dataset that was changed"


def earlier_results(out: Path) -> str:
    """As a version without marks wrote them."""
    out.mkdir()
    (out / "run.json").write_text('{"program": "bayestissue 0.1.0", "command": "estimate"}')
    (out / "estimates.csv").write_text("")
    return "nothing that says that bayestissue wrote it"


def an_earlier_dataset(out: Path) -> str:
    """As a version wrote it that had one hash for all."""
    with results_at(out) as folder:
        (folder / "dataset.toml").write_text('name = "simulated"')
    mark = json.loads((out / ".bayestissue.json").read_text())
    mark["files"], mark["content_hash"] = dict.fromkeys(mark.pop("sha256"), 1), "0"
    (out / ".bayestissue.json").write_text(json.dumps(mark))
    return "a dataset"


@pytest.mark.parametrize(
    "make",
    [
        a_dataset,
        results_and_a_note,
        results_and_a_dataset_below,
        results_and_a_link,
        someone_elses,
        a_simulated_dataset_with_recordings_put_in,
        earlier_results,
        an_earlier_dataset,
    ],
)
def test_overwrite_replaces_nothing_that_the_program_did_not_write(
    tmp_path: Path, make: Callable[[Path], str]
) -> None:
    out = tmp_path / "run"
    found = make(out)
    before = sorted(path.relative_to(tmp_path) for path in tmp_path.rglob("*"))
    assert found in refused(out)
    assert sorted(path.relative_to(tmp_path) for path in tmp_path.rglob("*")) == before


def test_overwrite_replaces_what_simulate_wrote(tmp_path: Path) -> None:
    for _ in range(2):
        with results_at(tmp_path / "simulated", overwrite=True) as folder:
            (folder / "dataset.toml").write_text('name = "simulated"')
    assert names(tmp_path) == ["simulated"]


def test_committed_results_can_be_replaced() -> None:
    reports = Path(__file__).resolve().parents[1] / "docs" / "reports"
    for name in ("example", "published"):
        require_free(reports / name, overwrite=True)


def test_results_never_stand_in_the_place_of_what_matters(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
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


def test_results_may_have_the_name_of_a_model_of_the_program(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for _ in range(2):
        assert require_place(Path("impact"), ("impact", None)) == tmp_path / "impact"
        (tmp_path / "impact").mkdir(exist_ok=True)


def test_a_link_stays_a_link(tmp_path: Path) -> None:
    (tmp_path / "disk").mkdir()
    (tmp_path / "out").symlink_to(tmp_path / "disk")
    write(tmp_path / "out", "new")
    assert (tmp_path / "out").is_symlink()
    assert (tmp_path / "disk" / "table.csv").read_text() == "new"


def test_a_second_command_is_refused_and_told_who_writes(tmp_path: Path) -> None:
    out = tmp_path / "run"
    with results_at(out) as folder:
        (folder / "table.csv").write_text("first")
        with pytest.raises(InputError, match=f"in use by process {os.getpid()}"):
            write(out, "second")
    assert (out / "table.csv").read_text() == "first"
    assert names(tmp_path) == ["run"]


KILLED = """
import os, signal, sys
from pathlib import Path
from typing import Any
from bayestissue.base.results.output_folder import claim
with claim(Path(sys.argv[1]), command="fit") as place, place.folder() as folder:
    (folder / "table.csv").write_text("half")
    os.kill(os.getpid(), signal.SIGKILL)
"""


def test_a_killed_command_leaves_nothing_that_blocks_or_stays(tmp_path: Path) -> None:
    out = tmp_path / "run"
    ended = subprocess.run([sys.executable, "-c", KILLED, str(out)], check=False)  # noqa: S603 - our own program
    assert ended.returncode < 0
    assert len(names(tmp_path)) == 2
    write(out, "whole")
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
    with pytest.raises(RuntimeError) as raised, parts_of("one", out) as parts:  # noqa: PT012 - it fails half way
        (parts / "segment").write_text("1")
        (parts / ".segment.partial-0123abcd").write_text("half")
        raise RuntimeError
    assert raised.value.__notes__ == [GO_ON]
    with parts_of("one", out) as parts:
        assert names(parts) == ["segment"]
        assert "one" in str(parts)
    assert names(tmp_path) == []


def test_parts_of_another_job_are_not_taken_for_ones_own(tmp_path: Path) -> None:
    with pytest.raises(RuntimeError), parts_of("one", tmp_path / "run") as parts:  # noqa: PT012 - it fails half way
        (parts / "segment").write_text("1")
        raise RuntimeError
    with parts_of("two", tmp_path / "run") as parts:
        assert names(parts) == []
        assert names(parts.parent) == [".bayestissue.json", "two"]


def test_without_parts_nothing_is_left_and_nothing_promised(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt) as raised, parts_of("one", tmp_path / "run"):
        raise KeyboardInterrupt
    assert not hasattr(raised.value, "__notes__")
    assert names(tmp_path) == []


def test_a_power_cut_leaves_the_old_file_or_the_whole_new_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
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


def a_persons_own(folder: Path) -> Path:
    folder.mkdir(parents=True)
    (folder / "thesis.txt").write_text("mine")
    return folder


@pytest.mark.parametrize("linked", [True, False])
@pytest.mark.parametrize("inside", ["", "one"])
def test_what_no_job_left_is_refused_where_parts_go_and_stays(
    tmp_path: Path, linked: bool, inside: str
) -> None:
    """Links and a person's own folders, whatever they are called."""
    out, parts = tmp_path / "run", tmp_path / ".run.unfinished"
    mine = a_persons_own((tmp_path / "mine" if linked else parts) / inside)
    if linked:
        parts.symlink_to(tmp_path / "mine")
    with (
        pytest.raises(InputError, match="a link" if linked else "no command") as raised,
        parts_of("one", out),
    ):
        pytest.fail("the block must not run")
    assert raised.value.problems[0].code == "out-taken"
    assert names(mine) == ["thesis.txt"]


def test_links_among_parts_are_removed_and_not_what_they_lead_to(tmp_path: Path) -> None:
    out, mine = tmp_path / "run", a_persons_own(tmp_path / "mine")
    with pytest.raises(RuntimeError), parts_of("one", out) as parts:  # noqa: PT012 - it fails half way
        (parts / "segment").write_text("1")
        raise RuntimeError
    (parts.parent / "two").symlink_to(mine)
    (parts.parent / "three").symlink_to(mine)
    with parts_of("two", out) as parts:
        assert names(parts) == []
        (parts / "thesis.txt").write_text("a part")
    assert names(tmp_path) == ["mine"]
    assert (mine / "thesis.txt").read_text() == "mine"


@pytest.mark.parametrize("kind", ["partial", "replaced"])
@pytest.mark.parametrize("linked", [True, False])
def test_a_persons_own_beside_results_is_refused_and_stays(tmp_path: Path, kind: str, linked: bool) -> None:
    out, beside = tmp_path / "run", tmp_path / f".run.{kind}"
    mine = a_persons_own(tmp_path / "mine" if linked else beside)
    if linked:
        beside.symlink_to(mine)
    assert "a link" if linked else "no command" in refused(out)
    assert names(mine) == ["thesis.txt"]
    assert beside.is_symlink() == linked


@pytest.mark.parametrize("linked", [True, False])
def test_a_lock_is_no_file_of_a_person(tmp_path: Path, linked: bool) -> None:
    lock, mine = tmp_path / ".run.lock", tmp_path / "mine"
    (mine if linked else lock).write_text("mine")
    if linked:
        lock.symlink_to(mine)
    assert "a link" if linked else "no command" in refused(tmp_path / "run")
    assert lock.read_text() == "mine"


@pytest.mark.parametrize("state", ["not marked yet", "whole", "half removed"])
def test_what_a_killed_command_left_is_removed_in_whatever_state(tmp_path: Path, state: str) -> None:
    partial = tmp_path / ".run.partial"
    if state == "not marked yet":
        partial.mkdir()
    else:
        write(partial, "old")
    if state == "half removed":
        (partial / "table.csv").unlink()
    write(tmp_path / "run", "new")
    assert names(tmp_path) == ["run"]
