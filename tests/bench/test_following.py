"""Which files count as whole, told from their stamps alone."""

from __future__ import annotations

from pathlib import Path

from bayestissue.studies.bench.following import Changes, Follower, Stamp, listing

ONE, TWO, MORE = Stamp(10, 1), Stamp(20, 2), Stamp(30, 3)
NOTHING = Changes((), (), ())


def test_a_file_is_ready_when_it_stands_still() -> None:
    follower = Follower()
    assert follower.changes({"a": ONE}) == NOTHING
    assert follower.changes({"a": TWO}) == NOTHING, "it grows"
    assert follower.changes({"a": TWO}).ready == ("a",)
    follower.settled["a"] = TWO
    assert follower.changes({"a": TWO}) == NOTHING, "it was taken"
    assert follower.changes({"a": MORE}) == NOTHING
    assert follower.changes({"a": MORE}).ready == ("a",), "it was overwritten"


def test_empty_and_deleted_files_are_said_once_and_again_when_it_happens_again() -> None:
    follower, empty = Follower({"gone": ONE}), Stamp(0, 5)
    assert follower.changes({"a": empty}) == Changes((), (), ("gone",))
    assert follower.changes({"a": empty}) == Changes((), ("a",), ())
    assert follower.changes({"a": empty}) == NOTHING
    follower.changes({"a": TWO, "gone": ONE})
    assert follower.changes({"a": TWO, "gone": ONE}).ready == ("a",), "what came back is what was taken"
    assert follower.changes({"a": TWO}).gone == ("gone",)


def test_recordings_are_listed_and_datasets_and_notes_are_not(tmp_path: Path) -> None:
    for name in ("a.csv", "inner/b.csv", ".hidden.csv", "notes.docx", "set/dataset.toml", "set/c.csv"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text("x")
    assert sorted(listing(tmp_path)) == ["a.csv", "inner/b.csv"]
