"""A dataset on a page: its impacts, left out and used again."""

from __future__ import annotations

import hashlib
from pathlib import Path

import pytest
from written_drops import PATTERN, VELOCITY, drop, plan_of_drops, write

import bayestissue as bt
from bayestissue.bench.views import DatasetView
from bayestissue.dataset.left_out import FILE, reasons, write_left_out

NAMES = plan_of_drops(4)
STEMS = [name.removesuffix(".csv") for name in NAMES]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for number, name in enumerate(NAMES):
        write(tmp_path / "recorded", name, drop(name, late_s=0.013 * (number == 1)))
    given = {"velocity_m_s": VELOCITY}
    out = tmp_path / "set"
    bt.init_dataset(
        tmp_path / "recorded", out, pattern=PATTERN, quantity="deceleration", unit="m/s^2", given=given
    )
    return out


def test_impacts_are_left_out_used_again_and_the_last_decision_undone(folder: Path) -> None:
    write_left_out(folder, {STEMS[0]: "an earlier reason"})
    files = [path for path in sorted(folder.rglob("*")) if path.is_file() and path.name != FILE]
    before = [hashlib.sha256(path.read_bytes()).hexdigest() for path in files]
    view = DatasetView(folder)
    state = view.state(0)
    assert [each["impact"] for each in state["drops"]] == STEMS[::-1], "the page puts each above the last"
    of_name = {each["impact"]: each for each in state["drops"]}
    assert (of_name[STEMS[0]]["left_out"], state["used"]) == ("an earlier reason", 3)
    assert of_name[STEMS[1]]["kind"] == "again"
    assert of_name[STEMS[2]]["K"][1] < of_name[STEMS[2]]["K"][0] < of_name[STEMS[2]]["K"][2]
    assert len(view.drop(STEMS[0])["trace"]["recorded"]) > 50, "also of one that is left out"
    view.act("decide", {"impact": STEMS[1], "reason": "late"})
    view.act("decide", {"impact": STEMS[0], "reason": ""})
    assert reasons(folder) == {STEMS[1]: "late"}
    assert [each["impact"] for each in view.state(state["version"])["drops"]] == [STEMS[1], STEMS[0]]
    view.act("take-back", {})
    assert reasons(folder) == {STEMS[0]: "an earlier reason", STEMS[1]: "late"}
    view.act("take-back", {})
    assert reasons(folder) == {STEMS[0]: "an earlier reason"}
    for action, content in (
        ("take-back", {}),
        ("decide", {"impact": "nobody", "reason": "x"}),
        ("choose", {"impact": STEMS[0]}),
    ):
        with pytest.raises(KeyError):
            view.act(action, content)
    assert reasons(folder) == {STEMS[0]: "an earlier reason"}
    assert [hashlib.sha256(path.read_bytes()).hexdigest() for path in files] == before
    assert STEMS[0] not in set(bt.estimate(folder)["impact"])
