"""The law of force that was fitted: what an impact of a stated motion comes to on it."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass
from functools import partial

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float
from numpy.typing import ArrayLike

from bayestissue.base.declarations import general
from bayestissue.base.errors import Coded
from bayestissue.base.impact_arrays import MaskPerImpact
from bayestissue.base.outcome_table import HEADFORM_OUTCOMES
from bayestissue.inference.answers.integration import SETTINGS
from bayestissue.inference.execution.compiling import in_parts
from bayestissue.mechanics.elements import element
from bayestissue.mechanics.elements.element import GRAVITY, Collision
from bayestissue.mechanics.elements.outcomes import outcomes_of
from bayestissue.mechanics.elements.whole_impact import loops_of
from bayestissue.model.hierarchy import SIDE_BY_SIDE
from bayestissue.model.hierarchy.recorded import Condition, Recorded
from bayestissue.model.hierarchy.responses import RESPONSES
from bayestissue.recordings.dataset.dataset_file import STANDARD_GRAVITY

NO_LAW = Coded.stated("not-simulated.law")
DROP_HEIGHT = "drop_height_cm"
# Of an impact, beside the tissue that it meets.
MET = ("mass_kg", "velocity_m_s", "diameter_m")
# What each is and its unit, and what may stand in place of a velocity.
MOTION = {
    "mass_kg": ("mass", "kg"),
    "velocity_m_s": ("velocity", "m/s"),
    "diameter_m": ("diameter", "m"),
    DROP_HEIGHT: ("height", "cm"),
}

# Parameters of the element, and what of `MET` hits, in every draw and condition.
Values = Mapping[str, Float[np.ndarray, "*draw condition"]]


@dataclass(frozen=True)
class Law:
    """An element, gravity along the motion, and what hits.

    Attributes:
        element: its name.
        gravity: [m/s^2]; 0 where there is none.
        headform: whether what hits stands for a head.
        described: which recorded impacts follow it alone: all, or beside a discrepancy some or none.
    """

    element: str = SIDE_BY_SIDE
    gravity: float = 0.0
    headform: bool = False
    described: MaskPerImpact | bool = True

    @property
    def everywhere(self) -> bool:
        """Whether all impacts follow it, as without a discrepancy."""
        return self.described is True

    @property
    def anywhere(self) -> bool:
        """Whether some impacts follow it."""
        return bool(np.any(self.described))

    @property
    def parameters(self) -> tuple[str, ...]:
        """K, C and the further parameters of the element."""
        return (*RESPONSES, *(one.name for one in element(self.element).extra))

    @property
    def in_closed_form(self) -> bool:
        """Whether outcomes cost next to nothing: else each motion is solved."""
        return element(self.element).level_outcomes is not None and not self.gravity

    def outcomes(
        self, parameters: Values, motion: Values, names: Iterable[str] = HEADFORM_OUTCOMES
    ) -> Values:
        """Those of these outcomes that there are, in every draw and condition; NaN where nothing moves.

        Args:
            parameters: `Law.parameters`, by name.
            motion: `MET`, by name.
            names: of the outcomes.
        """
        velocity = motion["velocity_m_s"]
        moves = velocity > 0

        def comes(collision: Collision) -> dict[str, Array]:
            outcomes = outcomes_of(collision, headform=self.headform)
            return {name: outcomes[name] for name in names if name in outcomes}

        whole = self._simulated(
            comes, parameters, {**motion, "velocity_m_s": np.where(moves, velocity, 1.0)}, SETTINGS.at_once
        )
        return {name: np.where(moves, whole[name], np.nan) for name in names if name in whole}

    def loops(
        self, parameters: Values, motion: Values
    ) -> dict[str, Float[np.ndarray, "*draw condition place"]]:
        """Force over depth, as `elements.whole_impact.loops_of` has it; else as `outcomes`."""
        loops = partial(loops_of, places=SETTINGS.places)
        return self._simulated(loops, parameters, motion, SETTINGS.loops_together)

    def _simulated(
        self, simulate: Callable[[Collision], dict[str, Array]], parameters: Values, motion: Values, size: int
    ) -> dict[str, Float[np.ndarray, "*draw condition *place"]]:
        """What complete parameters, M and V come to in every draw and condition, ``size`` of them at once."""
        surroundings = {"diameter_m": motion["diameter_m"]}
        if self.gravity:
            surroundings[GRAVITY] = np.array(self.gravity)
        p, shape = {**parameters, **surroundings}, parameters["K"].shape
        arguments = (*p.values(), motion["mass_kg"], motion["velocity_m_s"])

        def of_part(*columns: np.ndarray) -> dict[str, Array]:
            # The last part is filled up with what stands in it already.
            *values, M, V = (jnp.asarray(np.resize(column, size)) for column in columns)
            results = simulate(Collision(element(self.element), dict(zip(p, values, strict=True)), M, V))
            return {name: result[: len(columns[0])] for name, result in results.items()}

        rows = tuple(np.broadcast_to(values, shape) for values in arguments)
        return in_parts(of_part, rows, size, len(shape))


def moving(condition: Condition, gravity: float) -> Condition:
    """The condition, along gravity with the velocity of a fall by the height h, V = (2 g h)^1/2 [m/s].

    g is standard gravity, as of recorded drops; on a slope, too, h is how much lower the impact is.
    """
    if DROP_HEIGHT not in condition or not gravity > 0:
        return condition
    fallen_m = float(condition[DROP_HEIGHT]) / 100
    return dict(condition) | {"velocity_m_s": float(np.sqrt(2 * STANDARD_GRAVITY * fallen_m))}


def fall_height(velocity: float | np.ndarray) -> Float[np.ndarray, ...]:
    """The height of the fall that ends at a velocity [m/s], V² / (2 g) in cm: see `moving`."""
    return 100 * np.square(velocity) / (2 * STANDARD_GRAVITY)


def unfit_height(recorded: Recorded, columns: Collection[str], gravity: float) -> str:
    """What is expected in place of a height of fall among what a condition gives; empty where it may stand.

    Without gravity along the motion it gives no velocity, and is at most a covariate.
    """
    covariate, velocity = DROP_HEIGHT in recorded.needed, "velocity_m_s" in columns
    if DROP_HEIGHT not in columns or (covariate and velocity and not gravity > 0):
        return ""
    if gravity > 0:
        return f"{DROP_HEIGHT} or velocity_m_s, not both" if velocity else ""
    relation = "beside it" if covariate else "in its place"
    return f"velocity_m_s {relation}, since this dataset states no gravity along the motion"


def beyond(words: str, value: float, measured: ArrayLike) -> list[Coded]:
    """The note of a number beyond those that were measured, with by how much; empty where it is none.

    As tables and this note print them: who asks for a velocity of 1.534 m/s means the 1.53414 measured.
    """
    known = np.asarray(measured, float)
    low, stated, high = (float(f"{x:.4g}") for x in (known.min(), value, known.max()))
    over = max(low - stated, stated - high)
    if not over > 0:
        return []
    numbers = {"low": general(low), "high": general(high), "over": general(over, 2)}
    return [Coded.stated("beyond-measured.number", what=words, **numbers)]
