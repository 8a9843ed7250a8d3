from __future__ import annotations

import numpy as np
import pytest

from bayestissue.base.errors import InputError
from bayestissue.studies.simulation import read_simulation
from bayestissue.studies.simulation.simulation_file import Condition, published_conditions
from cases import cases

TISSUE = "[tissue]\nK_N_per_m = 3000\nC_N_s_per_m = 25\n"


@pytest.mark.parametrize("case", cases(__file__))
def test_everything_wrong_is_named_at_once_with_its_key(case, tmp_path):
    path, text = tmp_path / "spec.toml", case["text"]
    path.write_text(text + ("" if "[tissue]" in text else TISSUE))
    with pytest.raises(InputError) as caught:
        read_simulation(path)
    told = [(p.column or "", f"{p.expected} {p.remedy}") for p in caught.value.problems]
    for column, words in case["says"].items():
        assert any(key.startswith(column) and words in said for key, said in told), (column, told)


@pytest.mark.parametrize(
    "given", [("mass_kg", "velocity_m_s"), ("mass_kg", "energy_J"), ("velocity_m_s", "energy_J")]
)
def test_the_third_of_energy_velocity_and_mass_follows(given):
    whole = {"mass_kg": 0.96, "velocity_m_s": 1.25, "energy_J": 0.75}
    mass, velocity = Condition(trial="a", **{name: whole[name] for name in given}).mass_and_velocity()
    assert (mass, velocity) == (pytest.approx(0.96), pytest.approx(1.25))


def test_the_published_design_is_that_of_the_tables():
    conditions = published_conditions()
    assert list(conditions["trial"]) == ["t07", "t08", "t09", "t16", "t17", "t18", "t25", "t26", "t27"]
    np.testing.assert_array_equal(conditions["mass_kg"].iloc[[0, 2, 6]], [0.666, 0.375, 1.333])
    assert sorted(conditions["velocity_m_s"].unique()) == [1.25, 1.5, 1.75]


def test_a_missing_file_is_refused(tmp_path):
    with pytest.raises(InputError, match="readable"):
        read_simulation(tmp_path / "none.toml")
