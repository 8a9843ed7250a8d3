"""Numbers of the audit against independent ones, and what is known by hand of the thesis's own tables."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from scipy.linalg import expm

from bayestissue.inference.points.point_fit import fit_points
from bayestissue.recordings.dataset.published import PublishedTables
from bayestissue.thesis.audit import audit_published, findings, people, plausibility
from bayestissue.thesis.audit.people import agreement
from bayestissue.thesis.audit.plausibility import (
    AuditedImpacts,
    centred_fit,
    frequency_curve,
    made_up_pulses,
    peak,
)
from bayestissue.thesis.reproduction import reproduce_published

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


def impacts_of(frame: pd.DataFrame) -> AuditedImpacts:
    conditions = frame.groupby("trial")[["energy_J", "velocity_m_s", "mass_kg"]].mean()
    return AuditedImpacts(frame, conditions, 0.05, 12)


def test_a_clean_table_gives_no_finding() -> None:
    impacts = impacts_of(made_up_table())
    assert [*findings(plausibility, impacts), *findings(people, impacts)] == []


def test_mass_exponent_is_recovered() -> None:
    frame = made_up_table()
    for exponent in (0, 0.5, 1):
        found = impacts_of(frame.assign(K=frame["K"] * frame["mass_kg"] ** exponent)).mass_exponent
        # the same noise enters all three, so the interval of the clean table, moved, must hold each
        assert found.low < exponent < found.high


@pytest.mark.slow
def test_one_curve_is_found_with_its_scatter() -> None:
    """ω_n the same for all but for a parabola in ζ, as an estimator blind to the tissue would have it."""
    frame, rng = made_up_table(), np.random.default_rng(2)
    zeta = rng.uniform(0.05, 0.5, len(frame))
    omega = 80 * (1 + (zeta - 0.28) ** 2) * np.exp(rng.normal(0, 0.0005, len(frame)))
    mass = frame["mass_kg"]
    curve = frequency_curve(impacts_of(frame.assign(K=mass * omega**2, C=2 * zeta * omega * mass)))
    # the planted scatter is 0.05 %, of which half lies within 0.6745 standard deviations; the standard
    # error of that quantile is 1.17 σ/√n for normal scatter, three of them allowed
    expected = 0.0005 * 0.6745
    assert abs(curve.residual - expected) < 3 * 1.17 * 0.0005 / np.sqrt(len(frame))


@pytest.mark.parametrize("zeta", [0.05, 1.8])
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


def test_intraclass_correlation_is_the_planted_one() -> None:
    found = agreement(impacts_of(made_up_table()), "K")
    # 0.2² / (0.2² + 0.05²) = 0.94 for the people drawn; with ten people their variance scatters by a
    # relative √(2/9), and three of these below leave more than 0.8
    assert 0.8 < found.correlation < 1
    assert found.p_value < 1e-6


@pytest.mark.parametrize("damping", [0.1, 2.0])
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
        worst.append(np.abs(fit.omega_n / limit - 1).max())
    # θ1 is what sets the two apart, and its effect vanishes as the sampling gets denser
    assert worst[1] < worst[0] / 2 < 0.05


KNOWN = {
    "energy, velocity and mass": ("V = 1.25, 1.5, 1.75", "V = 1.5, 1.75, 2 m/s"),
    "penetration that K and C imply": ("6.3 mm", "15 to 33 cm"),
    "standard deviation of K, trial 17": ("1.977", "0.629"),
    "range of C, trial 16": ("3.105", "2.122"),
    "C: minimum": ("0.121 and .0122", "0.121"),
    "ratio of maximum to minimum of C against its ends": ("37.90", "379"),
    "R² of the equation of C": ("0.97", "0.62"),
    "significance of Skin Fold for K": ("-0.024", "0.818"),
    "variables significant for C": ("Mass only", "10 of 10"),
    "correlation of K with Skin Fold+ Muscle Thickness": ("-0.137", "0.176"),
    "masses in the equation of K": ("0.695", "0.6952"),
}


def test_the_thesis_holds_what_is_known(published: PublishedTables) -> None:
    found = audit_published(published, reproduce_published(published)).set_index("what")
    for what, (printed, implied) in KNOWN.items():
        assert printed in found.loc[what, "published"], what
        assert implied in found.loc[what, "implied"], what
