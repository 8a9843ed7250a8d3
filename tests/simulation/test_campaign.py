from __future__ import annotations

from types import MappingProxyType

import numpy as np
import pytest
from scipy.signal import butter, sosfilt, sosfiltfilt

from bayestissue.recordings.dataset import read_dataset
from bayestissue.studies.simulation import Simulation, simulate, write_campaign

FORCE = {"noise_sd_N": 0.02, "offset_sd_N": 0.5, "relative_gain_sd": 0.02, "tip_mass_kg": 0.05}


def specification(tissue=None, recording=None, output=None, **design) -> Simulation:
    return Simulation.model_validate(
        {
            "name": "made here",
            "seed": 5,
            "design": design,
            "tissue": {"K_N_per_m": 3000.0, "C_N_s_per_m": 25.0, **(tissue or {})},
            "recording": recording or {},
            "output": output or {},
        }
    )


def rows(campaign, row):
    return campaign.traces[row].time_s, campaign.traces[row].value


def test_a_perfect_recording_obeys_the_equation_of_motion():
    campaign = simulate(specification(subjects=2, recording={"sampling_rate_hz": 100_000.0}))
    for row, truth in campaign.truth.iterrows():
        time, d = rows(campaign, row)
        contact, leaves = truth.contact_time_s, truth.contact_time_s + 2 * truth.time_to_peak_s
        touching = (time >= contact) & (time < leaves)
        assert (d[~touching] == 0).all()
        assert time[-1] >= leaves + 0.0099
        assert 0.01 <= contact < 0.01 + 1e-5
        assert d[touching][0] == pytest.approx(
            truth.C_N_s_per_m * truth.velocity_m_s / truth.mass_kg, rel=0.01
        )
        # M d'' + C d' + K d = 0 by central differences, whose error is (omega dt)²/12 of either term.
        inner = d[touching]
        first, second = (inner[2:] - inner[:-2]) * 5e4, (inner[2:] - 2 * inner[1:-1] + inner[:-2]) * 1e10
        terms = truth.mass_kg * second, truth.C_N_s_per_m * first, truth.K_N_per_m * inner[1:-1]
        assert np.abs(sum(terms)).max() < 1e-4 * np.abs(terms[2]).max()


def test_the_same_seed_gives_the_same_numbers_and_another_does_not():
    made = specification(recording={"noise_relative_to_peak": 0.01})
    once, again, other = simulate(made), simulate(made), simulate(made, seed=6)
    np.testing.assert_array_equal(once.traces.value, again.traces.value)
    assert once.truth.equals(again.truth)
    assert not once.truth["contact_time_s"].equals(other.truth["contact_time_s"])


def test_noise_leaves_the_truth_as_it_is():
    tissue = {"sd_subject_K": 0.2, "sd_impact_C": 0.1}
    quiet = simulate(specification(tissue))
    noisy = simulate(specification(tissue, {"noise_sd_m_s2": 2.0}))
    assert quiet.truth.equals(noisy.truth)
    difference = noisy.traces.value - quiet.traces.value
    # 60,000 values: the standard deviation is good to 0.3 %; four times that.
    assert difference.std() == pytest.approx(2, rel=0.012)


def test_tissue_varies_as_the_specification_says():
    sds = {"sd_subject_K": 0.3, "sd_trial_C": 0.2, "sd_impact_K": 0.1, "sd_impact_C": 0.1, "correlation": 0.5}
    conditions = [{"trial": f"t{k}", "mass_kg": 0.5 + k / 100, "velocity_m_s": 1.0} for k in range(100)]
    recording = {"sampling_rate_hz": 500.0}
    truth = simulate(specification(sds, recording, conditions=conditions, subjects=100)).truth
    # 100 people or trials, 10,000 impacts: standard errors of 7 % and 0.7 %; four of them.
    assert truth["subject_effect_K"].std() == pytest.approx(0.3, rel=0.28)
    assert truth["trial_effect_C"].std() == pytest.approx(0.2, rel=0.28)
    assert truth["impact_effect_K"].std() == pytest.approx(0.1, rel=0.028)
    assert np.corrcoef(truth["impact_effect_K"], truth["impact_effect_C"])[0, 1] == pytest.approx(
        0.5, abs=0.03
    )
    assert truth.groupby(truth["impact"].str[-3:])["subject_effect_K"].nunique().max() == 1
    total = truth["subject_effect_K"] + truth["trial_effect_K"] + truth["impact_effect_K"]
    np.testing.assert_allclose(np.log(truth["K_N_per_m"] / 3000), total, atol=1e-12)


