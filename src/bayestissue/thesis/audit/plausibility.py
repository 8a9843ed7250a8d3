"""Whether estimates carry information on the tissue, and fit one and the same blow."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import combinations
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Float
from scipy import stats
from statsmodels.robust.norms import TukeyBiweight
from statsmodels.robust.robust_linear_model import RLM
from statsmodels.tools.sm_exceptions import ConvergenceWarning

from bayestissue.base.impact_arrays import PerImpact
from bayestissue.mechanics.oscillator import peak_displacement, time_to_peak
from bayestissue.recordings.dataset.published import PublishedTables
from bayestissue.recordings.signal.integrals import trapezoids
from bayestissue.thesis.reproduction.agreement import decimals

# Something of each impact, and of each made-up blow over time.
Pulses = Float[np.ndarray, "pulse time"]
# Of a made-up blow.
_SAMPLES = 2001
# A hard object struck against tissue over bone comes to rest in 5 to 50 ms; twice that is out of reach.
SLOWEST_PEAK_S = 0.1


type Numbers = Mapping[str, Any]
"""What a check yields of a thing that it does not believe, by the names in its texts."""


def number_list(values: Iterable[float]) -> str:
    """``1.5, 1.75``: numbers as a finding names them."""
    return ", ".join(f"{value:g}" for value in values)


@dataclass(frozen=True)
class MassExponent:
    """Slope of log K on log M over the conditions, with its 95 % interval."""

    slope: float
    low: float
    high: float

    @property
    def is_one(self) -> bool:
        """Close to 1 and away from 0: K follows the mass, and ω_n does not."""
        return abs(self.slope - 1) < 0.15 and self.low > 0.5


@dataclass(frozen=True)
class AuditedImpacts:
    """Estimates with what was measured beside them.

    Attributes:
        rows: columns subject, trial, energy_J, velocity_m_s, mass_kg, K (N/m) and C (N s/m); all positive.
        conditions: the trials' energy_J, velocity_m_s and mass_kg; may name trials without rows.
        tissue_m: greatest thickness of the tissue, in m.
        digits: number of decimals that K and C were printed with.
    """

    rows: pd.DataFrame
    conditions: pd.DataFrame
    tissue_m: float
    digits: int

    @cached_property
    def omega_n(self) -> PerImpact:
        """ω_n = √(K/M), rad/s (thesis 2.12)."""
        return np.sqrt(self.rows["K"].to_numpy() / self.rows["mass_kg"].to_numpy())

    @cached_property
    def zeta(self) -> PerImpact:
        """ζ = C / (2√(KM)) (thesis 2.12)."""
        rows = self.rows
        return rows["C"].to_numpy() / (2 * np.sqrt(rows["K"].to_numpy() * rows["mass_kg"].to_numpy()))

    @cached_property
    def mass_exponent(self) -> MassExponent:
        """Least squares of the conditions' mean log K on log M.

        Conditions, not impacts, are the units: mass varies between conditions only.
        """
        rows = self.rows.assign(log=np.log(self.rows["K"]), log_mass=np.log(self.rows["mass_kg"]))
        means = rows.groupby("trial")[["log", "log_mass"]].mean()
        line = stats.linregress(means["log_mass"], means["log"])
        half = stats.t.ppf(0.975, len(means) - 2) * line.stderr
        return MassExponent(float(line.slope), float(line.slope - half), float(line.slope + half))


def published_impacts(tables: PublishedTables) -> AuditedImpacts:
    """The impacts whose estimates were published."""
    claims = tables.claims
    layers = claims["quantity"].str.endswith("thickness") & claims["statistic"].eq("maximum (mm)")
    return AuditedImpacts(
        tables.estimates,
        conditions=tables.averages.drop_duplicates("trial").set_index("trial"),
        tissue_m=float(claims.loc[layers, "value"].sum()) / 1000,
        digits=int(tables.estimates["K_text"].map(decimals).max()),
    )


@dataclass(frozen=True)
class Curve:
    """A robust parabola ω_n(ζ): what is left of the scatter of ω_n, as fractions of its median.

    ``total`` and ``residual`` are median absolute deviations; ``chance`` is the 1st percentile of the
    residual when the values of ζ are dealt out at random. ``off`` marks the impacts further than five normal
    standard deviations from the curve.
    """

    total: float
    residual: float
    chance: float
    off: np.ndarray

    @property
    def holds(self) -> bool:
        """The parabola leaves less than half the scatter, and less than chance would."""
        return self.residual < 0.5 * self.total and self.residual < self.chance


def frequency_curve(impacts: AuditedImpacts) -> Curve:
    """Fit ω_n as a parabola in ζ by Tukey's biweight, so that a few impacts off the curve do not bend it."""
    omega, zeta = impacts.omega_n, impacts.zeta
    middle = float(np.median(omega))
    deviations = np.abs(_residuals(omega, zeta))
    rng = np.random.default_rng(0)
    shuffled = [np.median(np.abs(_residuals(omega, rng.permutation(zeta)))) for _ in range(100)]
    return Curve(
        total=float(np.median(np.abs(omega - middle))) / middle,
        residual=float(np.median(deviations)) / middle,
        chance=float(np.percentile(shuffled, 1)) / middle,
        off=deviations > 5 * stats.norm.ppf(0.75) ** -1 * np.median(deviations),
    )


