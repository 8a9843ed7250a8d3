"""Campaign files: what they say, and what is refused."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from written_drops import CAMPAIGN

from bayestissue.base.errors import InputError
from bayestissue.studies.bench.campaign_file import read_campaign
from bayestissue.studies.bench.order import Order, order_of
from command_line import bayestissue

SIGNAL = '[signal]\nquantity = "deceleration"\nunit = "g"\n'


def written(folder: Path, text: str) -> Path:
    (folder / "campaign.toml").write_text(text)
    return folder / "campaign.toml"


def test_names_count_more_than_the_page_the_order_and_the_facts(tmp_path: Path) -> None:
    (tmp_path / "order.csv").write_text("subject,mass_kg\ns01,0.5\ns02,1.2\n")
    facts = "[facts]\ndrop_height_cm = 12\nmass_g = 700\n"
    text = f'pattern = "{{subject}}_{{n}}"\norder = "order.csv"\n{facts}{SIGNAL}'
    campaign = read_campaign(written(tmp_path, text))
    assert campaign.settings.name == "campaign"
    following, page = campaign.order[1], {"velocity_m_s": "1.4"}
    assert campaign.cells("s09_3.csv", following, page) == {
        **{"subject": "s09", "mass_kg": 1.2, "velocity_m_s": 1.4, "n": "3"}
    }
    fallen = campaign.cells("s09_3.csv")
    assert fallen["mass_kg"] == 0.7
    assert fallen["velocity_m_s"] == pytest.approx((2 * 9.80665 * 0.12) ** 0.5)
    assert campaign.unknown([]) == []


def test_the_recorder_is_read_as_a_dataset_of_init_says(tmp_path: Path) -> None:
    (tmp_path / "pilot").mkdir()
    (tmp_path / "pilot" / "dataset.toml").write_text(
        f'name = "pilot"\n{SIGNAL}[uncertainty]\noffset_sd = 0.1\n'
    )
    text = 'name = "spring"\nlike = "pilot"\n[uncertainty]\nvelocity_sd_m_s = 0.02\n'
    campaign = read_campaign(written(tmp_path, text))
    assert campaign.settings.signal.unit == "g"
    assert campaign.settings.uncertainty.model_dump(exclude_defaults=True) == {"velocity_sd_m_s": 0.02}


@pytest.mark.parametrize(
    ("text", "column"),
    [
        ('name = "a"', "signal"),
        ('like = "nowhere"', "like"),
        ("wished = 1\n" + SIGNAL, "wished"),
        (SIGNAL.replace('"g"', '"kg"'), "signal.unit"),
        ('[signal]\nquantity = "displacement"\nunit = "mm"\n', "signal.quantity"),
        ("[wanted]\nrelative_width = -1\n" + SIGNAL, "wanted.relative_width"),
    ],
)
def test_what_is_wrong_is_refused_with_its_place(tmp_path: Path, text: str, column: str) -> None:
    with pytest.raises(InputError) as error:
        read_campaign(written(tmp_path, text))
    assert [problem.column for problem in error.value.problems] == [column]


def test_the_order_says_what_is_left_and_a_plan_leaves_the_people_open(tmp_path: Path) -> None:
    rows = (*({"subject": "s01", "mass_kg": 0.5} for _ in range(2)), {"subject": "s02", "mass_kg": 1.2})
    drops = [{"subject": "s01", "mass_kg": 0.5, "n": "1"}, {"subject": "s09", "mass_kg": 0.5}]
    assert Order(rows).left(drops) == {1: rows[1], 2: rows[2]}
    planned = Order(rows, people_named=False)
    assert list(planned.left([]).values()) == [{"mass_kg": 0.5}, {"mass_kg": 0.5}, {"mass_kg": 1.2}]
    assert planned.left([{"subject": "anna", "mass_kg": 0.5}]) == {
        1: {"mass_kg": 0.5, "subject": "anna"},
        2: {"mass_kg": 1.2},
    }
    plan = {"candidates": {"people": [2], "masses_kg": [0.5, 1.2]}, "questions": {"q": "mass_exponent_K < 1"}}
    (tmp_path / "plan.json").write_text(json.dumps({"plan": {"name": "p", **plan}, "chosen": 1}))
    order = order_of(read_campaign(written(tmp_path, SIGNAL)), tmp_path)
    assert [row["mass_kg"] for row in order.left([]).values()] == [0.5, 1.2] * 2
    for wrong in ("", "[]", '{"plan": [], "chosen": 1}', "[" * 9900):
        (tmp_path / "plan.json").write_text(wrong)
        with pytest.raises(InputError):
            order_of(read_campaign(tmp_path / "campaign.toml"), tmp_path)


def test_columns_of_a_plan_and_an_order_are_those_of_names_in_any_case(tmp_path: Path) -> None:
    """Else a side that names say stands beside that of the row, and the two may differ."""
    factor = {"name": "Side", "levels": ["left", "right"]}
    plan = {"candidates": {"people": [2], "masses_kg": [0.5], "factors": [factor]}}
    plan |= {"questions": {"q": "K[Side=left] > K[Side=right]"}}
    (tmp_path / "plan.json").write_text(json.dumps({"plan": {"name": "p", **plan}, "chosen": 1}))
    campaign = read_campaign(written(tmp_path, 'pattern = "{subject}_{side}_{n}"\n' + SIGNAL))
    assert [row["side"] for row in order_of(campaign, tmp_path).rows] == ["left", "right"] * 2
    (tmp_path / "order.csv").write_text("Subject,SIDE,mass_kg\ns01,left,0.5\n")
    campaign = read_campaign(written(tmp_path, 'pattern = "{side}_{n}"\norder = "order.csv"\n' + SIGNAL))
    assert order_of(campaign, None).rows[0] == {"subject": "s01", "side": "left", "mass_kg": 0.5}


def test_watch_refuses_before_it_writes_anything(tmp_path: Path) -> None:
    (tmp_path / "recorded").mkdir()
    campaign = written(tmp_path, SIGNAL)
    out = tmp_path / "set"
    lacking = bayestissue("watch", tmp_path / "recorded", "--campaign", campaign, "--out", out, "--plain")
    assert lacking.status == 2
    assert "subject and mass_kg and velocity_m_s" in lacking.err
    written(tmp_path, CAMPAIGN)
    nowhere = bayestissue("watch", tmp_path / "none", "--campaign", campaign, "--out", out, "--plain")
    assert nowhere.status == 2
    out.mkdir()
    (out / "mine.txt").write_text("mine")
    taken = bayestissue("watch", tmp_path / "recorded", "--campaign", campaign, "--out", out, "--plain")
    assert taken.status == 2
    assert [path.name for path in out.iterdir()] == ["mine.txt"]