def test_stiffness_is_a_power_of_mass():
    truth = simulate(specification({"mass_exponent_K": 1.0, "mass_exponent_C": -0.5})).truth
    np.testing.assert_allclose(truth["K_N_per_m"], 3000 * truth["mass_kg"] / 0.7, rtol=1e-12)
    np.testing.assert_allclose(truth["C_N_s_per_m"], 25 * (truth["mass_kg"] / 0.7) ** -0.5, rtol=1e-12)
    np.testing.assert_allclose(truth["omega_n_rad_s"], np.sqrt(3000 / 0.7), rtol=1e-12)


@pytest.mark.slow
def test_recorded_mass_and_velocity_are_not_the_true_ones():
    recording = {
        "relative_mass_sd": 0.05,
        "velocity_sd_m_s": 0.1,
        "relative_gain_sd": 0.02,
        "gain_error": "impact",
        "offset_sd_m_s2": 1.0,
    }
    campaign = simulate(specification(recording=recording, subjects=100))
    truth, impacts = campaign.truth, campaign.impacts
    # 900 impacts: a standard deviation is good to 2.4 %; four times that.
    assert (truth["mass_kg"] / impacts["mass_kg"]).std() == pytest.approx(0.05, rel=0.1)
    assert (truth["velocity_m_s"] - impacts["velocity_m_s"]).std() == pytest.approx(0.1, rel=0.1)
    assert truth["gain"].std() == pytest.approx(0.02, rel=0.1)
    of_one_sensor = simulate(specification(recording=recording | {"gain_error": "all"})).truth["gain"]
    assert of_one_sensor.nunique() == 1
    assert truth["offset_m_s2"].std() == pytest.approx(1, rel=0.1)
    _, d = rows(campaign, 0)
    assert d[0] == pytest.approx(truth["offset_m_s2"][0], abs=1e-12)
    assert campaign.settings.uncertainty.velocity_sd_m_s == 0.1


def test_a_recorder_clips_and_rounds_to_its_steps():
    recording = {"range_m_s2": 50.0, "bits": 8, "noise_sd_m_s2": 1.0}
    campaign = simulate(specification(recording=recording))
    assert np.abs(campaign.traces.value).max() == 50
    steps = campaign.traces.value / (100 / 2**8)
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-9)


def test_blocks_leave_no_seam(monkeypatch):
    made = specification(recording={"noise_relative_to_peak": 0.01})
    whole = simulate(made)
    monkeypatch.setattr("bayestissue.studies.simulation.campaign._BLOCK", 5000)
    # Compiled for another shape, a block may round otherwise in the last digit.
    np.testing.assert_allclose(simulate(made).traces.value, whole.traces.value, atol=1e-11)


@pytest.mark.parametrize(
    ("output", "force"),
    [({"traces": "parquet", "float32": True}, {}), ({"traces": "csv"}, FORCE)],
)
def test_what_is_written_is_a_dataset(tmp_path, output, force):
    recording = {"noise_relative_to_peak": 0.005} | ({"force": force} if force else {})
    made = specification(recording=recording, output=output, subjects=2, repeats=2)
    campaign = simulate(made)
    write_campaign(tmp_path / "campaign", campaign, made)
    back, direct = read_dataset(tmp_path / "campaign"), campaign.dataset("made here")
    assert list(back.impacts["impact"]) == list(campaign.truth["impact"])
    assert len(back.traces) == 36
    for read, kept in zip(back.traces, direct.traces, strict=True):
        np.testing.assert_array_equal(read.value, kept.value)
        np.testing.assert_allclose(read.time_s, kept.time_s, atol=1e-12)
    assert back.channels == direct.channels
    for mine, theirs in zip(back.further, direct.further, strict=True):
        for read, kept in zip(mine, theirs, strict=True):
            np.testing.assert_allclose(read.value, kept.value, rtol=1e-12)


FACTORS = [{"name": "side", "levels": ["left", "right"]}, {"name": "session", "levels": 3, "every": False}]
GROUPS = {
    "mass_exponent_K": 0.2,
    "sd_group": {"subject:side": {"K": 0.2}, "session": {"C": 0.1}},
    "sd_slope": {"log(mass_kg)|subject": {"K": 0.3}},
}


