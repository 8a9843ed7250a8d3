"""A dataset on a page: its impacts, left out and used again."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from opened import address, contents, served
from written_drops import by_init, drop, plan_of_drops, write

import bayestissue as bt
from bayestissue.recordings.dataset import write_dataset
from bayestissue.recordings.dataset.left_out import reasons, write_left_out
from bayestissue.studies.bench.views import DatasetView
from dataset_bench import SETTINGS, tables

pytestmark = pytest.mark.slow

browser = pytest.importorskip(
    "browser", reason="drives a browser by websocket-client, which is not installed"
)
NAMES = plan_of_drops(4)
STEMS = [name.removesuffix(".csv") for name in NAMES]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for number, name in enumerate(NAMES):
        write(tmp_path / "recorded", name, drop(name, late_s=0.013 * (number == 1)))
    return by_init(tmp_path / "recorded", tmp_path / "set")


def test_impacts_are_left_out_used_again_and_the_last_decision_undone(folder: Path) -> None:
    write_left_out(folder, {STEMS[0]: "an earlier reason"})
    before = contents(folder)
    view = DatasetView(folder)
    state = view.state(0)
    assert [each["impact"] for each in state["drops"]] == STEMS[::-1], "the page puts each above the last"
    of_name = {each["impact"]: each for each in state["drops"]}
    assert (of_name[STEMS[0]]["left_out"], state["used"]) == ("an earlier reason", 3)
    assert of_name[STEMS[1]]["kind"] == "again"
    K, depth = of_name[STEMS[2]]["K"], of_name[STEMS[2]]["outcomes"]["depth (mm)"]
    assert K[1] < K[0] < K[2]
    assert 1 < depth[0] < 100
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
    assert contents(folder) == before
    assert STEMS[0] not in set(bt.estimate(folder)["impact"])


@pytest.mark.skipif(browser.CHROMIUM is None, reason="no Chromium is installed")
def test_keys_alone_leave_an_impact_out_and_undo_it_and_names_are_text(tmp_path: Path) -> None:
    hostile = """'"><img src=x onerror="hurt=1"><script>hurt=1</script>{{7*7}}javascript:hurt=1"""
    impacts, traces = tables()
    for name in ("impact", "subject", "trial"):
        impacts[name] += hostile
    traces["impact"] = traces["impact"].astype(str) + hostile
    settings = SETTINGS | {"name": hostile, "description": hostile}
    write_dataset(tmp_path / "set", settings=settings, impacts=impacts, traces=traces)
    first, second = impacts["impact"][:2]
    write_left_out(tmp_path / "set", {first: hostile})
    shown = f"document.querySelector('#one-title').textContent === {json.dumps(f'Trace of {second}')}"
    with served(DatasetView(tmp_path / "set")) as port, browser.Browser() as tab:
        tab.open(address(port))
        tab.until("document.querySelectorAll('#trace circle').length > 50")
        assert tab.js("document.body.innerText.includes('{{7*7}}')")
        tab.tab_to("document.activeElement.matches('#drops tbody tr')")
        tab.key("ArrowDown")
        tab.until(shown)
        tab.tab_to("document.activeElement.id === 'reason'", back=True)
        tab.type("hit the frame")
        tab.key("Enter")
        tab.until("document.querySelector('#decide-said').textContent === 'done'")
        assert reasons(tmp_path / "set") == {first: hostile, second: "hit the frame"}
        tab.until("document.querySelectorAll('#drops tr.out').length === 2")
        tab.tab_to("document.activeElement.matches('#drops tbody tr')")
        kept = tab.js("location.href")
        tab.key("u")
        tab.until("document.querySelectorAll('#drops tr.out').length === 1")
        assert reasons(tmp_path / "set") == {first: hostile}
        # The address opens the same impact.
        assert "token" not in kept
        tab.open(kept)
        tab.until(shown)
        assert tab.js("typeof hurt") == "undefined"
        assert tab.js("document.querySelectorAll('[onerror], [href^=javascript], [src=x]').length") == 0
        assert tab.errors == []