def _residuals(omega: PerImpact, zeta: PerImpact) -> PerImpact:
    powers = np.vander(zeta - np.median(zeta), 3)
    with warnings.catch_warnings():
        # a perfect fit, as of simulated impacts without noise, is no reason to warn
        warnings.simplefilter("ignore", ConvergenceWarning)
        fit = RLM(omega, powers, M=TukeyBiweight()).fit()
    return omega - fit.fittedvalues


def variation(values: PerImpact) -> float:
    """Standard deviation over mean."""
    return float(np.std(values, ddof=1) / np.mean(values))


def constant_natural_frequency(impacts: AuditedImpacts) -> Iterator[Numbers]:
    """K proportional to the mass of the impactor.

    Major: K = M ω_n², so a K that follows M with ω_n the same for all says nothing about the tissue.
    """
    if not impacts.mass_exponent.is_one:
        return
    stiffness = impacts.rows["K"].to_numpy()
    per_mass = stiffness / impacts.rows["mass_kg"].to_numpy()
    if variation(per_mass) > 0.5 * variation(stiffness):
        return
    K, omega = (
        {"min": values.min(), "max": values.max(), "variation": variation(values)}
        for values in (stiffness, impacts.omega_n)
    )
    yield {"K": K, "per_mass": variation(per_mass), "exponent": impacts.mass_exponent, "omega": omega}


def frequency_and_damping_on_one_curve(impacts: AuditedImpacts) -> Iterator[Numbers]:
    """ω_n a function of ζ, across people and masses that have nothing else in common.

    With K and C fixed, ω_n and ζ lie on the line ω_n/ζ = 2K/C as mass varies: only where ω_n does not follow
    the mass does a common curve tell against the estimates.

    Major: two estimates that lie on one line hold one piece of information, not two.
    """
    if not impacts.mass_exponent.is_one:
        return
    curve = frequency_curve(impacts)
    if curve.holds:
        times = curve.total / curve.residual
        yield {"impacts": len(curve.off), "curve": curve, "times": times, "off": curve.off.sum()}


def equal_masses_at_other_energies(impacts: AuditedImpacts) -> Iterator[Numbers]:
    """Conditions of nearly the same mass but different energy that give the same K.

    Minor: it separates mass from energy and velocity, which the design otherwise ties together.
    """
    if not impacts.mass_exponent.is_one:
        return
    conditions = impacts.rows.groupby("trial")[["mass_kg", "energy_J", "K"]].mean()
    words: list[dict[str, str]] = []
    for first, second in combinations(conditions.index, 2):
        lower, higher = conditions.loc[first], conditions.loc[second]
        change = higher / lower - 1
        if abs(change["mass_kg"]) < 0.03 and abs(change["energy_J"]) > 0.2 and abs(change["K"]) < 0.03:
            stiffness, changed = f"{lower['K']:.3f} and {higher['K']:.3f}", f"{change['K']:+.1%}"
            pair = (
                f"trials {first} and {second}: {lower['mass_kg']:g} and {higher['mass_kg']:g} kg, "
                f"energy {change['energy_J']:+.0%}, K {changed}"
            )
            words.append({"stiffnesses": stiffness, "changes": changed, "pairs": pair})
    if words:
        yield {name: "; ".join(pair[name] for pair in words) for name in words[0]}


def centred_fit(
    velocity: Pulses, deceleration: Pulses
) -> tuple[Float[np.ndarray, " pulse"], Float[np.ndarray, " pulse"]]:
    """(ω_n T, ζ) of the least squares fit x″ + 2ζω_n x′ + ω_n² (x − x̄) = 0 on a window of length T.

    This is the limit, for dense sampling and θ1 = 0, of the thesis's conditional regression on the
    deviations from the sample mean (sections 2.3 and 2.11). Time runs from 0 to 1 in equal steps along the
    last axis; velocities and decelerations may be in any consistent unit, since both results are free of it.
    ω_n T is NaN where the fitted ω_n² is negative.
    """
    step = 1 / (velocity.shape[-1] - 1)
    depth = trapezoids(velocity, step)
    depth -= np.trapezoid(depth, dx=step, axis=-1)[..., None]
    v, x, d = velocity, depth, deceleration
    products = (v * v, v * x, x * x, d * v, d * x)
    vv, vx, xx, dv, dx = (np.trapezoid(product, dx=step, axis=-1) for product in products)
    determinant = vv * xx - vx * vx
    damping = (dv * xx - dx * vx) / determinant
    squared = (dx * vv - dv * vx) / determinant
    omega = np.sqrt(np.where(squared > 0, squared, np.nan))
    return omega, damping / (2 * omega)


