"""A mass at rest on a spring and damper, tapped by a hammer: M x'' + C x' + K x = F, in closed form.

F is half a sine of duration T and impulse J, F = (pi / 2) (J / T) sin(pi t / T). That is one sine switched on
as the tap begins and another, later by T, as it ends: x is the sum of the responses to both.
"""

from __future__ import annotations

import numpy as np
import pandas as pd
from jaxtyping import Complex, Float

from bayestissue.simulation.specification import Tap

# The ringing is recorded until it has fallen to this share, and no longer than so many seconds.
_FALLEN, _LONGEST_S = 0.01, 2.0
# Below this |kappa t| two roots are so near to each other that their difference loses digits.
_NEAR = 1e-3


def what_rings(
    K: Float[np.ndarray, " impact"],
    C: Float[np.ndarray, " impact"],
    mass: Float[np.ndarray, " impact"],
    impulse: Float[np.ndarray, " impact"],
) -> dict[str, np.ndarray]:
    """Columns of the truth of tapped masses: omega_n = sqrt(K / M), zeta = C / (2 sqrt(K M)), and J."""
    return {"omega_n_rad_s": np.sqrt(K / mass), "zeta": C / (2 * np.sqrt(K * mass)), "impulse_N_s": impulse}


def rings(tap: Tap, truth: pd.DataFrame) -> Float[np.ndarray, " impact"]:
    """From the tap's begin until the ringing is recorded no more [s]; of two roots the slower one counts."""
    if tap.ringing_s is not None:
        return np.full(len(truth), tap.duration_s + tap.ringing_s)
    omega_n, zeta = (truth[name].to_numpy() for name in ("omega_n_rad_s", "zeta"))
    rate = omega_n * (zeta - np.sqrt(np.maximum(zeta**2 - 1, 0)))
    return tap.duration_s + np.minimum(-np.log(_FALLEN) / rate, _LONGEST_S)


def hammer_force(
    tap: Tap, truth: pd.DataFrame, time: Float[np.ndarray, " sample"]
) -> Float[np.ndarray, "impact sample"]:
    """F [N] at these times of the recorder's clock [s].

    Args:
        tap: T.
        truth: ``contact_time_s``, when the tap begins, and ``impulse_N_s``, J, of each impact.
        time: of the samples.
    """
    since = time - truth["contact_time_s"].to_numpy()[:, None]
    size = np.pi / 2 * truth["impulse_N_s"].to_numpy()[:, None] / tap.duration_s
    pushes = (since > 0) & (since < tap.duration_s)
    return np.where(pushes, size * np.sin(np.pi * since / tap.duration_s), 0.0)


def acceleration(
    tap: Tap, truth: pd.DataFrame, time: Float[np.ndarray, " sample"]
) -> Float[np.ndarray, "impact sample"]:
    """Acceleration x'' = F / M - 2 zeta omega_n x' - omega_n^2 x [m/s^2], at these times [s].

    The times are those of the recorder's clock.

    Args:
        tap: T.
        truth: of each impact ``omega_n_rad_s``, ``zeta``, ``mass_kg``, ``contact_time_s``, when the tap
            begins, and ``impulse_N_s``.
        time: of the samples.
    """
    names = ("omega_n_rad_s", "zeta", "mass_kg", "contact_time_s", "impulse_N_s")
    omega_n, zeta, mass, begin, impulse = (truth[name].to_numpy()[:, None] for name in names)
    decay, omega = zeta * omega_n, np.pi / tap.duration_s
    size = np.pi / 2 * impulse / tap.duration_s / mass
    since = time - begin
    responses = [
        _response(np.maximum(since - later, 0.0), omega_n, decay, omega) for later in (0, tap.duration_s)
    ]
    x, v = (size * (one + other) for one, other in zip(*responses, strict=True))
    return hammer_force(tap, truth, time) / mass - 2 * decay * v - omega_n**2 * x


def _response(
    time: Float[np.ndarray, "impact sample"],
    omega_n: Float[np.ndarray, "impact 1"],
    decay: Float[np.ndarray, "impact 1"],
    omega: float,
) -> tuple[Float[np.ndarray, "impact sample"], Float[np.ndarray, "impact sample"]]:
    """Displacement x and speed x' of x'' + 2 a x' + omega_n^2 x = sin(omega t), at rest at t = 0.

    What the sine keeps up is p sin(omega t) + q cos(omega t). A free motion that begins at -q with the speed
    -omega p comes on top, made of s = exp(-a t) sinh(kappa t) / kappa and c = exp(-a t) cosh(kappa t),
    kappa^2 = a^2 - omega_n^2.
    """
    difference = omega_n**2 - omega**2
    size = difference**2 + (2 * decay * omega) ** 2
    p, q = difference / size, -2 * decay * omega / size
    kappa = np.sqrt((decay**2 - omega_n**2).astype(complex))
    s, c = _free(time, decay, kappa)
    sine, cosine = np.sin(omega * time), np.cos(omega * time)
    x = p * sine + q * cosine - q * (c + decay * s) - omega * p * s
    v = omega * (p * cosine - q * sine) + q * omega_n**2 * s - omega * p * (c - decay * s)
    return x, v


def _free(
    time: Float[np.ndarray, "impact sample"],
    decay: Float[np.ndarray, "impact 1"],
    kappa: Complex[np.ndarray, "impact 1"],
) -> tuple[Float[np.ndarray, "impact sample"], Float[np.ndarray, "impact sample"]]:
    """The free motions s and c of `_response`; where |kappa t| is small, s by its series."""
    slow, fast = np.exp((kappa - decay) * time), np.exp(-(kappa + decay) * time)
    near = np.abs(kappa * time) < _NEAR
    series = time * np.exp(-decay * time) * (1 + (kappa * time) ** 2 / 6)
    s = np.where(near, series, (slow - fast) / (2 * np.where(kappa == 0, 1.0, kappa)))
    return s.real, ((slow + fast) / 2).real
