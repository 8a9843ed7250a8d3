"""Every general check finds the fault planted for it and is silent on a clean table."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from scipy.linalg import expm

from bayestissue.base.results.tables import columns_of
from bayestissue.inference.points.point_fit import fit_points
from bayestissue.thesis.audit import CHECKS_OF_IMPACTS
from bayestissue.thesis.audit.inconsistencies import (
    SEVERITIES,
    AuditedImpacts,
    Inconsistency,
    as_table,
    findings,
)
from bayestissue.thesis.audit.people import agreement, damping_without_bounds, people_not_told_apart
from bayestissue.thesis.audit.plausibility import (
    centred_fit,
    frequency_curve,
    kinetic_energy,
    made_up_pulses,
    mass_exponent,
    peak,
)

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
    return frame.assign(mass_kg=2 * frame["energy_J"] / frame["velocity_m_s"] ** 2)


def impacts_of(frame: pd.DataFrame, *, tissue_m: float = 0.05, digits: int = 12) -> AuditedImpacts:
    conditions = frame.groupby("trial")[["energy_J", "velocity_m_s", "mass_kg"]].mean()
    return AuditedImpacts(frame, conditions, tissue_m, digits)


def names_of(frame: pd.DataFrame, **options: float) -> set[str]:
    """Names of the checks that report something on ``frame``."""
    impacts = impacts_of(frame, **options)
    return {check.__name__ for check in CHECKS_OF_IMPACTS if list(check(impacts))}


def found_by(check, frame: pd.DataFrame) -> Inconsistency:
    (found,) = findings([check], impacts_of(frame))
    return found


def with_constant_frequency(frame: pd.DataFrame, seed: int = 2) -> pd.DataFrame:
    """ω_n the same for all but for a parabola in ζ, as an estimator blind to the tissue would have it."""
    rng = np.random.default_rng(seed)
    zeta = rng.uniform(0.05, 0.5, len(frame))
    omega = 80 * (1 + (zeta - 0.28) ** 2) * np.exp(rng.normal(0, 0.0005, len(frame)))
    mass = frame["mass_kg"]
    return frame.assign(K=mass * omega**2, C=2 * zeta * omega * mass)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(5))
def test_a_clean_table_gives_no_finding(seed: int) -> None:
    assert names_of(made_up_table(seed)) == set()


@pytest.mark.slow
def test_k_that_follows_mass_is_found() -> None:
    frame = made_up_table()
    changed = frame.assign(K=3000 * frame["mass_kg"] * (frame["K"] / 3000) ** 0.1)
    assert "constant_natural_frequency" in names_of(changed)


def test_mass_exponent_is_recovered() -> None:
    frame = made_up_table()
    for exponent in (0, 0.5, 1):
        found = mass_exponent(impacts_of(frame.assign(K=frame["K"] * frame["mass_kg"] ** exponent)))
        # the same noise enters all three, so the interval of the clean table, moved, must hold each
        assert found.low < exponent < found.high


@pytest.mark.slow
def test_one_curve_is_found_with_its_scatter() -> None:
    frame = with_constant_frequency(made_up_table())
    assert {"frequency_and_damping_on_one_curve", "frequency_of_the_window"} <= names_of(frame)
    curve = frequency_curve(impacts_of(frame))
    # the planted scatter is 0.05 %, of which half lies within 0.6745 standard deviations; the standard
    # error of that quantile is 1.17 σ/√n for normal scatter, three of them allowed
    expected = 0.0005 * 0.6745
    assert abs(curve.residual - expected) < 3 * 1.17 * 0.0005 / np.sqrt(len(frame))


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
    frame = made_up_table()
    assert names_of(frame.assign(K=frame["K"] / 1000, C=frame["C"] / 30)) == {"implied_penetration"}
    assert names_of(frame, tissue_m=0.005) == {"implied_penetration"}


@pytest.mark.parametrize("zeta", [0.05, 0.5, 1.8])
def test_peak_is_that_of_the_equation_of_motion(zeta: float) -> None:
    frame = made_up_table()
    frame["C"] = 2 * zeta * np.sqrt(frame["K"] * frame["mass_kg"])
    impacts = impacts_of(frame)
    time, depth = peak(impacts)
    system = np.array([[0.0, 1.0], [-(impacts.omega_n[0] ** 2), -2 * zeta * impacts.omega_n[0]]])
    x, v = expm(system * time[0]) @ [0.0, frame["velocity_m_s"][0]]
    # rounding errors of the matrix exponential
    assert abs(v) < 1e-12 * frame["velocity_m_s"][0]
    assert x == pytest.approx(depth[0], rel=1e-12)


def test_energy_that_is_not_half_m_v_squared_is_found_with_the_velocity_that_fits() -> None:
    frame = made_up_table()
    shifted = frame.assign(velocity_m_s=frame["velocity_m_s"] - 0.1)
    assert "to 0.0%, if every velocity were 0.10 m/s higher than stated" in (
        found_by(kinetic_energy, shifted).explanation
    )


def test_people_without_differences_are_not_told_apart() -> None:
    frame = made_up_table()
    rng = np.random.default_rng(5)
    shuffled = frame.assign(K=frame.groupby("trial")["K"].transform(lambda one: rng.permutation(one)))
    assert found_by(people_not_told_apart, shuffled).what.startswith("K of the same person")


def test_intraclass_correlation_is_the_planted_one() -> None:
    found = agreement(impacts_of(made_up_table()), "K")
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
        x = depth[:, ::every] - depth[:, ::every].mean(axis=1, keepdims=True)
        count, one = x.shape[1], np.ones(len(x))
        fit = fit_points(x, one * count, one / (count - 1), one)
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


def test_worst_findings_come_first() -> None:
    impacts = impacts_of(with_constant_frequency(made_up_table()).assign(energy_J=1.0))
    found = as_table(findings(CHECKS_OF_IMPACTS, impacts, "Table 1"))
    assert list(found.columns) == columns_of("audit")
    assert set(found["where"]) == {"Table 1"}
    order = [SEVERITIES.index(severity) for severity in found["severity"]]
    assert order == sorted(order)


def test_damping_without_bounds_is_found() -> None:
    frame = made_up_table()
    steady = frame.assign(K=3000 * frame["mass_kg"])
    wild = np.exp(np.random.default_rng(8).normal(0, 1, len(frame)))
    assert found_by(damping_without_bounds, steady.assign(C=25 * wild))
