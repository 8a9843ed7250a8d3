"""The truth of simulated campaigns, and the deceleration that a recorder makes of their impacts.

The truth is tissue, people, measuring chain and the strength of one cause. All impacts of a batch are
recorded in one compiled call.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from bayestissue.elements import linear
from bayestissue.elements.element import (
    Element,
    at_contact,
    complete,
    deceleration_of,
    inertia,
    rates_of_motion,
)
from bayestissue.elements.registry import element as named
from bayestissue.elements.solver import cubic
from bayestissue.oscillator import peak_displacement, spring_damper_inverse, time_to_peak
from bayestissue.thesis.causes.design import Design
from bayestissue.thesis.causes.specification import Cause, CausesSpecification

type PerCampaign = Float[np.ndarray, " campaign"]
type PerImpact = Float[np.ndarray, "campaign impact"]


@dataclass(frozen=True)
class Truth:
    """What is true of a batch of campaigns.

    Attributes:
        strength: of the cause, by name, [campaign].
        element: what is hit, a name of `bayestissue.elements`.
        parameters: of the element by name, [campaign, impact].
        velocity: at contact, [campaign, impact], m/s.
        gain: of the recorder, [campaign].
        offset_sd: of the recorder, relative to each peak, [campaign].
        noise: standard deviation, relative to each peak, [campaign].
        time_to_peak: of the typical person at the reference mass, [campaign], s.
        samples_to_peak: samples in that time, [campaign].
    """

    strength: Mapping[str, PerCampaign]
    element: str
    parameters: Mapping[str, PerImpact]
    velocity: PerImpact
    gain: PerCampaign
    offset_sd: PerCampaign
    noise: PerCampaign
    time_to_peak: PerCampaign
    samples_to_peak: PerCampaign

    @property
    def dt(self) -> PerCampaign:
        """Sampling interval, s: one for all impacts of a campaign."""
        return self.time_to_peak / self.samples_to_peak


def draw_truth(
    cause: Cause,
    specification: CausesSpecification,
    design: Design,
    random: np.random.Generator,
    count: int,
) -> Truth:
    """Draw ``count`` campaigns in which only ``cause`` acts.

    log K of an impact is that of the typical person plus a person's effect plus an impact's own, all
    normal; the same for C. Masses are the design's, exactly; contact velocities scatter about the design's.
    """
    tissue, recording = specification.tissue, specification.recording
    strength = {name: cause.strength[name].draw(random, count) for name in sorted(cause.strength)}
    K0, zeta0 = tissue.K_N_per_m.draw(random, count), tissue.zeta.draw(random, count)
    mass, velocity = design.reference_mass, design.reference_velocity
    C0 = 2 * zeta0 * np.sqrt(K0 * mass)
    omega, zeta = spring_damper_inverse(K0, C0, mass)
    linear_peak = np.asarray(time_to_peak(omega, zeta))
    depth = np.asarray(peak_displacement(omega, zeta, velocity))
    K, C = (
        typical[:, None] * np.exp(_effects(of_people, of_impacts, design, random))
        for typical, of_people, of_impacts in (
            (K0, tissue.sd_subject_K.draw(random, count), tissue.sd_impact_K.draw(random, count)),
            (C0, tissue.sd_subject_C.draw(random, count), tissue.sd_impact_C.draw(random, count)),
        )
    )
    scatter = recording.relative_velocity_sd.draw(random, count)[:, None] * random.standard_normal(K.shape)
    error = strength.get("error_m_s", np.zeros(count))[:, None]
    element, parameters = _element(cause, strength, K, C, design, depth, linear_peak)
    peak = _typical_peak(element, parameters, linear_peak, design)
    return Truth(
        strength=strength,
        element=element,
        parameters=parameters,
        velocity=np.maximum(design.velocity * (1 + scatter) + error, 0.05 * design.velocity),
        gain=recording.gain.draw(random, count),
        offset_sd=recording.offset_relative_to_peak_sd.draw(random, count),
        noise=recording.noise_relative_to_peak.draw(random, count),
        time_to_peak=peak,
        samples_to_peak=recording.samples_to_peak.draw(random, count),
    )


def _typical_peak(
    element: str, parameters: Mapping[str, PerImpact], linear: PerCampaign, design: Design
) -> PerCampaign:
    """Time to peak of the element's median impact at the reference mass and velocity.

    A damper in series may let the impactor creep on for ever: then four times that of the linear tissue, on
    which all that moves would be.
    """
    if element == "kelvin_voigt":
        return linear
    typical = {name: np.median(value, axis=1) for name, value in parameters.items()}
    mass, velocity = (np.full_like(linear, v) for v in (design.reference_mass, design.reference_velocity))
    moves = inertia(named(element), typical, jnp.asarray(mass))
    unit = linear * np.sqrt(np.asarray(moves) / mass)
    return unit * np.asarray(peak_over(element, typical, mass, velocity, unit))


def _effects(
    of_people: PerCampaign, of_impacts: PerCampaign, design: Design, random: np.random.Generator
) -> PerImpact:
    count = len(of_people)
    people = random.standard_normal((count, design.subjects))[:, design.subject]
    impacts = random.standard_normal((count, len(design.mass)))
    return of_people[:, None] * people + of_impacts[:, None] * impacts


def _element(
    cause: Cause,
    strength: Mapping[str, PerCampaign],
    K: PerImpact,
    C: PerImpact,
    design: Design,
    depth: PerCampaign,
    peak: PerCampaign,
) -> tuple[str, dict[str, PerImpact]]:
    """What is hit, and its parameters; C is what the element's own damper takes where there is one beside."""
    s = {name: value[:, None] for name, value in strength.items()}
    element, depth, peak = "kelvin_voigt", depth[:, None], peak[:, None]
    parameters = {"K": K, "C": C}
    match cause.mechanism:
        case "active":
            grown = s["power_K"] * np.log(_driver(cause, design))
            parameters = {"K": K * np.exp(grown), "C": C * np.exp(s["power_C_over_power_K"] * grown)}
        case "stiffening":
            element, parameters["stiffening_depth_m"] = "stiffening", depth / np.sqrt(s["stiffening"])
        case "wall":
            element, parameters["thickness_m"] = "wall", s["thickness_over_depth"] * depth
        case "maxwell":
            element, parameters["C"] = "maxwell", s["relaxation"] * peak * K
        case "standard linear":
            element, ratio = "standard_linear", s["spring_over_spring"]
            parameters |= {"C": s["relaxation"] * peak * ratio * K, "arm_ratio": ratio}
        case "moving mass":
            element = "moving_mass"
            parameters["moving_mass_kg"] = s["moving_mass_over_mass"] * design.reference_mass
    return element, {name: np.broadcast_to(value, K.shape) for name, value in parameters.items()}


