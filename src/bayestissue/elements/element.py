"""What a mechanical element is: a force, the rates of what it remembers, and the energy it keeps."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import jax.numpy as jnp
from jax import Array

# The middle one of the thesis's three wooden balls.
REFERENCE_DIAMETER_M = 0.0318

Parameters = Mapping[str, Array]
States = tuple[Array, ...]
Law = Callable[[Array, Array, States, Parameters], Array]


@dataclass(frozen=True)
class Parameter:
    """A positive quantity of an element.

    Attributes:
        name: as model files write it.
        unit: its unit.
        meaning: what it is.
        typical: what it is unless something is known; not for K and C.
        log_sd: how well that is known: standard deviation of the log.
    """

    name: str
    unit: str
    meaning: str
    typical: float = 1.0
    log_sd: float = 2.5


STIFFNESS = "K"
# Beside an element's parameters, where it is not 0: the part of gravity along the motion [m/s^2].
GRAVITY = "gravity_m_s2"
DAMPING = "C"


def unchanged(K: Array, C: Array, mass: Array) -> tuple[Array, Array]:
    """K and C of an element that is nearly a spring and damper side by side."""
    return K, C


def no_rates(x: Array, v: Array, s: States, p: Parameters) -> States:
    """The rates of an element that remembers nothing."""
    return ()


@dataclass(frozen=True)
class Element:
    """A mechanical element between impactor and ground, at rest and unloaded before contact.

    The first two parameters are ``K`` [N/m] and ``C`` [N s/m]; their ``meaning`` says what they are here.
    Every function takes (x, v, s, p): penetration [m] and its velocity [m/s], the internal lengths [m] as a
    tuple, and the parameters by name, with ``diameter_m`` of the impactor beside them. All of them are
    arrays that broadcast, and all functions are differentiable JAX.

    Attributes:
        name: as model files write it.
        title: in words.
        parameters: in the order of an impact's own parameters.
        force: on the impactor, positive where the tissue pushes [N].
        stored: energy in the springs [J].
        rates: of the internal lengths [m/s], one each.
        states: number of internal lengths.
        linear: whether force and rates are linear in x, v and s.
        jumps: whether the force jumps at contact, as a damper between impactor and ground makes it. Where it
            does not, a recording does not show when contact was.
        guess: K and C of an impact that spring and damper side by side with (K, C) describe roughly, at
            this mass [kg].
    """

    name: str
    title: str
    parameters: tuple[Parameter, ...]
    force: Law
    stored: Law
    rates: Callable[[Array, Array, States, Parameters], States] = no_rates
    states: int = 0
    linear: bool = False
    jumps: bool = True
    guess: Callable[[Array, Array, Array], tuple[Array, Array]] = unchanged

    @property
    def extra(self) -> tuple[Parameter, ...]:
        """The parameters besides K and C."""
        return self.parameters[2:]


def complete(
    element: Element, parameters: Parameters, diameter: Array | None, gravity: Array | None = None
) -> dict[str, Array]:
    """Parameters as arrays, with the impactor's diameter beside them, and gravity where there is any.

    Raises:
        KeyError: a parameter of the element is missing, or one is not the element's.
    """
    expected = {parameter.name for parameter in element.parameters}
    if set(parameters) != expected:
        raise KeyError(f"{element.name} has the parameters {sorted(expected)}, not {sorted(parameters)}")
    size = REFERENCE_DIAMETER_M if diameter is None else diameter
    surroundings = {"diameter_m": jnp.asarray(size)} | ({} if gravity is None else {GRAVITY: gravity})
    return {**{k: jnp.asarray(v, float) for k, v in parameters.items()}, **surroundings}


def falling(p: Parameters) -> Array | float:
    """The impactor's acceleration while nothing pushes: g along the motion [m/s^2]."""
    return p.get(GRAVITY, 0.0)


def rates_of_motion(element: Element, p: Parameters, mass: Array, y: Array) -> Array:
    """dy/dt with M x'' = M g - F for y = (x, v, internal lengths) on the first axis."""
    x, v, s = y[0], y[1], tuple(y[2:])
    acceleration = falling(p) - element.force(x, v, s, p) / mass
    return jnp.stack([v, acceleration, *element.rates(x, v, s, p)])


def at_contact(element: Element, velocity: Array) -> Array:
    """Y at contact: the impactor's velocity, everything else at rest."""
    still = jnp.zeros_like(velocity)
    return jnp.stack([still, velocity, *(still for _ in range(element.states))])


def deceleration_of(element: Element, p: Parameters, mass: Array, y: Array) -> Array:
    """F / M [m/s^2]: what a sensor reads that is 0 in free fall, and without gravity -x''."""
    return element.force(y[0], y[1], tuple(y[2:]), p) / mass
