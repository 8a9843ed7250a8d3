"""Where contact falls within a sampling interval: told by all recordings together."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from impacts_bench import Impact, Lab, Recorded, record

import bayestissue as bt
from bayestissue.base.resources import shared
from bayestissue.model.hierarchy.specification import read_specification
from bayestissue.model.hierarchy.trace_data import prepare
from bayestissue.recordings.dataset import Dataset
from bayestissue.recordings.dataset.dataset_file import Uncertainty
from bayestissue.recordings.signal import displacements
from bayestissue.recordings.signal.displacement import NOT_ON_SAMPLE

RATE, NUMBER = 2e3, 30
# K = 3000 N/m, C = 12 N s/m, M = 0.5 kg.
TISSUE = Impact(np.sqrt(3000 / 0.5), 12 / 2 / np.sqrt(3000 * 0.5))


def lab(phase: np.ndarray | float, *, noise: float = 0.002, seed: int = 0, number: int = NUMBER) -> Lab:
    phases = np.broadcast_to(phase, number).copy()
    return record([TISSUE] * number, RATE, before=0.01, phase=phases, noise=noise, seed=seed)


def with_zero_at_contact(lab: Lab) -> Lab:
    """The same where whoever wrote it has no force yet at time 0."""
    return lab.changed(lambda time, value: (time, np.where(np.abs(time) < 0.1 / RATE, 0.0, value)))


def test_contact_at_a_sample_of_every_recording_is_found():
    made = displacements(lab(0.0).moved(0.0137))
    assert made.phase.kind == "first"
    assert made.phase.judged
    assert (made.contact.since_s == 0).all()
    assert (made.contact.bracket_sd == 0).all()
    assert all("contact is taken to be at a sample" in notes for notes in made.notes)


def test_a_contact_that_was_written_as_no_force_is_one_sample_earlier():
    made = displacements(with_zero_at_contact(lab(0.0)).moved(0.0137))
    assert made.phase.kind == "before"
    np.testing.assert_allclose(made.contact.since_s, 1 / RATE, rtol=1e-9)


def test_contact_declared_to_be_at_a_sample_is_where_the_clock_begins_unless_the_recording_says_otherwise():
    # One recording alone hardly tells the first sample from the one before.
    here = replace(with_zero_at_contact(lab(0.0, noise=0.01, number=1)), contact="on_sample")
    assert displacements(here).phase.kind == "before"
    assert displacements(replace(lab(0.0, noise=0.01, number=1), contact="on_sample")).phase.kind == "first"


def test_contact_anywhere_is_told_to_be_anywhere():
    random = np.random.default_rng(1)
    kinds = [displacements(lab(random.uniform(size=NUMBER), seed=seed)).phase.kind for seed in range(10)]
    # A judgement is one of 95 % at least: of ten none is wrong but with a probability of 0.6 at the most,
    # and of recordings with as little noise hardly any can be.
    assert set(kinds) == {"between"}


def test_one_recording_alone_tells_little():
    here = lab(0.0, noise=0.01, number=1)
    made = displacements(here)
    assert made.phase.kind == "undecided"
    assert made.contact.bracket_uniform[0]
    assert made.contact.bracket_s[0] * RATE == pytest.approx(0.5)
    assert made.contact.interval_s[0] == pytest.approx(1 / RATE)
    assert 0.3 < made.phase.sd < 0.65


def test_a_velocity_that_is_hardly_known_leaves_contact_open():
    # 1 % of the velocity moves contact by half an interval here, and by as much in every recording.
    unsure = replace(lab(0.0, noise=0.01), uncertainty=Uncertainty(velocity_sd_m_s=0.03))
    assert displacements(unsure.moved(0.0137)).phase.kind == "undecided"
    made = displacements(unsure).phase
    assert made.kind == "undecided"
    assert made.sd > 0.3


def test_velocities_that_scatter_about_their_statement_do_not_spread_contact_over_the_interval():
    """Half a percent of each impact's own velocity scatters its contact by a quarter of an interval here."""
    sd, kinds = 0.005, []
    for seed in range(10):
        here = replace(lab(0.0, seed=seed), uncertainty=Uncertainty(velocity_sd_m_s=sd * TISSUE.velocity))
        own = 1 + sd * np.random.default_rng(seed).normal(size=NUMBER)
        faster = [Recorded(t.time_s, t.value * by) for t, by in zip(here.traces, own, strict=True)]
        here = replace(here, traces=faster)
        kinds.append(displacements(here.moved(0.0137)).phase.kind)
        assert not displacements(replace(here, contact="on_sample")).phase.contradicted
    # "between" is wrong. What is judged is so with 95 % at least: more than two of ten has 1.2 %.
    assert kinds.count("between") <= 2


@pytest.mark.parametrize("zero", [False, True])
def test_what_is_declared_is_not_judged(zero):
    here = lab(0.0, noise=0.01)
    here = with_zero_at_contact(here) if zero else here
    between = displacements(replace(here, contact="between")).phase
    assert (between.kind, between.judged) == ("between", False)
    declared = displacements(replace(here, contact="on_sample")).phase
    assert (declared.kind, declared.judged) == ("before" if zero else "first", False)


