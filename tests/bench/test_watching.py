"""A recorder's folder becomes a dataset: whatever happens, no drop is lost and none is doubled."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.stats import norm
from written_drops import by_init, drop, plan_of_drops, write

import bayestissue as bt
from bayestissue.base.errors import InputError
from bayestissue.studies.bench.campaign_file import read_campaign
from bayestissue.studies.bench.drops import Drops
from bayestissue.studies.bench.views import WatchView
from bayestissue.studies.bench.watching import TAKEN_BACK, Watch
from bayestissue.studies.checking import check

pytestmark = pytest.mark.slow

NAMES = plan_of_drops(12)


def stems(names: list[str]) -> list[str]:
    return [name.removesuffix(".csv") for name in names]


def lines(watch: Watch) -> list[str]:
    return [line.text for line in watch.lines]


def test_drops_are_judged_and_the_dataset_grows(begin: Callable[[], Watch], recorded: Path) -> None:
    watch = begin()
    whole = drop(NAMES[0])
    write(recorded, NAMES[0], whole[:900])
    write(recorded, NAMES[1], b"")
    watch.look()
    write(recorded, NAMES[0], whole)
    watch.look()
    assert not watch.drops.drops, "the one grew, the other is empty"
    for name in NAMES[2:4]:
        write(recorded, name, drop(name))
    watch.catch_up(0)
    data = bt.read_dataset(watch.drops.folder)
    assert set(data.impacts["impact"]) == set(stems([NAMES[0], *NAMES[2:4]]))
    assert f"{NAMES[1]}: empty so far" in lines(watch)
    for name, spoilt in ((NAMES[1], {"limit": 70.0}), (NAMES[4], {"late_s": 0.013}), (NAMES[5], {})):
        write(recorded, name, drop(name, **spoilt))
    watch.catch_up(0)
    assert watch.last[1].kind == "good"
    # What a recorder cut off is taken as that or more; a late one is left out with the reason.
    clipped, late = watch.drops.of_file(NAMES[1]), watch.drops.of_file(NAMES[4])
    assert clipped is not None
    assert clipped.good
    assert late is not None
    assert (late.kind, late.code) == ("again", "starts-above-zero")
    data = bt.read_dataset(watch.drops.folder)
    assert [(p.impact, p.value) for p in data.left_out] == [(late.impact, late.reason)]
    assert check(data).verdict.startswith("fine")
    (recorded / NAMES[2]).unlink()
    write(recorded, NAMES[1], drop(NAMES[1]))
    write(recorded, NAMES[3], drop(NAMES[3], stiffer=1.01))
    write(recorded, f"copies/{NAMES[0]}", whole)
    watch.catch_up(0)
    assert any(line.startswith("overwritten, taken anew: ") for line in lines(watch))
    assert f"copies/{NAMES[0]}: the same recording as {NAMES[0]}; not taken twice" in lines(watch)
    assert set(bt.read_dataset(watch.drops.folder).impacts["impact"]) == set(stems([*NAMES[:4], NAMES[5]]))
    assert watch.study.drops == 5


def test_the_last_drop_is_taken_back_and_decisions_are_kept(begin, watched) -> None:
    watch = watched(NAMES[:3])
    whole = bt.read_dataset(watch.drops.folder)
    last = watch.take_back()
    assert last is not None
    data = bt.read_dataset(watch.drops.folder)
    assert {*whole.impacts["impact"]} - {*data.impacts["impact"]} == {last.impact}
    assert data.whole_hash == whole.whole_hash != data.input_hash
    watch.decide(stems(NAMES)[0] if last.impact != stems(NAMES)[0] else stems(NAMES)[1], "hit the frame")
    after = begin()
    assert sorted(d.left_out for d in after.drops) == ["", "hit the frame", TAKEN_BACK]
    after.catch_up(0)
    assert len(after.drops.drops) == 3, "what was taken back is not taken again"
    after.decide(last.impact, "")
    assert len(bt.read_dataset(after.drops.folder).impacts) == 2
    with pytest.raises(KeyError):
        after.decide("nobody", "")


def test_the_same_files_by_init_give_the_same_numbers(watched, recorded, tmp_path) -> None:
    watch = watched(NAMES)
    sets = watch.drops.folder, by_init(recorded, tmp_path / "by-init")
    ours, theirs = (bt.estimate(folder).set_index("impact").sort_index() for folder in sets)
    pd.testing.assert_frame_equal(ours, theirs)
    said = pd.DataFrame(
        {d.impact: d.K for d in watch.drops}, ["K_N_per_m", "K_low_N_per_m", "K_high_N_per_m"]
    ).T
    # A search for a mode ends where 1e-6 of log likelihood is left, one drop at a time or many: the modes are
    # that part of a standard deviation apart.
    low, high = (ours[f"K_{end}_N_per_m"] for end in ("low", "high"))
    apart = (said.sort_index() - ours[list(said)]).abs().max(axis=1) / ((high - low) / 2 / norm.isf(0.05))
    assert (apart < np.sqrt(2e-6)).all()


def test_the_study_so_far_finds_who_is_unlike_in_the_campaigns_own_nouns(watched, recorded) -> None:
    with (recorded.parent / "campaign.toml").open("a", encoding="utf-8") as campaign:
        campaign.write('\n[words]\nsubject = "pad"\n')
    watch = watched(NAMES)
    estimates = watch.study.estimates(watch.drops.drops[-1])
    assert estimates is not None
    low, high = estimates.person["K"][1:]
    assert np.sqrt(high / low) - 1 == pytest.approx(estimates.width)
    of_person = [d.K[0] for d in watch.drops if d.cells["side"] == watch.drops.drops[-1].cells["side"]]
    # A person's interval holds the mean of its drops, whose error is far smaller than its width.
    assert low < np.exp(np.mean(np.log(np.array(of_person, float)))) < high
    odd = "s01_right_1.2kg_9.csv"
    write(recorded, odd, drop(odd, stiffer=1.8))
    watch.catch_up(0)
    taken = watch.drops.of_file(odd)
    assert taken is not None
    assert taken.kind == "again"
    assert not taken.left_out, "a number is no reason to leave a drop out"
    said = "\n".join(lines(watch))
    assert "its pad's K known to" in said
    assert "person" not in said
    assert bt.read_dataset(watch.drops.folder).words == {"subject": "pad"}
    view = WatchView(watch)
    assert view.state(0)["nouns"] == {"person": "pad", "its": "its pad so far"}
    for text in (said, view.state(0)["last"]["words"]):
        assert "higher than this pad's other drops" in text
    assert "Pads in the study so far" in view.read("index.html", {})
    one = view.drop(taken.impact)
    assert set(one["study"]) == {"impact", "person", "width"}
    assert len(one["trace"]["time_ms"]) == len(one["trace"]["fitted"]) > 50
    view.act("decide", {"impact": taken.impact, "reason": "hit\n the frame"})
    assert taken.left_out == "hit the frame"
    view.act("choose", {"subject": "s07"})
    with pytest.raises(InputError):
        view.act("choose", {"subject": "s07", "mass_kg": "heavy"})
    assert view.state(0)["chosen"]["subject"] == "s07"


def test_drops_on_a_known_spring_are_no_persons(begin: Callable[[], Watch], recorded: Path) -> None:
    stated = '"reference_K_N_per_m" = "2500"\n"reference_K_sd_N_per_m" = "25"\n'
    campaign = recorded.parent / "campaign.toml"
    people = campaign.read_text()
    for name, settings in ((NAMES[0], people), (NAMES[3], people + stated)):
        campaign.write_text(settings)
        watch = begin()
        write(recorded, name, drop(name))
        watch.catch_up(0)
    person, spring = watch.drops.drops
    assert (person.of_phantom, spring.of_phantom) == (False, True)
    assert watch.study.drops == 1
    assert watch.study.estimates(spring) is None
    assert "a spring or phantom of known stiffness" in watch.line(spring)
    state = WatchView(watch).state(0)
    assert [(each["person"], each["drops"]) for each in state["people"]] == [("s01 left", 1)]
    assert state["used"] == 2
    assert len(bt.read_dataset(watch.drops.folder).people.impacts) == 1


def test_a_persons_own_folder_is_not_taken_for_what_a_killed_watch_left(begin, recorded) -> None:
    mine, incoming = recorded.parent / "mine", recorded.parent / "set" / "recordings" / ".incoming"
    mine.mkdir()
    (mine / "thesis.txt").write_text("mine")
    Drops(recorded.parent / "set", read_campaign(recorded.parent / "campaign.toml")).write()
    incoming.symlink_to(mine)
    with pytest.raises(InputError, match="a link"):
        begin()
    assert (mine / "thesis.txt").read_text() == "mine"
