"""Whether energy, velocity, mass, K and C fit one and the same blow."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pandas as pd
from jaxtyping import Float

from bayestissue.oscillator import peak_displacement, time_to_peak
from bayestissue.thesis.audit.findings import GENERAL, Finding, Impacts

THICKEST_TISSUE_M = 0.05
"""Taken where the thickness isn't known: more than the soft tissue over any bone of the arm or leg."""

SLOWEST_PEAK_S = 0.1
"""A hard object struck against tissue over bone comes to rest in 5 to 50 ms; twice that is out of reach."""

_FEW = 0.05


def peak(impacts: Impacts) -> tuple[Float[np.ndarray, " impact"], Float[np.ndarray, " impact"]]:
    """Time to peak (s) and peak displacement (m) of the impactor on a spring and damper of K and C."""
    velocity = impacts.rows["velocity_m_s"].to_numpy()
    time = time_to_peak(impacts.omega_n, impacts.zeta)
    depth = peak_displacement(impacts.omega_n, impacts.zeta, velocity)
    return np.asarray(time), np.asarray(depth)


@GENERAL.check(
    severity="major",
    bearing="physics",
    reason="an impactor that sinks through the limb was stopped by another K and C, or in another unit",
)
def implied_penetration(impacts: Impacts) -> Iterator[Finding]:
    """How deep, and for how long, an impactor would sink into a tissue of the estimated K and C."""
    time, depth = peak(impacts)
    limit = THICKEST_TISSUE_M if impacts.tissue_m is None else impacts.tissue_m
    middle = float(np.median(depth))
    if middle <= limit and np.median(time) <= SLOWEST_PEAK_S:
        return
    known = (
        "the greatest thickness stated for it" if impacts.tissue_m else "more than covers any bone of a limb"
    )
    stiffness = np.median(impacts.rows["K"])
    yield Finding(
        impacts.where,
        "penetration that K and C imply",
        f"tissue up to {limit * 1000:.3g} mm",
        f"{depth.min() * 100:.0f} to {depth.max() * 100:.0f} cm, reached after {time.min():.2f} to "
        f"{time.max():.2f} s",
        f"With M, V, K and C as given, the impactor would come to rest {middle * 100:.0f} cm deep (median) "
        f"after {np.median(time):.2f} s, in tissue of {limit * 1000:.3g} mm ({known}). To stop the same "
        f"mass within that, K would have to be at least {_two_digits((middle / limit) ** 2):,.0f} times "
        f"larger, some {_two_digits(stiffness * (middle / limit) ** 2):,.0f} N/m instead of "
        f"{stiffness:.0f}: in N/m and N s/m the figures can't describe the tissue; the unit of time in the "
        "fit can't have been the second.",
    )


@GENERAL.check(
    severity="major",
    bearing="physics",
    reason="tissue that adds energy to a blow does not exist; a few such estimates may be noise",
)
def energy_from_nowhere(impacts: Impacts) -> Iterator[Finding]:
    """Springs that push the wrong way and dampers that drive."""
    total = len(impacts.rows) + impacts.left_out
    if not impacts.below_zero:
        return
    share = impacts.below_zero / total
    yield Finding(
        impacts.where,
        "K or C below zero",
        f"{impacts.below_zero} of {total} rows",
        "none",
        f"{impacts.below_zero} of {total} estimates ({share:.0%}) have a K or a C that is not above zero, "
        "which would feed energy into the blow; a tissue that stiffens as it is compressed looks like "
        "that to a spring and a damper whose constants are fixed.",
        None if share > _FEW else "minor",
    )


@GENERAL.check(
    severity="major",
    bearing="physics",
    reason="a K and C that do not bring back the peak they were fitted to do not describe the trace",
)
def measured_peak(impacts: Impacts) -> Iterator[Finding]:
    """Time to peak and peak displacement as recorded, beside those that K and C imply."""
    time, depth = peak(impacts)
    for column, implied, what, unit in (
        ("time_to_peak_s", time, "time to peak", "ms"),
        ("peak_displacement_m", depth, "peak displacement", "mm"),
    ):
        if column not in impacts.rows:
            continue
        measured = pd.to_numeric(impacts.rows[column], errors="coerce").to_numpy(dtype="float64")
        ratio = float(np.nanmedian(implied / measured))
        if not 0.8 <= ratio <= 1.25:
            yield Finding(
                impacts.where,
                f"{what}, recorded and implied",
                f"{np.nanmedian(measured) * 1000:.3g} {unit}",
                f"{np.median(implied) * 1000:.3g} {unit}",
                f"A mass on a spring and damper of the estimated K and C would have a {what} {ratio:.2f} "
                "times the recorded one (median over the impacts): the fit has not caught the impact "
                "itself.",
            )


@GENERAL.check(
    severity="major",
    bearing="inputs",
    reason="K and C are proportional to the mass, so a wrong mass or velocity goes straight into them",
)
def kinetic_energy(impacts: Impacts) -> Iterator[Finding]:
    """E = ½MV² with energy, mass and velocity as given."""
    conditions = impacts.conditions
    if "energy_J" not in conditions:
        return
    energy, velocity, mass = (conditions[name] for name in ("energy_J", "velocity_m_s", "mass_kg"))
    ratio = mass * velocity**2 / 2 / energy
    wrong = (ratio - 1).abs() > 0.02
    if not wrong.any():
        return
    implied = (2 * energy / mass) ** 0.5
    worst = int(ratio.to_numpy().argmin())
    yield Finding(
        impacts.where,
        "energy, velocity and mass",
        f"V = {_list(np.unique(velocity))} m/s",
        f"V = {_list(np.unique(implied.round(2)))} m/s from √(2E/M)",
        f"In {wrong.sum()} of {len(conditions)} conditions ½MV² is not the stated energy but "
        f"{ratio[wrong].min():.2f} to {ratio[wrong].max():.2f} of it (trial {ratio.index[worst]}: "
        f"½ × {mass.iloc[worst]:g} × {velocity.iloc[worst]:g}² = {(ratio * energy).iloc[worst]:.3f} J, "
        f"not {energy.iloc[worst]:g} J). "
        + _pattern(velocity, implied)
        + " At least one of the three columns is not that of the experiment.",
    )


def _pattern(velocity: pd.Series, implied: pd.Series) -> str:
    """Which velocities would make the columns agree, in words."""
    by_level = implied.groupby(velocity).agg(["mean", "min", "max"])
    steady = ((by_level["max"] - by_level["min"]) < 0.01 * by_level["mean"]).all()
    words = "; ".join(f"{level:g} read {row['mean']:.3f}" for level, row in by_level.iterrows())
    if not steady:
        return f"No single velocity a level would mend it: from √(2E/M), on average, for {words}."
    shift = (implied - velocity).to_numpy()
    if np.ptp(shift) < 0.01 * velocity.mean():
        return (
            "The masses agree with the energies, to "
            f"{(np.abs(shift - shift.mean()) / velocity).max():.1%}, if every velocity were "
            f"{abs(shift.mean()):.2f} m/s {'higher' if shift.mean() > 0 else 'lower'} than stated (for "
            f"{words} m/s)."
        )
    return f"The masses agree with the energies if for {words} m/s."


def _list(values: Float[np.ndarray, " level"]) -> str:
    return ", ".join(f"{value:g}" for value in values)


def _two_digits(value: float) -> float:
    return float(f"{value:.1e}")