def with_groups(**tissue) -> Simulation:
    """Forty people in the nine conditions, on both sides and in one of three sessions each time."""
    return specification(GROUPS | tissue, {"sampling_rate_hz": 500.0}, subjects=40, factors=FACTORS)


def test_further_factors_have_columns_effects_and_slopes():
    made = simulate(with_groups())
    impacts, truth = made.impacts, made.truth
    assert (impacts.groupby(["trial", "subject"])["side"].nunique() == 2).all()
    assert impacts["session"].value_counts().to_dict() == dict.fromkeys("123", len(impacts) // 3)
    assert impacts["impact"].is_unique
    levels = truth.groupby([impacts["subject"], impacts["side"]])["subject_side_effect_K"]
    assert (levels.nunique() == 1).all()
    # Standard deviations of 80 levels and 40 people, three standard errors wide.
    assert levels.first().std() == pytest.approx(0.2, rel=3 / (2 * 80) ** 0.5)
    exponents = truth.groupby(impacts["subject"])["subject_mass_exponent_K"].first()
    assert exponents.std() == pytest.approx(0.3, rel=3 / (2 * 40) ** 0.5)
    assert exponents.mean() == pytest.approx(0.2, abs=3 * 0.3 / 40**0.5)
    log_mass = np.log(truth["mass_kg"] / 0.7)
    wanted = np.log(3000) + truth["subject_mass_exponent_K"] * log_mass + truth["subject_side_effect_K"]
    np.testing.assert_allclose(np.log(truth["K_N_per_m"]), wanted, rtol=1e-12)


def test_effects_of_further_groups_leave_the_other_random_numbers_as_they_are():
    a, b = (simulate(with_groups(**tissue)) for tissue in ({"sd_group": {}, "sd_slope": {}}, {}))
    np.testing.assert_array_equal(a.truth["contact_time_s"], b.truth["contact_time_s"])
    np.testing.assert_array_equal(a.impacts["session"], b.impacts["session"])


@pytest.mark.slow
def test_further_parameters_differ_between_people():
    tissue = {"element": "wall", "parameters": {"thickness_m": 0.04}, "sd_subject_K": 0.1}
    of_people = {"subject": {"thickness_m": 0.3}, **GROUPS["sd_group"]}
    made = simulate(with_groups(**tissue, sd_group=of_people))
    truth = made.truth
    np.testing.assert_allclose(np.log(truth["thickness_m"] / 0.04), truth["subject_effect_thickness_m"])
    each = truth.groupby(made.impacts["subject"])["subject_effect_thickness_m"]
    assert (each.nunique() == 1).all()
    assert each.first().std() == pytest.approx(0.3, rel=3 / (2 * 40) ** 0.5)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"sd_group": {"subject": {"thickness_m": 0.1}}}, "keys K, C, without thickness_m"),
        ({"sd_group": {"subject:hand": {"K": 0.1}}}, "without hand"),
        ({"sd_slope": {"age|subject": {"K": 0.1}}}, "without age"),
    ],
)
def test_effects_of_columns_that_the_design_lacks_are_refused(changes, words):
    with pytest.raises(ValueError, match=words):
        with_groups(**changes)


def test_a_force_beside_the_deceleration_changes_nothing_else_of_a_campaign():
    plain = simulate(specification(subjects=2, recording={"noise_sd_m_s2": 0.5}))
    both = simulate(specification(subjects=2, recording={"noise_sd_m_s2": 0.5, "force": FORCE}))
    np.testing.assert_array_equal(plain.traces.value, both.traces.value)
    assert both.truth[list(plain.truth)].equals(plain.truth)


def test_a_recorded_force_is_that_on_the_mass_behind_the_tip():
    made = specification(subjects=2, recording={"force": FORCE, "mass_factor": 1.1})
    campaign = simulate(made)
    assert campaign.truth["mass_kg"].to_numpy() == pytest.approx(1.1 * campaign.impacts["mass_kg"].to_numpy())
    # One sensor has one gain, and another zero in every impact.
    assert campaign.truth["force_gain"].nunique() == 1
    assert campaign.truth["force_offset_N"].nunique() == len(campaign.truth)
    for row, truth in campaign.truth.iterrows():
        force = campaign.further[0][row].value
        expected = truth.force_gain * (truth.mass_kg - 0.05) * rows(campaign, row)[1] + truth.force_offset_N
        # 0.02 N of noise: five standard deviations.
        assert np.abs(force - expected).max() < 0.1


