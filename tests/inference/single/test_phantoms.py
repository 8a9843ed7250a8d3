"""Impacts of a spring of known stiffness: refused where they say nothing, and people put right by them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

import bayestissue as bt
from bayestissue.base.errors import InputError
from bayestissue.inference.points.notes import PHANTOM, people_alone
from bayestissue.inference.single import phantoms
from bayestissue.inference.single.phantoms import control_chart, prepare_without_phantoms, split_phantoms
from bayestissue.recordings.dataset import Dataset
from bayestissue.recordings.dataset.dataset_file import Uncertainty
from bayestissue.recordings.dataset.impact_table import REFERENCE, counts, of_phantoms
from bayestissue.studies.estimates import level, page_of
from bayestissue.studies.fitting import resolve
from campaigns import COLUMNS, holds, simulated

FACTOR, GAIN, KNOWN, SD = 1.06, 1.06, 2500.0, 25.0
DECLARED = Uncertainty(relative_mass_sd=0.05, velocity_sd_m_s=0.005, relative_gain_sd=0.05, offset_sd=0.0)


PHANTOM_OF = {"K_N_per_m": KNOWN, "sd_N_per_m": SD, "C_N_s_per_m": 6.0, "repeats": 3}
RECORDING = {"sampling_rate_hz": 5000.0, "noise_relative_to_peak": 0.005, "velocity_sd_m_s": 0.005}


def with_phantom(
    damping: float = 25.0, factor: float = 1.0, gain: float = 1.0
) -> tuple[Dataset, pd.DataFrame]:
    """People and a spring, masses declared too small by a factor, and the people's truth."""
    made = simulated(
        {"C_N_s_per_m": damping, "sd_subject_K": 0.2, "sd_impact_K": 0.05},
        RECORDING | {"mass_factor": factor},
        people=3,
        masses=(0.5, 1.0),
        velocity=1.4,
        seed=1,
        phantom=PHANTOM_OF,
    )
    dataset = made.dataset("made").with_settings(uncertainty=DECLARED)
    traces = [replace(trace, value=gain * trace.value) for trace in dataset.traces]
    return replace(dataset, traces=traces), made.truth[~of_phantoms(made.impacts)]


def test_errors_of_mass_and_gain_must_be_declared() -> None:
    dataset, _ = with_phantom()
    assert of_phantoms(dataset.impacts).sum() == 6
    with pytest.raises(InputError) as error:
        split_phantoms(dataset.with_settings(uncertainty=Uncertainty()))
    assert {problem.column for problem in error.value.problems} == {
        "uncertainty.relative_mass_sd",
        "uncertainty.relative_gain_sd",
    }
    springs = dataset.select(of_phantoms(dataset.impacts))
    with pytest.raises(InputError, match="whose stiffness is not known"):
        split_phantoms(springs)
    people = dataset.select(~of_phantoms(dataset.impacts))
    assert split_phantoms(people) == (people, None)


def test_phantoms_are_counted_and_estimated_beside_people_and_not_as_people() -> None:
    dataset, _ = with_phantom()
    impacts = len(dataset.impacts)
    assert counts(dataset.impacts) == f"{impacts}; subjects: 3, trials: 2; of known springs or phantoms: 6"
    assert dataset.people.impacts["subject"].nunique() == 3
    assert len(dataset.people.traces) == len(dataset.people.impacts) == impacts - 6
    table = bt.estimate(dataset, method="dds")
    assert [PHANTOM in notes for notes in table["notes"]] == (table["subject"] == "phantom").tolist()
    people = people_alone(table)
    assert people["impact"].tolist() == dataset.people.impacts["impact"].tolist()
    # Phantoms alone are what the table is of.
    assert len(people_alone(table[table["subject"] == "phantom"])) == 6
    page = page_of({"estimates": table}, {"dataset": "made", "program": "bayestissue", "command": "estimate"})
    assert f"{impacts} impacts, 6 of them of springs or phantoms of known stiffness" in page
    assert level(people, "K")["median"] in page
    assert level(people, "K")["median"] != level(table, "K")["median"]


@pytest.fixture
def by_least_squares(monkeypatch: pytest.MonkeyPatch) -> None:
    """Phantoms are estimated sooner, where the question is not how well."""

    def estimate(dataset: Dataset) -> pd.DataFrame:
        table = bt.estimate(dataset, method="dds")
        K = table["K_N_per_m"]
        return table.assign(K_low_N_per_m=0.99 * K, K_high_N_per_m=1.01 * K)

    monkeypatch.setattr(phantoms, "estimate", estimate)


