"""A plan carried out, by a stand-in for the kernel: what is chosen, kept, said and shown."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import bayestissue as bt
from bayestissue.base.errors import InputError
from bayestissue.base.results.tables import read_table
from bayestissue.reports.pages.plan_page import page_of
from bayestissue.studies.planning.plan import Plan
from command_line import Outcome, bayestissue, options
from page_reader import Reader
from stand_in_planner import kernel

EXPONENT = "mass_exponent_K < 0.5"
PLAN = """
[candidates]
people = [20, 40, 60, 90]
masses_kg = [0.5, 1.0]
repeats = [1, 2]
[questions]
exponent = "mass_exponent_K < 0.5"
[precision]
person = { of = "K[subject=new]", relative = 0.2 }
[cost]
person_min = 10
[goal]
studies = 100
"""


def command(out: Path, **given: object) -> Outcome:
    """The command of a plan that asks whether the exponent is below a half."""
    return bayestissue("plan", *options(**{"masses": "0.5,1", "ask": EXPONENT, "out": out} | given))


def argued(**given: Any) -> Plan:
    """The same from Python."""
    return bt.plan(**{"masses_kg": [0.5, 1.0], "ask": EXPONENT, "studies": 100} | given)


@pytest.fixture(scope="module")
def two_goals(tmp_path_factory: pytest.TempPathFactory) -> Plan:
    path = tmp_path_factory.mktemp("plan") / "plan.toml"
    path.write_text(PLAN)
    with kernel():
        return bt.plan(path)


def test_the_cheapest_design_that_answers_is_chosen(two_goals: Plan) -> None:
    # 160 impacts answer with 0.8: 40 people twice for 40 * 10 + 160 + 40 * 2 minutes, or 80 people once.
    content = two_goals.content
    chosen = content["designs"][content["chosen"] - 1]
    assert content["reaches"]
    assert (chosen["people"], chosen["repeats"], chosen["minutes"]) == (40, 2, 640)
    assert chosen["goals"]["exponent"]["answered"] == chosen["goals"]["person"]["answered"] == 0.8
    assert two_goals.answer.startswith("40 people, each hit 2 times by 0.5 and 1 kg at 1.5 m/s (160 impacts")
    # More of one thing, and one truth, stand beside it.
    variants = content["variants"]
    assert set(variants) == {"more people", "one truth"}
    assert variants["more people"]["people"] == 50
    assert variants["more people"]["goals"]["exponent"]["answered"] == 1


def test_every_share_has_its_error(two_goals: Plan) -> None:
    rows = two_goals.designs.set_index(["people", "repeats", "goal"])
    row = rows.loc[(20, 1, "exponent")]
    assert row["se"] == pytest.approx((0.2 * 0.8 / 100) ** 0.5)
    assert row["answered"] == pytest.approx(row["yes"] + row["no"])
    assert row["undecided"] == pytest.approx(0.8)
    # Three of a hundred truths are another than the answer.
    assert row["misleads"] == pytest.approx(0.03)
    # All answered, and still not sure of it.
    assert rows.loc[(90, 2, "exponent"), "se"] == pytest.approx((101 / 102 / 102 / 100) ** 0.5)
    assert np.isnan(rows.loc[(20, 1, "person"), "misleads"])
    assert rows.loc[(20, 1, "person"), "width_q80"] == pytest.approx(0.24)


def test_what_limits_the_answer_is_said(two_goals: Plan) -> None:
    limits = two_goals.content["limits"]
    assert list(limits) == ["people", "impacts", "trial", "noise", "chain"]
    assert (limits["people"]["people"], limits["impacts"]["repeats"]) == (80, 4)
    # The stand-in knows impacts alone: all studies answer with twice as many, 0.8 with any recorder.
    gains = [limit["goals"]["exponent"]["gain"] for limit in limits.values()]
    assert gains == pytest.approx([0.2, 0.2, 0, 0, 0])
    first, second = two_goals.content["limiting"]
    assert first.startswith(
        "Exponent: most would be gained by twice the people (answers 0.20 ± 0.04 more often), then by twice"
    )
    assert "nothing that shows by conditions that differ in mass and velocity alone, a recorder" in first
    assert second.startswith("Person: most")
    assert first in page_of(two_goals.content, two_goals.designs, two_goals.about)


def test_where_no_design_answers_many_people_are_tried() -> None:
    with kernel(most=0.6):
        plan = argued(people=[20, 60])
    assert not plan.content["reaches"]
    assert plan.content["variants"]["many people"]["people"] == 240
    assert "240 people would not either, 0.60 ± 0.05: however many people there are" in plan.answer
    assert "can't be told from the effects (1|trial) of its 2 conditions. More conditions" in plan.answer


def test_a_design_beyond_a_machine_s_memory_is_refused_with_the_bound() -> None:
    with pytest.raises(InputError, match="at most 1000 people in a design, and not 1000000"):
        argued(people=1_000_000)
    with pytest.raises(InputError, match="at most 50000 impacts in a design, and not 20 people"):
        argued(people=20, repeats=10_000)


@pytest.mark.slow
def test_the_hash_is_of_all_but_the_words(two_goals: Plan) -> None:
    with kernel():
        same, other, again = (argued(people=20, studies=studies) for studies in (100, 200, 100))
    assert same.content == again.content
    assert same.content["sha256"] != other.content["sha256"]


def test_the_question_names_the_factor() -> None:
    with kernel():
        plan = argued(people=20, masses_kg=0.7, ask="K[side=left] / K[side=right] > 1.1")
    assert plan.content["plan"]["candidates"]["factors"][0]["levels"] == ["left", "right"]
    assert plan.designs["impacts"].tolist() == [40]


RECORDERS = """
[[candidates.recorders]]
name = "phone"
sampling_rate_hz = 2000
noise_relative_to_peak = 0.05
[[candidates.recorders]]
name = "lab"
noise_relative_to_peak = 0.001
"""


def test_groups_of_people_stand_in_the_answer_the_paragraph_and_the_page() -> None:
    groups, question = {"group": ["treated", "control"]}, "K[group=treated] > K[group=control]"
    with kernel():
        plan = argued(people=[9, 21], masses_kg=0.7, groups=groups, ask=question, repeats=20)
    said = "9 people (group: 5 treated and 4 control), each hit 20 times"
    assert said in plan.answer
    assert said in plan.paragraph
    assert said in page_of(plan.content, plan.designs, plan.about)


@pytest.mark.slow
def test_recorders_are_candidates(tmp_path: Path) -> None:
    path = tmp_path / "plan.toml"
    path.write_text(PLAN.replace("[questions]", RECORDERS + "[questions]"))
    with kernel() as stand_in:
        plan = bt.plan(path)
    # Each recorder's designs have a measuring chain, and so a planner, of their own.
    assert stand_in.calls[:2] == 2 * [(8, range(1))]
    assert plan.designs.groupby("recorder", sort=False).size().to_dict() == {"phone": 16, "lab": 16}
    # Of equals the first listed.
    assert ", recorded by phone (160 impacts" in plan.answer
    assert "Which recorder?" in page_of(plan.content, plan.designs, plan.about)


@pytest.mark.slow
def test_the_command_writes_all_or_nothing(tmp_path: Path) -> None:
    out = tmp_path / "out"
    with kernel():
        ended = command(out, people="20,60", studies=100)
    assert ended.status == 0, ended.err
    assert "60 people, each hit once" in ended.out
    names = {path.name for path in out.iterdir()}
    written = {"designs.csv", "plan.json", "report.html", "run.json", "studies.parquet"}
    assert names == written | {".bayestissue.json"}
    assert [path.name for path in tmp_path.iterdir()] == ["out"]
    refused = command(tmp_path / "no", people="2,x", masses="0.5,")
    assert refused.status == 2
    assert "2 problems; nothing was written" in refused.err
    assert not (tmp_path / "no").exists()


def test_a_file_and_options_are_not_mixed(tmp_path: Path) -> None:
    path = tmp_path / "plan.toml"
    path.write_text(PLAN)
    refused = bayestissue("plan", path, "--people", "10", "--out", tmp_path / "out")
    assert (refused.status, "PLAN.toml or --people" in refused.err) == (2, True)
    refused = bayestissue("plan", "--people", "10", "--within", "side", "--out", tmp_path / "out")
    assert (refused.status, "--masses" in refused.err) == (2, True)
    # Nor arguments of the function, which would be passed over without a word.
    with pytest.raises(InputError, match="people, and not both"):
        bt.plan(path, people=20)


@pytest.mark.slow
def test_more_studies_and_designs_go_on_from_what_is_there(tmp_path: Path) -> None:
    out = tmp_path / "out"
    with kernel() as stand_in:
        assert command(out, people=60, studies=200, overwrite=True).status == 0
        assert {blocks for _, blocks in stand_in.calls} == {range(2)}
        stand_in.calls.clear()
        assert command(out, people=60, studies=200, overwrite=True).status == 0
        assert stand_in.calls == []
        assert command(out, people="60,80", studies=400, overwrite=True).status == 0
    # Of the first design further blocks, of the new one all.
    assert (1, range(2, 4)) in stand_in.calls
    assert (1, range(4)) in stand_in.calls
    assert read_table(out, "designs")["studies"].tolist() == [400, 400]


@pytest.mark.slow
def test_an_interrupted_plan_goes_on(tmp_path: Path) -> None:
    out = tmp_path / "out"
    with kernel() as stand_in:
        real = stand_in.__class__.__call__

        def stopped(self: object, *args: object, **settings: object) -> object:
            if len(stand_in.calls) >= 2:
                raise KeyboardInterrupt
            return real(stand_in, *args, **settings)

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(stand_in.__class__, "__call__", stopped)
            ended = command(out, people="20,60", studies=1000)
        assert ended.status != 0
        assert not out.exists()
        before = len(stand_in.calls)
        assert command(out, people="20,60", studies=1000).status == 0
    # Candidates and further people were kept; one truth, three other limits, and many people were left.
    assert stand_in.calls[before:] == 5 * [(1, range(2))]
    assert json.loads((out / "plan.json").read_text())["designs"][0]["goals"]["question_1"]["studies"] == 1000
    assert not list(tmp_path.glob(".out*"))


def test_the_page_answers_its_title_on_the_first_screen(two_goals: Plan) -> None:
    page = page_of(two_goals.content, two_goals.designs, two_goals.about)
    reader = Reader()
    reader.feed(page)
    assert reader.open == []
    assert not reader.unnamed
    assert not reader.sources
    first = page[: page.index("<main>")]
    for part in (two_goals.answer, "11 hours", "0.80 ± 0.04", "10 more people"):
        assert part in first, part
    sha256 = two_goals.content["sha256"]
    assert sha256 in page
    for part in ("whether mass_exponent_K < 0.5", "the power is 0.80 and 0.80", sha256[:12]):
        assert part in two_goals.paragraph


@pytest.mark.slow
def test_traces_that_no_normal_stands_for_are_warned_of(tmp_path: Path) -> None:
    with kernel(normal=False):
        ended = command(tmp_path / "out", people=60, studies=100)
    assert "explain traces-not-normal" in ended.out
    assert "Traces are no normal densities" in (tmp_path / "out" / "report.html").read_text()


def test_a_written_plan_is_drawn_anew_and_read_whole(two_goals: Plan, tmp_path: Path) -> None:
    path = two_goals.report(tmp_path / "plan")
    page = path.read_text()
    path.unlink()
    assert bayestissue("report", tmp_path / "plan").status == 0
    assert path.read_text() == page
    assert json.loads((tmp_path / "plan" / "plan.json").read_text()) == two_goals.content
    assert "40 people" in repr(two_goals)
