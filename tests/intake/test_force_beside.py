"""A force beside the motion: `init` takes the only one, and leaves out what does not fit."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import bayestissue as bt
from bayestissue.base.errors import InputError
from bayestissue.recordings.intake import choices_of
from bayestissue.studies.init import prepare, write
from command_line import init
from dataset_bench import deceleration
from page_reader import figures

FACTS = {"trial": "drop", "velocity_m_s": "1.2"}
MASSES = (0.5, 1.2)


def recorded(tmp_path: Path, name: str = "Force (N)", factor: float = 1.0, **further: float) -> Path:
    """Two impacts; the force is ``factor`` of M d, and so is each of ``further`` of its own."""
    folder = tmp_path / "recorded"
    folder.mkdir()
    for seed, mass in enumerate(MASSES):
        time, value = deceleration(mass, 1.2)
        random = np.random.default_rng(seed)
        table = {"Time (s)": time, "Accel (g)": value / 9.80665}
        for column, share in {name: factor, **further}.items():
            table[column] = share * mass * value + random.normal(0, 0.02, value.size)
        pd.DataFrame(table).to_csv(folder / f"s1_{mass}kg.csv", index=False)
    return folder


def made(folder: Path, out: Path, **said: Any) -> Any:
    choices = choices_of(quantity="deceleration", pattern="{subject}_{mass_kg}kg", given=FACTS, **said)
    return write(prepare(folder, choices), out)


def test_the_only_force_becomes_a_channel_and_the_page_draws_it_over_the_deceleration(tmp_path: Path) -> None:
    built = made(recorded(tmp_path), tmp_path / "made")
    (channel,) = built.dataset.channels
    assert (channel.quantity, channel.place, channel.name) == ("force", "impactor", "force")
    for mass, force, first in zip(MASSES, built.dataset.further[0], built.dataset.traces, strict=True):
        np.testing.assert_allclose(force.value, mass * first.value, atol=0.1)
    assert 'value_column = "Force (N)"' in (tmp_path / "made" / "dataset.toml").read_text()
    assert any("Channel Force (N) is taken as the force at the impactor" in note for note in built.notes)
    page = (tmp_path / "made" / "init.html").read_text()
    (chart,) = map(json.loads, figures(page))
    rows = pd.DataFrame(chart["datasets"]["rows-0"])
    heights = rows.pivot_table(index="impact", columns="kind", values="value", aggfunc="max")
    np.testing.assert_allclose(heights["force over mass"], heights["recorded"], rtol=0.01)


def test_the_command_takes_what_is_said_of_the_force(tmp_path: Path) -> None:
    folder = recorded(tmp_path, "Plate [N]")
    said = {"relative_gain_sd": 0.01, "name": "cell"}
    run = init(folder, tmp_path / "made", set=FACTS, force=said)
    assert run.status == 0, run.err
    (channel,) = bt.read_dataset(tmp_path / "made").channels
    assert (channel.name, channel.place, channel.relative_gain_sd) == ("cell", "base", 0.01)
    assert "is taken as the force" not in run.out


@pytest.mark.parametrize("force", ["none", {}])
def test_none_is_taken_where_none_or_several_may_be_it(force: Any, tmp_path: Path) -> None:
    more = {} if force == "none" else {"Fx (N)": 0.1}
    folder = recorded(tmp_path, **more)
    built = made(folder, tmp_path / "made", force=force)
    assert built.dataset.channels == ()
    page = (tmp_path / "made" / "init.html").read_text()
    assert ("forces: Force (N), Fx (N)" in page) == bool(more)
    if more:
        chosen = made(folder, tmp_path / "chosen", force={"value_column": "Force"})
        assert chosen.dataset.further[0][0].value.max() > 5


def test_a_force_that_counts_the_other_way_is_turned(tmp_path: Path) -> None:
    built = made(recorded(tmp_path, factor=-1.0), tmp_path / "made")
    assert built.dataset.further[0][0].value.max() > 5
    assert any("its scale is -1" in note for note in built.notes)
    assert len(list((tmp_path / "made" / "recordings").iterdir())) == len(MASSES)


def test_a_force_that_does_not_fit_costs_no_impact(tmp_path: Path) -> None:
    folder = recorded(tmp_path)
    first = next(iter(sorted(folder.iterdir())))
    table = pd.read_csv(first)
    table["Force (N)"] = 1.5
    table.to_csv(first, index=False)
    built = made(folder, tmp_path / "made")
    assert len(built.dataset.impacts) == len(MASSES)
    assert built.dataset.channels == ()
    assert any("The force of channel Force (N) is left out" in note for note in built.notes)
    with pytest.raises(InputError, match="Force"):
        made(folder, tmp_path / "again", force={"place": "impactor"})


def test_what_is_wrong_with_the_option_is_said_by_its_name(tmp_path: Path) -> None:
    folder = recorded(tmp_path)
    with pytest.raises(InputError, match="--force place"):
        made(folder, tmp_path / "made", force={"place": "ceiling"})
    with pytest.raises(InputError, match="--force"):
        made(folder, tmp_path / "made", force={"value_column": "Torque"})