def _driver(cause: Cause, design: Design) -> Float[np.ndarray, " impact"]:
    """What the muscles answer to, as a multiple of its value at the reference mass and velocity."""
    mass, velocity = design.mass / design.reference_mass, design.velocity / design.reference_velocity
    return {"mass": mass, "energy": mass * velocity**2, "momentum": mass * velocity}[cause.driver or "mass"]


LONGEST = 4.0
_UNHEARD_OF = 1e7
_CONTACT_STEPS = 1024
_STEPS = 256


@partial(jax.jit, static_argnames=("element", "count"))
def decelerations(
    element: str,
    parameters: dict[str, Float[Array, " impact"]],
    mass: Float[Array, " impact"],
    velocity: Float[Array, " impact"],
    first_time: Float[Array, " impact"],
    dt: Float[Array, " impact"],
    count: int,
) -> Float[Array, "impact sample"]:
    """F / M at ``first_time`` + k ``dt`` after contact, k = 0 ... count - 1; 0 once the tissue lets go.

    NaN throughout for an impact whose steps are too long for so stiff an element: their errors then grow
    beyond a million g.

    Args:
        element: name of what is hit.
        parameters: of the element, by name.
        mass: kg.
        velocity: at contact, m/s.
        first_time: s, at most ``dt``.
        dt: s.
        count: number of samples.
    """
    which, p, y = _path(element, parameters, mass, velocity, first_time, dt, count)
    columns = {name: value if value.ndim == 0 else value[:, None] for name, value in p.items()}
    d = deceleration_of(which, columns, mass[:, None], y)
    has_pushed = jnp.cumsum(d > 0, axis=1) > 0
    let_go = jnp.cumsum((d <= 0) & has_pushed, axis=1) > 0
    pushes = jnp.where(let_go, 0.0, jnp.maximum(d, 0.0))
    followed = (pushes < _UNHEARD_OF).all(axis=1, keepdims=True)
    return jnp.where(followed, pushes, jnp.nan)


