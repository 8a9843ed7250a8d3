"""What a simulated impactor meets: the motion in contact, and what a lab would like to know of it."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from jax import Array
from jaxtyping import Float

from bayestissue.dataset.settings import gravity_m_s2
from bayestissue.elements import element, impact, outcomes
from bayestissue.elements.element import impactor_share, inertia
from bayestissue.hierarchy import SIDE_BY_SIDE
from bayestissue.inference.results.meanings import HEADFORM_COLUMNS
from bayestissue.oscillator import impact_motion, spring_damper_inverse
from bayestissue.padding import bucket
from bayestissue.simulation.specification import Simulation

# A soft damper in series with the spring lets a mass creep for ever: it is recorded for so long.
_NEVER_RESTS_S = 1.0


def what_is_met(simulation: Simulation, truth: pd.DataFrame) -> pd.DataFrame:
    """The truth with all that follows from mass, velocity and the element's parameters in it.

    All outcomes of the impact are among it, at the true mass and velocity.

    omega_n and zeta are those of stiffness and damping as they compare across elements: K_secant and
    C_equivalent of `bayestissue.elements.Outcomes`, and of all mass that moves. Along gravity a spring and
    damper also has a moment of its own at which it leaves, or none.
    """
    name, gravity = simulation.tissue.element, gravity_m_s2(simulation.gravity) or None
    p, mass, velocity = (
        _parameters(name, truth),
        truth["mass_kg"].to_numpy(),
        truth["velocity_m_s"].to_numpy(),
    )
    surroundings: Any = {"diameter": _diameter(truth), "gravity": gravity, "headform": simulation.headform}
    comes = jax.device_get(outcomes(name, p, mass, velocity, **surroundings))
    known = {column: getattr(comes, outcome) for outcome, column in HEADFORM_COLUMNS.items()}
    moves = inertia(element(name), p, jnp.asarray(mass))
    omega_n, zeta = map(np.asarray, spring_damper_inverse(comes.K_secant, comes.C_equivalent, moves))
    columns = {column: value for column, value in known.items() if value is not None}
    if gravity or name != SIDE_BY_SIDE:
        columns["leaves_s"] = _until(comes.contact_duration, comes.time_to_peak)
    of_element = [parameter.name for parameter in element(name).extra]
    sizes = {column: truth[column] for column in (*of_element, "diameter_m") if column in truth}
    truth = truth.drop(columns=list(sizes))
    truth.insert(3, "omega_n_rad_s", omega_n)
    truth.insert(4, "zeta", zeta)
    if name != SIDE_BY_SIDE:
        columns |= {
            **sizes,
            "K_secant_N_per_m": comes.K_secant,
            "C_equivalent_N_s_per_m": comes.C_equivalent,
            "energy_lost": comes.energy_lost,
        }
    return truth.assign(**columns)


def _until(end: np.ndarray, peak: np.ndarray) -> np.ndarray:
    """When the force ends; one that only fades is recorded for five times as long as it took to the peak."""
    fades = np.where(np.isfinite(peak), 5 * peak, _NEVER_RESTS_S)
    return np.where(np.isfinite(end), end, fades)


def leaves(truth: pd.DataFrame) -> Float[np.ndarray, " impact"]:
    """When the tissue pushes no more [s]; for Kelvin-Voigt twice the time to peak (thesis, section 2.12)."""
    column = truth["leaves_s"] if "leaves_s" in truth else 2 * truth["time_to_peak_s"]
    return column.to_numpy()


def deceleration(
    name: str, truth: pd.DataFrame, time: Float[np.ndarray, " sample"], gravity: float = 0.0
) -> Float[Array, "impact sample"]:
    """Force over mass, [impact, sample]: 0 before contact and once the force is 0.

    Args:
        name: of the element.
        truth: the impacts, with the columns of `what_is_met` and of K, C, mass, velocity and contact time.
        time: on the recorder's clock [s].
        gravity: along the motion [m/s^2].
    """
    contact = truth["contact_time_s"].to_numpy()[:, None]
    samples = len(time)
    # The last time over again: what is compiled for one length of recordings serves others.
    time = np.pad(time, (0, bucket(samples) - samples), mode="edge")
    if name == SIDE_BY_SIDE and not gravity:
        names = ["omega_n_rad_s", "zeta", "velocity_m_s"]
        motion = tuple(truth[column].to_numpy()[:, None] for column in names)
        return _side_by_side(time, contact, leaves(truth)[:, None], motion)[:, :samples]
    p = _parameters(name, truth)
    since = jnp.asarray(time - contact)
    mass, velocity = truth["mass_kg"].to_numpy(), truth["velocity_m_s"].to_numpy()
    surroundings = {"diameter": _diameter(truth), "gravity": gravity or None}
    return impact(name, p, mass, velocity, since, **surroundings).deceleration[:, :samples]


def tissue_force(
    name: str, truth: pd.DataFrame, deceleration: Float[np.ndarray, "impact sample"], gravity: float = 0.0
) -> Float[np.ndarray, "impact sample"]:
    """The tissue's own force F [N], of this deceleration d of the impactor: (M + m) d - m g while it pushes.

    What tissue that moved along does once the impactor has left is not followed: F is 0 then.

    Args:
        name: of the element.
        truth: the impacts.
        deceleration: of `deceleration`.
        gravity: along the motion [m/s^2].
    """
    mass = truth["mass_kg"].to_numpy()
    share = np.asarray(impactor_share(element(name), _parameters(name, truth), jnp.asarray(mass)))
    share = np.broadcast_to(share, mass.shape)[:, None]
    pushes = deceleration > 0
    return mass[:, None] / share * np.where(pushes, deceleration - (1 - share) * gravity, 0.0)


def _diameter(truth: pd.DataFrame) -> Float[np.ndarray, " impact"] | None:
    return truth["diameter_m"].to_numpy() if "diameter_m" in truth else None


def _parameters(name: str, truth: pd.DataFrame) -> dict[str, Array]:
    """Of the element, by name, each [impact]."""
    columns = {"K": "K_N_per_m", "C": "C_N_s_per_m"}
    columns |= {parameter.name: parameter.name for parameter in element(name).extra}
    return {parameter: jnp.asarray(truth[column].to_numpy()) for parameter, column in columns.items()}


@jax.jit
def _side_by_side(time: Array, contact: Array, leaves: Array, motion: tuple[Array, ...]) -> Array:
    since = time - contact
    moved = impact_motion(jnp.maximum(since, 0), *motion)
    return jnp.where((since >= 0) & (since < leaves), moved.deceleration, 0)
