"""Every general check finds the fault planted for it and is silent on a clean table."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from scipy.linalg import expm

from bayestissue.errors import InputError
from bayestissue.inference.points.fit import fit_points
from bayestissue.thesis.audit import GENERAL, audit_estimates
from bayestissue.thesis.audit.estimates import (
    centred_fit,
    frequency_curve,
    made_up_pulses,
    mass_exponent,
    peak,
)
from bayestissue.thesis.audit.findings import BEARINGS, COLUMNS, SEVERITIES, read_impacts
from bayestissue.thesis.audit.people import agreement

PEOPLE, CONDITIONS = 10, 9


def made_up_table(seed: int = 1) -> pd.DataFrame:
    """A tissue that differs between people and not with mass, struck as the design says."""
    rng = np.random.default_rng(seed)
    energy, velocity = (grid.ravel() for grid in np.meshgrid([0.75, 1.125, 1.5], [1.25, 1.5, 1.75]))
    trial = np.repeat(np.arange(1, CONDITIONS + 1), PEOPLE)
    subject = np.tile(np.arange(1, PEOPLE + 1), CONDITIONS)
    person_K, person_C = rng.normal(0, 0.2, (2, PEOPLE))
    frame = pd.DataFrame(
        {
            "subject": subject,
            "trial": trial,
            "energy_J": energy[trial - 1],
            "velocity_m_s": velocity[trial - 1],
            "K": 3000 * np.exp(person_K[subject - 1] + rng.normal(0, 0.05, trial.size)),
            "C": 25 * np.exp(person_C[subject - 1] + rng.normal(0, 0.05, trial.size)),
        }
    )
    frame["mass_kg"] = 2 * frame["energy_J"] / frame["velocity_m_s"] ** 2
    time, depth = peak(read_impacts(frame))
    return frame.assign(time_to_peak_s=time, peak_displacement_m=depth)


def names_of(frame: pd.DataFrame, **options: object) -> set[str]:
    """Names of the checks that report something on ``frame``."""
    impacts = read_impacts(frame, **options)
    return {name for name, check in GENERAL.checks.items() if list(check.look(impacts))}


def with_constant_frequency(frame: pd.DataFrame, seed: int = 2) -> pd.DataFrame:
    """ω_n the same for all but for a parabola in ζ, as an estimator blind to the tissue would have it."""
    rng = np.random.default_rng(seed)
    zeta = rng.uniform(0.05, 0.5, len(frame))
    omega = 80 * (1 + (zeta - 0.28) ** 2) * np.exp(rng.normal(0, 0.0005, len(frame)))
    mass = frame["mass_kg"]
    changed = frame.assign(K=mass * omega**2, C=2 * zeta * omega * mass)
    return changed.drop(columns=["time_to_peak_s", "peak_displacement_m"])


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(5))
def test_a_clean_table_gives_no_finding(seed: int) -> None:
    assert names_of(made_up_table(seed)) == set()
    found = audit_estimates(made_up_table(seed))
    assert list(found.columns) == list(COLUMNS)
    assert found.empty


def test_columns_with_units_are_taken_too() -> None:
    frame = made_up_table().rename(columns={"K": "K_N_per_m", "C": "C_N_s_per_m"})
    assert audit_estimates(frame).empty


def test_missing_columns_are_listed_at_once() -> None:
    with pytest.raises(InputError) as error:
        audit_estimates(made_up_table().drop(columns=["K", "mass_kg"]))
    assert [problem.column for problem in error.value.problems] == ["mass_kg", "K"]


def test_a_table_without_usable_rows_is_refused() -> None:
    with pytest.raises(InputError, match="at least two rows"):
        audit_estimates(made_up_table().assign(K=np.nan))


def test_rows_without_an_estimate_are_counted() -> None:
    frame = made_up_table()
    frame.loc[[3, 7], "K"] = [np.nan, -1]
    found = audit_estimates(frame)
    assert list(found["what"]) == ["K or C below zero", "rows without a usable estimate"]
    assert list(found["severity"]) == ["minor", "note"]
    assert found["explanation"].str.contains("^1 of 90 est|^2 of 90 rows").all()
    frame.loc[:50, "C"] = -1.0
    assert audit_estimates(frame)["severity"].iloc[0] == "major"


@pytest.mark.slow
def test_k_that_follows_mass_is_found() -> None:
    frame = made_up_table()
    changed = frame.assign(K=3000 * frame["mass_kg"] * (frame["K"] / 3000) ** 0.1)
    assert "constant_natural_frequency" in names_of(changed)


def test_mass_exponent_is_recovered() -> None:
    frame = made_up_table()
    for exponent in (0, 0.5, 1):
        found = mass_exponent(read_impacts(frame.assign(K=frame["K"] * frame["mass_kg"] ** exponent)))
        assert found is not None
        # the same noise enters all three, so the interval of the clean table, moved, must hold each
        assert found.low < exponent < found.high


def test_mass_that_never_varies_has_no_exponent() -> None:
    assert mass_exponent(read_impacts(made_up_table().assign(mass_kg=1.0))) is None


@pytest.mark.slow
def test_one_curve_is_found_with_its_scatter() -> None:
    frame = with_constant_frequency(made_up_table())
    assert {"frequency_and_damping_on_one_curve", "frequency_of_the_window"} <= names_of(frame)
    curve = frequency_curve(read_impacts(frame))
    assert curve is not None
    # the planted scatter is 0.05 %, of which half lies within 0.6745 standard deviations; the standard
    # error of that quantile is 1.17 σ/√n for normal scatter, three of them allowed
    expected = 0.0005 * 0.6745
    assert abs(curve.residual - expected) < 3 * 1.17 * 0.0005 / np.sqrt(len(frame))


def test_impacts_off_the_curve_are_named() -> None:
    frame = with_constant_frequency(made_up_table())
    frame.loc[12, "K"] *= 1.1
    impacts = read_impacts(frame)
    (found,) = GENERAL.checks["impacts_off_the_curve"].findings(impacts)
    assert "2/3" in found.explanation


def test_frequency_that_varies_freely_is_on_no_curve() -> None:
    rng = np.random.default_rng(3)
    frame = made_up_table()
    mass, scatter = frame["mass_kg"], rng.normal(0, 0.05, (2, len(frame)))
    frame = frame.assign(K=3000 * mass * np.exp(scatter[0]), C=25 * mass * np.exp(scatter[1]))
    assert "frequency_and_damping_on_one_curve" not in names_of(frame)


def test_equal_masses_at_other_energies_are_compared() -> None:
    frame = with_constant_frequency(made_up_table())
    second = frame["trial"] == 2
    # a tenth condition with the mass of the second, half as much energy again
    extra = frame[second].assign(trial=10, energy_J=frame["energy_J"][second] * 1.5)
    assert "equal_masses_at_other_energies" in names_of(pd.concat([frame, extra]))


def test_soft_springs_let_the_impactor_sink_in() -> None:
    frame = made_up_table().drop(columns=["time_to_peak_s", "peak_displacement_m"])
    assert names_of(frame.assign(K=frame["K"] / 1000, C=frame["C"] / 30)) == {"implied_penetration"}
    assert names_of(frame, tissue_m=0.005) == {"implied_penetration"}


@pytest.mark.parametrize("zeta", [0.05, 0.5, 1.8])
def test_peak_is_that_of_the_equation_of_motion(zeta: float) -> None:
    frame = made_up_table()
    frame["C"] = 2 * zeta * np.sqrt(frame["K"] * frame["mass_kg"])
    impacts = read_impacts(frame)
    time, depth = peak(impacts)
    system = np.array([[0.0, 1.0], [-(impacts.omega_n[0] ** 2), -2 * zeta * impacts.omega_n[0]]])
    x, v = expm(system * time[0]) @ [0.0, frame["velocity_m_s"][0]]
    # rounding errors of the matrix exponential
    assert abs(v) < 1e-12 * frame["velocity_m_s"][0]
    assert x == pytest.approx(depth[0], rel=1e-12)


def test_recorded_peaks_are_compared() -> None:
    frame = made_up_table()
    assert names_of(frame.assign(time_to_peak_s=frame["time_to_peak_s"] * 2)) == {"measured_peak"}
    assert names_of(frame.assign(peak_displacement_m=frame["peak_displacement_m"] / 2)) == {"measured_peak"}


def test_energy_that_is_not_half_m_v_squared_is_found_with_the_velocity_that_fits() -> None:
    frame = made_up_table()
    shifted = frame.assign(velocity_m_s=frame["velocity_m_s"] - 0.1)
    (found,) = GENERAL.checks["kinetic_energy"].findings(read_impacts(shifted))
    assert "0.10 m/s higher than stated" in found.explanation
    (found,) = GENERAL.checks["kinetic_energy"].findings(
        read_impacts(frame.assign(mass_kg=frame["mass_kg"] * 1.2))
    )
    assert "0.10" not in found.explanation


def test_people_without_differences_are_not_told_apart() -> None:
    frame = made_up_table()
    rng = np.random.default_rng(5)
    shuffled = frame.assign(K=frame.groupby("trial")["K"].transform(lambda one: rng.permutation(one)))
    (found,) = GENERAL.checks["people_not_told_apart"].findings(read_impacts(shuffled))
    assert found.what.startswith("K of the same person")


def test_too_few_people_to_tell_are_not_reported() -> None:
    frame = made_up_table()
    rng = np.random.default_rng(5)
    shuffled = frame.assign(K=frame.groupby("trial")["K"].transform(lambda one: rng.permutation(one)))
    assert "people_not_told_apart" not in names_of(shuffled[shuffled["trial"] <= 2])


def test_intraclass_correlation_is_the_planted_one() -> None:
    found = agreement(read_impacts(made_up_table()), "K")
    assert found is not None
    # 0.2² / (0.2² + 0.05²) = 0.94 for the people drawn; with ten people their variance scatters by a
    # relative √(2/9), and three of these below leave more than 0.8
    assert 0.8 < found.correlation < 1
    assert found.p_value < 1e-6


def test_unequal_scatter_is_found() -> None:
    frame = made_up_table()
    noise = np.where(frame["trial"] == 4, np.random.default_rng(6).normal(0, 1.5, len(frame)), 0)
    assert "unequal_scatter" in names_of(frame.assign(C=frame["C"] * np.exp(noise)))


def test_copied_rows_are_found() -> None:
    frame = made_up_table().round({"K": 1, "C": 3})
    frame.loc[4, ["K", "C"]] = frame.loc[7, ["K", "C"]]
    assert names_of(frame, digits=3) == {"rows_that_stand_twice"}


def test_a_copied_stiffness_is_found_where_chance_is_small() -> None:
    frame = made_up_table().round({"K": 3, "C": 3})
    frame.loc[4, "K"] = frame.loc[7, "K"]
    assert "stiffness_that_stands_twice" in names_of(frame, digits=3)
    coarse = made_up_table().round({"K": -2, "C": 3})
    assert "stiffness_that_stands_twice" not in names_of(coarse, digits=-2)


def test_a_row_copied_from_another_trial_is_found() -> None:
    frame = made_up_table()
    frame.loc[4, ["K", "C"]] = frame.loc[64, ["K", "C"]]
    assert "estimates_in_two_trials" in names_of(frame)


@pytest.mark.parametrize("damping", [0.1, 0.7, 2.0])
def test_centred_fit_returns_what_obeys_its_equation(damping: float) -> None:
    time = np.linspace(0, 1, 2001)
    root = -damping + 5j
    # this phase makes the mean over the window zero, so that x = x − x̄ obeys the homogeneous equation
    phase = np.pi / 2 - np.angle((np.exp(root) - 1) / root)
    wave = np.exp(root * time + 1j * phase)
    omega, zeta = centred_fit((root * wave).real, -(root**2 * wave).real)
    # trapezoidal sums of 2001 samples are off by about |root|² / (12 · 2000²) < 1e-6
    assert omega == pytest.approx(abs(root), rel=1e-5)
    assert zeta == pytest.approx(damping / abs(root), rel=1e-4)


@pytest.mark.slow
def test_the_thesis_fit_gives_the_window_too() -> None:
    velocity, deceleration = made_up_pulses()
    limit, _ = centred_fit(velocity, deceleration)
    step = 1 / (velocity.shape[1] - 1)
    depth = np.cumsum((velocity[:, 1:] + velocity[:, :-1]) / 2, axis=1) * step
    depth = np.concatenate([np.zeros((len(depth), 1)), depth], axis=1)
    worst = []
    for every in (20, 2):
        x = depth[:, ::every]
        count, one = x.shape[1], np.ones(len(x))
        fit = fit_points(x, one * count, one / (count - 1), one, method="dds")
        assert fit.omega_n.min() > 0.9 * limit.min()
        assert fit.omega_n.max() < 1.1 * limit.max()
        worst.append(np.abs(fit.omega_n / limit - 1).max())
    # θ1 is what sets the two apart, and its effect vanishes as the sampling gets denser
    assert worst[1] < worst[0] / 2


def test_made_up_pulses_bring_the_impactor_to_rest() -> None:
    velocity, deceleration = made_up_pulses()
    assert np.allclose(velocity[:, 0], 1)
    assert np.allclose(velocity[:, -1], 0)
    # a trapezoidal sum over 2001 samples is exact for the velocity it was made with
    assert np.allclose(np.trapezoid(deceleration, dx=1 / (velocity.shape[1] - 1), axis=1), 1)


def test_worst_findings_come_first_and_checks_say_why() -> None:
    found = audit_estimates(with_constant_frequency(made_up_table()).assign(energy_J=1.0))
    order = [SEVERITIES.index(severity) for severity in found["severity"]]
    assert order == sorted(order)
    for check in GENERAL.checks.values():
        assert check.severity in SEVERITIES
        assert check.bearing in BEARINGS
        assert f"{check.severity.capitalize()}: " in str(check.look.__doc__)
        assert check.look.__doc__


def test_damping_without_bounds_is_found() -> None:
    frame = made_up_table()
    steady = frame.assign(K=3000 * frame["mass_kg"])
    wild = np.exp(np.random.default_rng(8).normal(0, 1, len(frame)))
    assert "damping_without_bounds" in names_of(steady.assign(C=25 * wild))