def behind(recorder, design=MappingProxyType({"subjects": 2}), **recording):
    made = specification(recording=recording, **design).model_dump(exclude_unset=True)
    return Simulation.model_validate(made | {"recorder": recorder})


@pytest.mark.slow
@pytest.mark.parametrize(
    ("recorder", "run"), [({"low_pass_hz": 300.0}, sosfilt), ({"sae_class": 180}, sosfiltfilt)]
)
def test_a_low_pass_takes_the_true_motion_and_leaves_noise_white(recorder, run):
    design = {"conditions": [{"trial": "a", "mass_kg": 0.6, "velocity_m_s": 1.5}], "subjects": 1}
    fine = {"sampling_rate_hz": 100_000.0}
    plain, bare = (
        simulate(specification(recording=fine, **design)),
        simulate(behind(recorder, design, **fine)),
    )
    noisy = simulate(behind(recorder, design, **fine, noise_sd_m_s2=0.5))
    assert noisy.truth.equals(plain.truth)
    noise = noisy.traces.value - bare.traces.value
    assert np.std(noise) == pytest.approx(0.5, rel=4 / np.sqrt(2 * noise.size))
    assert abs(np.corrcoef(noise[1:], noise[:-1])[0, 1]) < 4 / np.sqrt(noise.size)
    sections = butter(2, bare.settings.recorder.low_pass_hz, fs=100_000.0, output="sos")
    expected = run(sections, plain.traces.value)
    # The jump at contact is where it is, and not at a sample: half an interval times the corner.
    np.testing.assert_allclose(bare.traces.value, expected, atol=0.01 * expected.max())


def test_a_force_goes_through_its_own_low_pass():
    """As a deceleration does, whatever that one goes through."""
    recorder = {"low_pass_hz": 300.0, "applied": "digital"}
    other = {"low_pass_hz": 700.0, "zero_phase": True, "applied": "analog"}
    expected, alone = (simulate(behind(filtered)) for filtered in (recorder, other))
    made = behind(other, force={"recorder": recorder})
    campaign = simulate(made)
    np.testing.assert_allclose(
        campaign.traces.value, alone.traces.value, atol=1e-9 * alone.traces.value.max()
    )
    mass, force = campaign.truth["mass_kg"].to_numpy()[campaign.traces.owner], campaign.further[0].value
    # Behind an analog filter the grid is finer than alone: a bilinear transform's error goes with its step.
    assert force == pytest.approx(mass * expected.traces.value, abs=2e-3 * force.max())
    (channel,) = campaign.dataset("made").channels
    assert channel.recorder == made.recording.force.recorder


def test_a_force_is_clipped_at_its_limit_and_read_so(tmp_path):
    free = simulate(specification(subjects=2, recording={"force": FORCE}))
    limit = float(np.round(0.8 * np.median([trace.value.max() for trace in free.further[0]]), 1))
    made = specification(subjects=2, recording={"force": FORCE | {"limit_N": limit}})
    campaign = simulate(made)
    force = campaign.further[0].value
    np.testing.assert_array_equal(force, np.clip(free.further[0].value, -limit, limit))
    write_campaign(tmp_path / "made", campaign, made)
    for dataset in (campaign.dataset("made"), read_dataset(tmp_path / "made")):
        marked = [np.zeros(len(t.value)) if t.clipped is None else t.clipped for t in dataset.further[0]]
        np.testing.assert_array_equal(np.concatenate(marked), force >= limit)


@pytest.mark.slow
def test_a_force_below_the_tissue_moves_the_tissue_too():
    gravity = 9.80665
    plate, tissue = {"place": "base"}, {"element": "moving_mass", "parameters": {"moving_mass_kg": 0.2}}
    made = specification(subjects=1, recording={"force": plate}, tissue=tissue)
    campaign = simulate(made.model_copy(update={"gravity": gravity}))
    for row, truth in campaign.truth.iterrows():
        force = campaign.further[0][row].value
        d = rows(campaign, row)[1]
        expected = np.where(d > 0, (truth.mass_kg + 0.2) * d - 0.2 * gravity, 0.0)
        np.testing.assert_allclose(force, expected, rtol=1e-9, atol=1e-9)