@pytest.mark.usefixtures("by_least_squares")
def test_beside_phantoms_a_mass_is_no_person_s_own() -> None:
    dataset, _ = with_phantom()
    model = resolve("impact", "deceleration")[0]
    of_people = model.model_copy(update={"mass_error": "subject"})
    with pytest.raises(InputError, match='mass_error = "impact"') as error:
        prepare_without_phantoms(dataset, of_people, source="mine.toml")
    (problem,) = error.value.problems
    assert (problem.file, problem.column, problem.code) == ("mine.toml", "mass_error", "reference-unfit")
    with pytest.raises(InputError) as several:
        prepare_without_phantoms(
            dataset.with_settings(uncertainty=Uncertainty()), of_people, source="mine.toml"
        )
    assert len(several.value.problems) == 3


@pytest.mark.usefixtures("by_least_squares")
def test_the_control_chart_goes_session_by_session() -> None:
    dataset, _ = with_phantom()
    assert control_chart(dataset)["label"].str.startswith("phantom-").all()
    sessions = [f"day {row % 2 + 1}" for row in range(len(dataset.impacts))]
    chart = control_chart(replace(dataset, impacts=dataset.impacts.assign(Session=sessions)))
    named = chart["label"].str.extract(r"^Session day (\d), (phantom-.*)$")
    assert named[0].tolist() == ["1"] * 3 + ["2"] * 3
    springs = dataset.select(of_phantoms(dataset.impacts))
    in_table = springs.impacts["impact"].tolist()
    assert named[1].tolist() == in_table[::2] + in_table[1::2]
    plain = control_chart(dataset).set_index("label")["median"]
    assert chart["median"].tolist() == plain[named[1]].tolist()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("damping", "factor", "gain"),
    [
        (10.0, FACTOR, 1.0),
        pytest.param(10.0, 1.0, GAIN, marks=pytest.mark.long),
        pytest.param(35.0, 1.0, GAIN, marks=pytest.mark.long),
    ],
)
def test_people_are_put_right_by_a_spring(damping: float, factor: float, gain: float) -> None:
    dataset, truth = with_phantom(damping, factor, gain)
    fit = bt.fit(dataset, seed=1)
    posterior = fit.posterior["posterior"].dataset
    assert posterior.sizes["impact"] == len(truth)
    assert "phantom" not in posterior["subject"].to_numpy()
    low, high = np.quantile(posterior["mass_factor"], [0.05, 0.95])
    # A spring known to 1 % leaves as much open, and no more than that and the gain.
    assert low < factor < high
    assert 0.02 < high - low < 0.06
    holds(posterior, truth, least=0.8)
    for name, column in COLUMNS.items():
        assert abs(float(np.log(posterior[name] / truth[column].to_numpy()).mean())) < 0.03, name
    assert fit.diagnostics["reference"]["passed"]
    assert "known springs read" in fit.about["verdict"]["headline"]


def test_a_standard_deviation_above_half_of_the_stiffness_has_another_unit() -> None:
    dataset, _ = with_phantom()
    known = np.where(of_phantoms(dataset.impacts), 2.5, np.nan)
    impacts = dataset.impacts.assign(**dict(zip(REFERENCE, (known, 10 * known), strict=True)))
    traces = [(trace.time_s, trace.value) for trace in dataset.traces]
    with pytest.raises(InputError) as refused:
        bt.dataset(impacts, traces, quantity="deceleration", unit="m/s^2", uncertainty=DECLARED)
    first = refused.value.problems[0]
    assert (first.code, first.column, len(refused.value.problems)) == ("reference-unfit", REFERENCE[1], 6)
    assert "2.5 N/mm are 2500 N/m" in first.remedy
    # And one that is not stated at all.
    with pytest.raises(InputError, match=REFERENCE[1]):
        bt.dataset(impacts.drop(columns=REFERENCE[1]), traces, quantity="deceleration", unit="m/s^2")


@pytest.mark.usefixtures("by_least_squares")
def test_a_stiffness_a_thousand_times_what_was_recorded_has_another_unit() -> None:
    dataset, _ = with_phantom()
    known = np.where(of_phantoms(dataset.impacts), KNOWN / 1000, np.nan)
    impacts = dataset.impacts.assign(**dict(zip(REFERENCE, (known, known / 100), strict=True)))
    with pytest.raises(
        InputError, match=r"expected a stiffness like the \d{4} N/m .* factor of 1\d00"
    ) as refused:
        split_phantoms(replace(dataset, impacts=impacts))
    assert refused.value.problems[0].code == "reference-unfit"