@cache
def made_up_pulses() -> tuple[Pulses, Pulses]:
    """Velocity and deceleration, from contact to rest, of blows of very different shape.

    Bells exp(−(s − c)²/2w²) with the greatest deceleration anywhere from a third of the way to well after
    the end of the window, and broad to narrow, each scaled to bring the impactor to rest at s = 1.
    """
    time = np.linspace(0, 1, _SAMPLES)
    centre, width = (
        grid.reshape(-1, 1) for grid in np.meshgrid(np.linspace(0.4, 1.2, 9), (0.25, 0.3, 0.4, 0.5))
    )
    bell = np.exp(-((time - centre) ** 2) / (2 * width**2))
    lost = trapezoids(bell, 1 / (_SAMPLES - 1))
    return 1 - lost / lost[:, -1:], bell / lost[:, -1:]


def frequency_of_the_window(impacts: AuditedImpacts) -> Iterator[Numbers]:
    """A natural frequency that is the same for all may be the reciprocal of the window.

    Minor: it shows where the one natural frequency may come from; only the recordings could prove it.
    """
    if not impacts.mass_exponent.is_one or variation(impacts.omega_n) > 0.1:
        return
    product, zeta = (pd.Series(values).agg(["min", "max"]) for values in centred_fit(*made_up_pulses()))
    omega, mass = np.median(impacts.omega_n), impacts.conditions["mass_kg"]
    fit = {"product": product, "zeta": zeta, "window": product / omega, "blows": len(made_up_pulses()[0])}
    yield {"omega": omega, "slower": np.sqrt(mass.max() / mass.min()), **fit}


def peak(impacts: AuditedImpacts) -> tuple[PerImpact, PerImpact]:
    """Time to peak (s) and peak displacement (m) of the impactor on a spring and damper of K and C."""
    velocity = impacts.rows["velocity_m_s"].to_numpy()
    time = time_to_peak(impacts.omega_n, impacts.zeta)
    depth = peak_displacement(impacts.omega_n, impacts.zeta, velocity)
    return np.asarray(time), np.asarray(depth)


def implied_penetration(impacts: AuditedImpacts) -> Iterator[Numbers]:
    """How deep, and for how long, an impactor would sink into a tissue of the estimated K and C.

    Major: an impactor that sinks through the limb was stopped by another K and C, or in another unit.
    """
    time, depth = peak(impacts)
    middle, stiffness = np.median(depth), np.median(impacts.rows["K"])
    if middle <= impacts.tissue_m and np.median(time) <= SLOWEST_PEAK_S:
        return
    factor = (middle / impacts.tissue_m) ** 2
    yield {
        "limit_mm": 1000 * impacts.tissue_m,
        "depth_cm": pd.Series(100 * depth).describe(),
        "time": pd.Series(time).describe(),
        "stiffness": stiffness,
        "factor": _two_digits(factor),
        "needed": _two_digits(stiffness * factor),
    }


def kinetic_energy(impacts: AuditedImpacts) -> Iterator[Numbers]:
    """E = ½MV² with energy, mass and velocity as given.

    Major: K and C are proportional to the mass, so a wrong mass or velocity goes straight into them.
    """
    conditions = impacts.conditions
    energy, velocity, mass = (conditions[name] for name in ("energy_J", "velocity_m_s", "mass_kg"))
    ratio = mass * velocity**2 / 2 / energy
    wrong = ratio[(ratio - 1).abs() > 0.02]
    if wrong.empty:
        return
    implied = (2 * energy / mass) ** 0.5
    shift = implied - velocity
    by_level = implied.groupby(velocity).mean()
    yield {
        "stated": number_list(np.unique(velocity)),
        "implied": number_list(np.unique(implied.round(2))),
        "conditions": len(conditions),
        "wrong": wrong.describe(),
        "worst": conditions.assign(kinetic_J=ratio * energy).iloc[int(ratio.to_numpy().argmin())],
        "shift": abs(shift.mean()),
        "higher": "higher" if shift.mean() > 0 else "lower",
        "within": ((shift - shift.mean()).abs() / velocity).max(),
        "levels": "; ".join(f"{level:g} read {mean:.3f}" for level, mean in by_level.items()),
    }


def _two_digits(value: float) -> float:
    return float(f"{value:.1e}")
