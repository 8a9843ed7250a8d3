"""The law of force that was fitted: what an impact of a stated motion comes to on it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Float

from bayestissue.elements import REFERENCE_DIAMETER_M, element
from bayestissue.elements.element import GRAVITY
from bayestissue.elements.outcomes import OUTCOMES, outcomes_of
from bayestissue.errors import Coded
from bayestissue.hierarchy.effects import RESPONSES, intercept, parameter_of
from bayestissue.hierarchy.formulas.formula import reference_row
from bayestissue.hierarchy.levels import log_at_levels
from bayestissue.hierarchy.recorded import Condition, Recorded
from bayestissue.inference.answers.settings import SETTINGS
from bayestissue.inference.results.meanings import REFERENCE_OUTCOMES

NO_LAW = Coded("no peaks: beside a discrepancy there is no law to simulate by", "not-simulated")
DROP_HEIGHT = "drop_height_cm"
# Of an impact, beside the tissue that it meets.
MOTION = ("mass_kg", "velocity_m_s", "diameter_m", DROP_HEIGHT)


@dataclass(frozen=True)
class Law:
    """An element, and gravity along the motion.

    Attributes:
        element: its name.
        gravity: [m/s^2]; 0 where there is none.
    """

    element: str
    gravity: float

    def parameters(
        self, draws: xr.Dataset, recorded: Recorded, conditions: Sequence[Condition]
    ) -> dict[str, Float[np.ndarray, "chain draw condition"]]:
        """The element's parameters at given levels: of an impact without the scatter of single ones."""
        names = (*RESPONSES, *(one.name for one in element(self.element).extra))
        return {name: np.exp(parameter_log(draws, recorded, name, conditions)) for name in names}

    def velocity(
        self, recorded: Recorded, conditions: Sequence[Condition]
    ) -> Float[np.ndarray, " condition"]:
        """V at contact [m/s]: (2 g h)^1/2 after a drop from h, else as given, else that of the reference.

        Without gravity along the motion a height is a level like others.
        """
        height = numbers(recorded, [{DROP_HEIGHT: np.nan} | dict(one) for one in conditions], DROP_HEIGHT)
        fallen = np.sqrt(2 * self.gravity * height / 100)
        return np.where(
            np.isfinite(height) & (self.gravity > 0), fallen, numbers(recorded, conditions, "velocity_m_s")
        )

    @property
    def in_closed_form(self) -> bool:
        """Whether outcomes cost next to nothing: else each motion is solved."""
        return element(self.element).level_outcomes is not None and not self.gravity

    def at_levels(
        self, name: str, draws: xr.Dataset, recorded: Recorded, conditions: Sequence[Condition]
    ) -> Float[np.ndarray, "chain draw condition"]:
        """One outcome at given levels and a stated motion, by draw."""
        values = self.all_at_levels(draws, recorded, conditions)[name]
        return values.reshape(draws.sizes["chain"], draws.sizes["draw"], len(conditions))

    def reference_outcomes(
        self, draws: xr.Dataset, recorded: Recorded, conditions: Sequence[Condition]
    ) -> dict[str, Float[np.ndarray, "draw condition"]]:
        """`REFERENCE_OUTCOMES` at given levels, of the reference mass and velocity; none without a velocity.

        Where the law has no closed form, draws are evenly left out: see `simulated_words`.
        """
        if not (len(conditions) and (self.velocity(recorded, conditions) > 0).all()):
            return {}
        count = draws.sizes["chain"] * draws.sizes["draw"]
        step = 1 if self.in_closed_form else simulated_step(count, len(conditions))
        values = self.all_at_levels(draws, recorded, conditions, step)
        return {name: values[name] for name in REFERENCE_OUTCOMES}

    def all_at_levels(
        self, draws: xr.Dataset, recorded: Recorded, conditions: Sequence[Condition], step: int = 1
    ) -> dict[str, Float[np.ndarray, "draw condition"]]:
        """Each outcome at given levels and a stated motion, in one draw of every ``step``."""
        p = self.parameters(draws, recorded, conditions)
        flat = {name: values.reshape(-1, len(conditions))[::step] for name, values in p.items()}
        mass, diameter = (numbers(recorded, conditions, name) for name in ("mass_kg", "diameter_m"))
        return self.outcomes(flat, mass, self.velocity(recorded, conditions), diameter)

    def outcomes(
        self,
        parameters: dict[str, Float[np.ndarray, "draw condition"]],
        mass: Float[np.ndarray, " condition"],
        velocity: Float[np.ndarray, " condition"],
        diameter: Float[np.ndarray, " condition"],
    ) -> dict[str, Float[np.ndarray, "draw condition"]]:
        """Each outcome in every draw and condition; NaN where there is no velocity."""
        shape = parameters["K"].shape
        surroundings = {"diameter_m": diameter}
        if self.gravity:
            surroundings[GRAVITY] = np.full(shape[-1], self.gravity)
        p = parameters | {name: np.broadcast_to(flat, shape) for name, flat in surroundings.items()}
        known = np.where(velocity > 0, velocity, 1.0)
        flat = [np.broadcast_to(v, shape).ravel() for v in (*p.values(), mass, known)]
        parts, size = [], SETTINGS.together
        for begin in range(0, flat[0].size, size):
            # The last part is filled up with what stands in it already.
            *values, M, V = (jnp.asarray(np.resize(v[begin : begin + size], size)) for v in flat)
            parts.append(outcomes_of(element(self.element), dict(zip(p, values, strict=True)), M, V))
        columns = {name: [getattr(part, name) for part in parts] for name in OUTCOMES}
        whole = {
            name: np.concatenate(column)[: flat[0].size].reshape(shape) for name, column in columns.items()
        }
        return {name: np.where(velocity > 0, values, np.nan) for name, values in whole.items()}


def simulated_step(draws: int, conditions: int) -> int:
    """One draw of so many is simulated, where each condition's draws are too many together."""
    needed = -(-draws * conditions // SETTINGS.simulated)
    return max(1, min(needed, draws // SETTINGS.of_a_condition))


def simulated_words(values: Mapping[str, Float[np.ndarray, "draw condition"]], draws: xr.Dataset) -> str:
    """How many of the draws stand behind values, where it is not all."""
    simulated, count = len(next(iter(values.values()))), draws.sizes["chain"] * draws.sizes["draw"]
    return "" if simulated == count else f"{simulated} of {count} draws were simulated"


def parameter_log(
    draws: xr.Dataset,
    recorded: Recorded,
    name: str,
    conditions: Sequence[Condition],
    *,
    new_levels: int | None = None,
) -> Float[np.ndarray, "chain draw condition"]:
    """The expected log of a parameter of the element in each condition, also of one without a formula.

    Arguments as of `bayestissue.hierarchy.levels.log_at_levels`.
    """
    if name in recorded.formulas:
        return log_at_levels(draws, recorded, name, conditions, new_levels=new_levels)
    common = draws[intercept(parameter_of(name))].to_numpy()[..., None]
    return np.repeat(common, len(conditions), axis=-1)


def numbers(
    recorded: Recorded, conditions: Sequence[Condition], name: str
) -> Float[np.ndarray, " condition"]:
    """A number of each condition, else that of the reference row, else NaN; of diameters the usual one."""
    otherwise = reference_row(recorded.rows, recorded.reference_mass_kg).get(name, np.nan)
    if name == "diameter_m" and not np.isfinite(otherwise):
        otherwise = REFERENCE_DIAMETER_M
    return np.array([float(condition.get(name, otherwise)) for condition in conditions])