def test_contact_that_is_declared_to_be_at_a_sample_and_is_not_is_contradicted() -> None:
    anywhere = lab(np.random.default_rng(4).uniform(size=NUMBER))
    made = displacements(replace(anywhere, contact="on_sample"))
    assert made.phase.known
    assert made.phase.words.endswith("as declared: the recordings contradict it")
    assert all(NOT_ON_SAMPLE in notes for notes in made.notes)


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize(("noise", "faster"), [(0.001, 1.0), (0.01, 1.0), (0.001, 1.01)])
def test_contact_at_a_sample_is_not_contradicted(noise: float, faster: float, seed: int) -> None:
    """Nor where the velocity is one that nobody knows of: it moves contact in all impacts alike."""
    at_sample = replace(lab(0.0, noise=noise, seed=seed), contact="on_sample")
    impacts = at_sample.impacts.assign(velocity_m_s=faster * TISSUE.velocity)
    made = displacements(replace(at_sample, impacts=impacts))
    assert not made.phase.contradicted
    assert not any(NOT_ON_SAMPLE in notes for notes in made.notes)


# A declared contact is no question; here all recordings tell, on a clock that knows nothing of contact.
@pytest.mark.long
@pytest.mark.parametrize("anywhere", [False, True])
@pytest.mark.parametrize("noise", [0.003, 0.01])
def test_intervals_of_C_hold_wherever_contact_is(anywhere, noise):
    # A dataset's impacts share what is not known of contact: the error of the share is that over datasets.
    random, datasets = np.random.default_rng(7), 16
    held = []
    for seed in range(100, 100 + datasets):
        made = lab(random.uniform(size=NUMBER) if anywhere else 0.0, noise=noise, seed=seed).moved(0.0137)
        table = bt.estimate(made.dataset())
        held.append(((table["C_low_N_s_per_m"] <= 12) & (table["C_high_N_s_per_m"] >= 12)).mean())
    error = np.std(held, ddof=1) / np.sqrt(datasets)
    assert 0.85 - 2 * error < np.mean(held) < 0.95 + 2 * error


def test_tissue_that_is_damped_beyond_the_critical_tells_nothing_of_the_phase() -> None:
    """By least squares contact was at a sample for certain, and of 90 % intervals of K a third held."""
    rng = np.random.default_rng(4)
    impacts = [Impact(60.0, 2.0)] * 20
    lab = record(impacts, 5000.0, before=0.005, noise=0.01, phase=rng.uniform(size=len(impacts)))
    assert displacements(lab).phase.kind == "between"


@pytest.mark.slow
def test_a_fit_finds_the_place_of_contact_that_all_recordings_share() -> None:
    """A clock that begins at contact, says who cut the recordings; it was a third of an interval before."""
    late, random = 1 / 3, np.random.default_rng(5)
    made = lab(late, noise=0.008, seed=5, number=24).moved(-late / RATE)
    velocity = made.impacts["velocity_m_s"] * np.exp(random.normal(0, 0.002, 24))
    columns = {"subject": [f"s{number // 4}" for number in range(24)], "velocity_m_s": velocity}
    data = made.dataset(columns=columns, uncertainty=Uncertainty(velocity_sd_m_s=0.02))
    assert displacements(data).phase.kind == "undecided"
    fit = bt.fit(data)
    assert fit.diagnostics["passed"]
    summary = fit.summary.set_index("variable")
    place = summary.loc["contact_mean"]
    assert place["eti90_low"] - 0.2 < late - 0.5 < place["eti90_high"] + 0.2
    for name, true in (("K", 3000.0), ("C", 12.0)):
        rows = summary.loc[name]
        assert ((rows["eti90_low"] <= true) & (rows["eti90_high"] >= true)).mean() > 0.7


def hidden() -> Dataset:
    """Contact at a sample of each recording, and noise that hides the jump in some of them."""
    made = record([TISSUE] * 20, RATE / 4, before=0.1, phase=np.zeros(20), noise=0.04, seed=3)
    return made.moved(0.0137).dataset()


@pytest.mark.slow
def test_where_noise_hides_the_jump_intervals_hold_contact_at_the_end_of_what_it_leaves() -> None:
    """Where all moments between samples were as likely in each of 20 impacts, C held a third of the time."""
    fit = bt.fit(hidden())
    rows = fit.summary.set_index("variable").loc["C"]
    assert ((rows["eti90_low"] <= 12) & (rows["eti90_high"] >= 12)).mean() > 0.6


def test_of_few_samples_contact_is_a_parameter_though_it_is_between_two() -> None:
    """An error of half an interval is not linear then: intervals of K from seven samples held 55 %."""
    model = read_specification(shared("models", "impact.toml"))
    random, omega_n = np.random.default_rng(3), np.sqrt(3000 / 0.5)
    for per_peak, known in ((7, True), (60, False)):
        rate = per_peak * omega_n / (np.pi / 2)
        made = record([TISSUE] * 4, rate, before=0.1, phase=random.uniform(size=4), noise=0.002)
        assert prepare(made.dataset(contact="between"), model, source="impact").model.contact is known
