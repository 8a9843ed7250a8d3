"""What a mechanical element is: a force, the rates of what it remembers, and the energy it keeps."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from bayestissue.base.impact_arrays import JaxPerImpact

# The middle one of the thesis's three wooden balls.
REFERENCE_DIAMETER_M = 0.0318

Parameters = dict[str, Array]
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

    @property
    def of_mass(self) -> bool:
        """Whether its unit holds one of mass: no motion changes if it and the impactor's mass grow alike."""
        return self.unit.split("/")[0].split()[0] in ("N", "kg")


# Beside an element's parameters, where it is not 0: the part of gravity along the motion [m/s^2].
GRAVITY = "gravity_m_s2"


def unchanged(K: Array, C: Array, mass: Array) -> tuple[Array, Array]:
    """K and C of an element that is nearly a spring and damper side by side."""
    return K, C


def no_rates(x: Array, v: Array, s: States, p: Parameters) -> States:
    """The rates of an element that remembers nothing."""
    return ()


# What impacts come to, by name; see `outcomes.outcomes`.
type Outcomes = dict[str, JaxPerImpact]


@dataclass(frozen=True)
class Element:
    """A mechanical element between impactor and ground, at rest and unloaded before contact.

    Its first two parameters are a stiffness and a damping. Every function takes (x, v, s, p): penetration [m]
    and its velocity [m/s], the internal lengths [m] as a tuple, and the parameters by name, with
    ``diameter_m`` of the impactor beside them. All of them are arrays that broadcast, and all functions are
    differentiable JAX.

    Attributes:
        name: as model files write it.
        title: in words.
        law: the force F, and the rates of the internal lengths s, in LaTeX, as the manual shows them.
        K: what the stiffness is here [N/m].
        C: what the damping is here [N s/m].
        force: of the tissue, positive where it pushes [N].
        stored: energy in the springs [J].
        extra: the parameters besides K and C.
        rates: of the internal lengths [m/s], one each.
        states: number of internal lengths.
        linear: whether force and rates are linear in x, v and s.
        added_mass: of tissue that moves along with the impactor from contact on [kg], from the parameters;
            None where all tissue is without mass. ``force`` is the tissue's own, on both together: the
            impactor feels less of it, see `Collision.deceleration`.
        jumps: whether the force jumps at contact, as a damper between impactor and ground makes it. Where it
            does not, a recording does not show when contact was.
        level_outcomes: of an impact without gravity along its motion, from the parameters, M and V: those of
            which there is a closed form.
        guess: K and C of an impact that spring and damper side by side with (K, C) describe roughly, at
            this mass [kg].
    """

    name: str
    title: str
    law: str
    K: str
    C: str
    force: Law
    stored: Law
    extra: tuple[Parameter, ...] = ()
    rates: Callable[[Array, Array, States, Parameters], States] = no_rates
    states: int = 0
    linear: bool = False
    added_mass: Callable[[Parameters], Array] | None = None
    jumps: bool = True
    level_outcomes: Callable[[Parameters, Array, Array], Outcomes] | None = None
    guess: Callable[[Array, Array, Array], tuple[Array, Array]] = unchanged

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """All parameters, in the order of an impact's own."""
        return (Parameter("K", "N/m", self.K), Parameter("C", "N s/m", self.C), *self.extra)


@partial(
    jax.tree_util.register_dataclass,
    data_fields=["parameters", "mass", "velocity"],
    meta_fields=["element"],
)
@dataclass(frozen=True)
class Collision:
    """Impactors that meet an element.

    Attributes:
        element: what they meet.
        parameters: of the element and its surroundings, by name.
        mass: of each impactor [kg].
        velocity: at contact [m/s].
    """

    element: Element
    parameters: Parameters
    mass: JaxPerImpact
    velocity: JaxPerImpact

    @classmethod
    def of(
        cls,
        element: Element,
        parameters: Mapping[str, ArrayLike],
        mass: ArrayLike,
        velocity: ArrayLike,
        *,
        diameter: ArrayLike | None = None,
        gravity: ArrayLike | None = None,
        shape: tuple[int, ...] = (1,),
    ) -> Collision:
        """Of numbers and arrays that broadcast, with each other and to ``shape``.

        Args:
            element: what they meet.
            parameters: of the element, by name.
            mass: M [kg].
            velocity: V at contact [m/s].
            diameter: of the impactor [m]; the reference diameter unless given.
            gravity: g, the part of gravity along the motion [m/s^2]; none unless given.
            shape: how many impacts there are at the least.

        Raises:
            KeyError: a parameter of the element is missing, or one is not the element's.
        """
        expected = {parameter.name for parameter in element.parameters}
        if set(parameters) != expected:
            raise KeyError(f"{element.name} has the parameters {sorted(expected)}, not {sorted(parameters)}")
        surroundings = {"diameter_m": REFERENCE_DIAMETER_M if diameter is None else diameter}
        surroundings |= {} if gravity is None else {GRAVITY: gravity}
        values = {**parameters, **surroundings, "mass": mass, "velocity": velocity}
        arrays = {name: jnp.asarray(value, float) for name, value in values.items()}
        shape = jnp.broadcast_shapes(shape, *(value.shape for value in arrays.values()))
        p = {name: jnp.broadcast_to(value, shape) for name, value in arrays.items()}
        return cls(element, mass=p.pop("mass"), velocity=p.pop("velocity"), parameters=p)

    @property
    def gravity(self) -> Array | float:
        """The impactor's acceleration while nothing pushes: g along the motion [m/s^2]."""
        return self.parameters.get(GRAVITY, 0.0)

    @property
    def inertia(self) -> Array:
        """M + m [kg]: the impactor and the tissue that moves along with it."""
        added_mass = self.element.added_mass
        return self.mass if added_mass is None else self.mass + added_mass(self.parameters)

    @property
    def impactor_share(self) -> Array | float:
        """M / (M + m), 1 where no tissue moves along: the velocity just after contact over that before it."""
        return 1.0 if self.element.added_mass is None else self.mass / self.inertia

    def columns(self) -> Collision:
        """The same beside times along a last axis."""
        columns: Collision = jax.tree.map(lambda value: value[:, None], self)
        return columns

    def at_contact(self) -> Array:
        """Y just after contact at V: everything at rest but what moves, at V M / (M + m).

        The impactor takes the added mass along at once, as in a collision without restitution.
        """
        still = jnp.zeros_like(self.velocity)
        begins = self.impactor_share * self.velocity
        return jnp.stack([still, begins, *(still for _ in range(self.element.states))])

    def rates(self, y: Array) -> Array:
        """dy/dt with (M + m) x'' = M g - F for y = (x, v, internal lengths) on the first axis.

        Tissue carries its own weight before contact, so that gravity pulls on the impactor alone.
        """
        x, v, s = y[0], y[1], tuple(y[2:])
        acceleration = self.impactor_share * (self.gravity - self.tissue_force_over_mass(y))
        return jnp.stack([v, acceleration, *self.element.rates(x, v, s, self.parameters)])

    def tissue_force_over_mass(self, y: Array) -> Array:
        """F / M [m/s^2]: what a sensor below the tissue reads, over the impactor's mass."""
        return self.element.force(y[0], y[1], tuple(y[2:]), self.parameters) / self.mass

    def deceleration(self, y: Array) -> Array:
        """The force on the impactor over its mass, g - x'' [m/s^2]: a sensor reads it, 0 in free fall.

        F / M where no tissue moves along, else (F / M) M / (M + m) + g m / (M + m).
        """
        share = self.impactor_share
        return share * self.tissue_force_over_mass(y) + (1 - share) * self.gravity
