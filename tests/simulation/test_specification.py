from __future__ import annotations

import numpy as np
import pytest

from bayestissue.base.errors import InputError
from bayestissue.studies.simulation import read_simulation
from bayestissue.studies.simulation.simulation_file import Condition, published_conditions

TISSUE = "[tissue]\nK_N_per_m = 3000\nC_N_s_per_m = 25\n"


def refusal(tmp_path, text):
    path = tmp_path / "spec.toml"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        read_simulation(path)
    return {problem.column: problem for problem in caught.value.problems}


def test_everything_wrong_is_named_at_once(tmp_path):
    problems = refusal(
        tmp_path,
        'name = ""\nseed = -1\n[tissue]\nK_N_per_m = -3\nstiffness = 2\n'
        '[recording]\nrate = 5\nbits = 12\n[design]\nsubjects = 0\n[output]\ntraces = "xls"\n',
    )
    assert {"name", "seed", "tissue.K_N_per_m", "tissue.C_N_s_per_m", "tissue.stiffness"} <= set(problems)
    assert {"recording.rate", "design.subjects", "output.traces"} <= set(problems)
    assert "sampling_rate_hz" in problems["recording.rate"].expected
    assert "'parquet'" in problems["output.traces"].expected
    assert problems["tissue.C_N_s_per_m"].remedy == "Add the key tissue.C_N_s_per_m."


@pytest.mark.parametrize(
    ("text", "column", "expected"),
    [
        ("[recording]\nbits = 12\n", "recording", "range_m_s2"),
        ("[output]\nfloat32 = true\n", "output", "parquet"),
        ('[[design.conditions]]\ntrial = "a"\nmass_kg = 1\n', "design.conditions.0", "two of mass_kg"),
    ],
)
def test_keys_that_need_each_other_are_explained(tmp_path, text, column, expected):
    problems = refusal(tmp_path, 'name = "a"\n' + TISSUE + text)
    found = {problem.expected for name, problem in problems.items() if (name or "").startswith(column)}
    assert any(expected in words for words in found), problems


def test_two_trials_of_one_name_are_refused(tmp_path):
    condition = '[[design.conditions]]\ntrial = "a"\nmass_kg = 1\nvelocity_m_s = 1\n'
    problems = refusal(tmp_path, 'name = "a"\n' + TISSUE + 2 * condition)
    assert any("different name" in problem.expected for problem in problems.values())


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