@partial(jax.jit, static_argnames="element")
def peak_over(
    element: str,
    parameters: dict[str, Float[Array, " impact"]],
    mass: Float[Array, " impact"],
    velocity: Float[Array, " impact"],
    unit: Float[Array, " impact"],
) -> Float[Array, " impact"]:
    """Time to zero velocity over ``unit``, s, to 1/64; `LONGEST` where the impactor creeps on beyond it."""
    dt = unit * LONGEST / _STEPS
    _, _, y = _path(element, parameters, mass, velocity, jnp.zeros_like(unit), dt, _STEPS)
    stopped = y[1] <= 0
    step = jnp.where(stopped.any(axis=1), jnp.argmax(stopped, axis=1), _STEPS)
    return step * LONGEST / _STEPS


def _path(
    element: str,
    parameters: dict[str, Array],
    mass: Array,
    velocity: Array,
    first: Array,
    dt: Array,
    count: int,
) -> tuple[Element, dict[str, Array], Array]:
    which = named(element)
    p = complete(which, parameters, None)
    if which.linear:
        return which, p, linear.even_grid(which, p, mass, velocity, first, dt, count)
    return which, p, _stepped(which, p, mass, velocity, first[:, None] + jnp.arange(count) * dt[:, None])


def _stepped(which: Element, p: dict[str, Array], mass: Array, velocity: Array, time: Array) -> Array:
    """The state at ``time`` by equal steps of Runge and Kutta over twice the contact of an undamped spring K.

    A stiffer or damped element lets go sooner; at later times the state stays that at the end. Between steps
    it is the cubic through states and rates.
    """
    step = 2 * jnp.pi * jnp.sqrt(mass / p["K"]) / _CONTACT_STEPS

    def rates(y: Array) -> Array:
        derivative = rates_of_motion(which, p, mass, y)
        return derivative.at[1].set(jnp.minimum(derivative[1], 0.0))

    def advance(y: Array, _: None) -> tuple[Array, tuple[Array, Array]]:
        k1 = rates(y)
        k2 = rates(y + step / 2 * k1)
        k3 = rates(y + step / 2 * k2)
        k4 = rates(y + step * k3)
        return y + step / 6 * (k1 + 2 * k2 + 2 * k3 + k4), (y, k1)

    _, (y, slope) = jax.lax.scan(
        advance, at_contact(which, p, mass, velocity), None, length=_CONTACT_STEPS + 1
    )
    index = jnp.clip(jnp.floor(time / step[:, None]), 0, _CONTACT_STEPS - 1).astype(int)
    impact = jnp.arange(len(mass))[:, None]
    (y0, y1), (k0, k1) = (
        [jnp.moveaxis(part[index + k, :, impact], -1, 0) for k in (0, 1)] for part in (y, slope)
    )
    into = jnp.clip(time / step[:, None] - index, 0.0, 1.0)
    return cubic((y0, y1), (k0, k1), into, step[:, None])


@jax.jit
def recorded(
    deceleration: Float[Array, "impact sample"],
    gain: Float[Array, " impact"],
    offset: Float[Array, " impact"],
    noise: Float[Array, "impact sample"],
) -> Float[Array, "impact sample"]:
    """The recorder's samples: gain, and offset and noise in units of each impact's peak deceleration."""
    peak = jnp.max(deceleration, axis=1, keepdims=True)
    return gain[:, None] * deceleration + peak * (offset[:, None] + noise)
