"""What the thesis's fit about the sample mean gives for blows of any shape."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache

import numpy as np
from jaxtyping import Float

from bayestissue.signal.integration import trapezoids
from bayestissue.thesis.audit.findings import Finding
from bayestissue.thesis.audit.impacts import GENERAL, Impacts
from bayestissue.thesis.audit.information import mass_exponent, variation

_STEPS = 2001


def centred_fit(
    velocity: Float[np.ndarray, "pulse time"], deceleration: Float[np.ndarray, "pulse time"]
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
    vv, vx, xx, dv, dx = (
        np.trapezoid(product, dx=step, axis=-1)
        for product in (
            velocity * velocity,
            velocity * depth,
            depth * depth,
            deceleration * velocity,
            deceleration * depth,
        )
    )
    determinant = vv * xx - vx * vx
    damping = (dv * xx - dx * vx) / determinant
    squared = (dx * vv - dv * vx) / determinant
    omega = np.sqrt(np.where(squared > 0, squared, np.nan))
    return omega, damping / (2 * omega)


@cache
def made_up_pulses() -> tuple[Float[np.ndarray, "pulse time"], Float[np.ndarray, "pulse time"]]:
    """Velocity and deceleration, from contact to rest, of blows of very different shape.

    Bells exp(−(s − c)²/2w²) with the greatest deceleration anywhere from a third of the way to well after
    the end of the window, and broad to narrow, each scaled to bring the impactor to rest at s = 1.
    """
    time = np.linspace(0, 1, _STEPS)
    centre, width = (
        grid.reshape(-1, 1) for grid in np.meshgrid(np.linspace(0.4, 1.2, 9), (0.25, 0.3, 0.4, 0.5))
    )
    bell = np.exp(-((time - centre) ** 2) / (2 * width**2))
    lost = trapezoids(bell, 1 / (_STEPS - 1))
    return 1 - lost / lost[:, -1:], bell / lost[:, -1:]


@GENERAL.check(
    severity="minor",
    bearing="method",
    reason="it shows where the one natural frequency may come from; only the recordings could prove it",
)
def frequency_of_the_window(impacts: Impacts) -> Iterator[Finding]:
    """A natural frequency that is the same for all may be the reciprocal of the window."""
    exponent = mass_exponent(impacts)
    if exponent is None or not exponent.is_one or variation(impacts.omega_n) > 0.1:
        return
    product, zeta = centred_fit(*made_up_pulses())
    low, high = float(np.nanmin(product)), float(np.nanmax(product))
    omega = float(np.median(impacts.omega_n))
    mass = impacts.conditions["mass_kg"]
    yield Finding(
        impacts.where,
        "natural frequency and length of the window",
        f"ω_n = {omega:.2f} rad/s (median)",
        f"window of {low / omega:.2f} to {high / omega:.2f} s for every impact",
        f"A fit about the sample mean from contact to peak gives ω_n T between {low:.2f} and {high:.2f} "
        f"(and ζ between {zeta.min():.2f} and {zeta.max():.2f}) for {len(product)} made-up blows of quite "
        "different shape, T being the length of the window: what comes out is the window, whatever the "
        f"tissue. ω_n = {omega:.2f} rad/s belongs to T = {low / omega:.2f} to {high / omega:.2f} s for "
        "every mass, where a tissue of fixed stiffness would make the heaviest take "
        f"{np.sqrt(mass.max() / mass.min()):.2f} times as long as the lightest: time seems to have been "
        "counted in a unit of each impact's own length.",
    )
