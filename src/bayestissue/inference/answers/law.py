"""The law of force that was fitted: what an impact of a stated motion comes to on it."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
import xarray as xr
from jax import Array
from jaxtyping import Bool, Float
from numpy.typing import ArrayLike

from bayestissue.dataset.settings import STANDARD_GRAVITY
from bayestissue.declarations import general
from bayestissue.elements import REFERENCE_DIAMETER_M, element
from bayestissue.elements.element import GRAVITY
from bayestissue.elements.impact import loops_of
from bayestissue.elements.outcomes import HEADFORM_OUTCOMES, outcomes_of
from bayestissue.errors import Coded
from bayestissue.hierarchy.effects import RESPONSES, intercept, parameter_of
from bayestissue.hierarchy.formulas.formula import reference_row
from bayestissue.hierarchy.levels import log_at_levels
from bayestissue.hierarchy.recorded import Condition, Recorded, label_of
from bayestissue.inference.answers.settings import SETTINGS
from bayestissue.inference.results.meanings import REFERENCE_OUTCOMES

# Share of a trace's peak below which a discrepancy leaves an element's outcomes as they are.
SLIGHT = 0.01
NO_LAW = Coded.stated("not-simulated.law")
DROP_HEIGHT = "drop_height_cm"
# Of an impact, beside the tissue that it meets.
MET = ("mass_kg", "velocity_m_s", "diameter_m")
MOTION = (*MET, DROP_HEIGHT)


@dataclass(frozen=True)
class Law:
    """An element, gravity along the motion, and what hits.

    Attributes:
        element: its name.
        gravity: [m/s^2]; 0 where there is none.
        headform: whether what hits stands for a head.
        velocity_m_s: that every impact has instead of the one of its condition, one for all or each draw's.
        described: beside a discrepancy, which recorded impacts the element describes without it; None of all.
    """

    element: str
    gravity: float
    headform: bool = False
    velocity_m_s: Float[np.ndarray, "*draw"] | None = None
    described: Bool[np.ndarray, " impact"] | None = None

    def holds(self, recorded: Recorded, condition: Condition) -> bool:
        """Whether impacts at the condition's levels follow it, as all do that were recorded there."""
        if self.described is None:
            return True
        rows = _at_levels_of(recorded, condition)
        return bool(rows.any() and self.described[rows].all())

    def held(self, recorded: Recorded, condition: Condition) -> str:
        """Levels of the condition's columns at which it holds, as words."""
        columns = [column for column in condition if column in recorded.named] or recorded.needed
        at = {
            name: [label for label in recorded.levels(name) if self.holds(recorded, {name: label})]
            for name in columns
            if name in recorded.named
        }
        return "; ".join(f"{name} {', '.join(labels)}" for name, labels in at.items() if labels)

    def parameters(
        self, draws: xr.Dataset, recorded: Recorded, conditions: Sequence[Condition]
    ) -> dict[str, Float[np.ndarray, "chain draw condition"]]:
        """The element's parameters at given levels: of an impact without the scatter of single ones."""
        names = (*RESPONSES, *(one.name for one in element(self.element).extra))
        return {name: np.exp(parameter_log(draws, recorded, name, conditions)) for name in names}

    def velocity(
        self, recorded: Recorded, conditions: Sequence[Condition]
    ) -> Float[np.ndarray, "*draw condition"]:
        """V at contact [m/s]: the law's own, else that of the conditions, as `moving` has them."""
        if self.velocity_m_s is not None:
            return np.repeat(self.velocity_m_s[..., None], len(conditions), axis=-1)
        return numbers(recorded, conditions, "velocity_m_s")

    def motion(
        self, recorded: Recorded, conditions: Sequence[Condition]
    ) -> dict[str, Float[np.ndarray, "*draw condition"]]:
        """What hits in conditions as of `moving`: ``mass_kg`` and ``velocity_m_s``."""
        mass = numbers(recorded, conditions, "mass_kg")
        return {"mass_kg": mass, "velocity_m_s": self.velocity(recorded, conditions)}

    @property
    def in_closed_form(self) -> bool:
        """Whether outcomes cost next to nothing: else each motion is solved."""
        return element(self.element).level_outcomes is not None and not self.gravity

    def at_levels(
        self, name: str, draws: xr.Dataset, recorded: Recorded, conditions: Sequence[Condition]
    ) -> Float[np.ndarray, "chain draw condition"]:
        """One outcome at given levels and a stated motion, by draw; ``conditions`` as of `moving`."""
        values = self.all_at_levels(draws, recorded, conditions)[name]
        return values.reshape(draws.sizes["chain"], draws.sizes["draw"], len(conditions))

    def reference_outcomes(
        self, draws: xr.Dataset, recorded: Recorded, conditions: Sequence[Condition]
    ) -> dict[str, Float[np.ndarray, "draw condition"]]:
        """`REFERENCE_OUTCOMES` at given levels, of the reference mass and velocity; none without a velocity.

        Where the law has no closed form, draws are evenly left out: see `simulated_words`.
        """
        conditions = [moving(condition, self.gravity) for condition in conditions]
        if not (conditions and (self.velocity(recorded, conditions) > 0).all()):
            return {}
        count = draws.sizes["chain"] * draws.sizes["draw"]
        step = 1 if self.in_closed_form else simulated_step(count, len(conditions))
        values = self.all_at_levels(draws, recorded, conditions, step)
        return {name: values[name] for name in REFERENCE_OUTCOMES}

    def all_at_levels(
        self, draws: xr.Dataset, recorded: Recorded, conditions: Sequence[Condition], step: int = 1
    ) -> dict[str, Float[np.ndarray, "draw condition"]]:
        """Each outcome at given levels and a stated motion, in one draw of every ``step``."""
        return self.outcomes(*self._at_levels(draws, recorded, conditions, step))

    def deeper_notes(
        self, draws: xr.Dataset, recorded: Recorded, conditions: Sequence[Condition]
    ) -> list[Coded]:
        """The first note of `deeper` of impacts at these levels, at the medians of their parameters."""
        if (reached := reached_depths(draws)) is None:
            return []
        parameters = self.parameters(draws, recorded, conditions).items()
        medians = {name: np.median(values, axis=(0, 1))[None] for name, values in parameters}
        motion = [numbers(recorded, conditions, one) for one in MET]
        depths = self.outcomes(medians, *motion)["peak_depth"][0]
        of_each = (deeper(reached, recorded, *pair) for pair in zip(conditions, depths, strict=True))
        return next(filter(None, of_each), [])

    def outcomes(
        self,
        parameters: dict[str, Float[np.ndarray, "draw condition"]],
        mass: Float[np.ndarray, " condition"],
        velocity: Float[np.ndarray, "*draw condition"],
        diameter: Float[np.ndarray, " condition"],
    ) -> dict[str, Float[np.ndarray, "draw condition"]]:
        """Each outcome in every draw and condition; NaN where there is no velocity."""
        known = np.where(velocity > 0, velocity, 1.0)

        def comes(p: dict[str, Array], M: Array, V: Array) -> dict[str, Array]:
            outcomes = outcomes_of(element(self.element), p, M, V, headform=self.headform)
            values = {name: getattr(outcomes, name) for name in HEADFORM_OUTCOMES}
            return {name: one for name, one in values.items() if one is not None}

        whole = self._together(comes, parameters, mass, known, diameter, SETTINGS.at_once)
        return {name: np.where(velocity > 0, values, np.nan) for name, values in whole.items()}

    def loops(
        self, draws: xr.Dataset, recorded: Recorded, conditions: Sequence[Condition], step: int
    ) -> dict[str, Float[np.ndarray, "draw condition place"]]:
        """Force over depth at given levels and a stated motion, in one draw of every ``step``.

        By the attributes of `bayestissue.elements.impact.Loop`; ``conditions`` as of `moving`.
        """

        def loop(p: dict[str, Array], M: Array, V: Array) -> dict[str, Array]:
            return loops_of(element(self.element), p, M, V, SETTINGS.places)._asdict()

        at = self._at_levels(draws, recorded, conditions, step)
        return self._together(loop, *at, SETTINGS.loops_together)

    def _at_levels(
        self, draws: xr.Dataset, recorded: Recorded, conditions: Sequence[Condition], step: int
    ) -> tuple[dict[str, np.ndarray], np.ndarray, np.ndarray, np.ndarray]:
        """Parameters [draw, condition] in one draw of every ``step``, and mass, velocity and diameter."""
        p = self.parameters(draws, recorded, conditions)
        shape = p["K"].shape
        velocity = np.broadcast_to(self.velocity(recorded, conditions), shape)
        flat = {name: values.reshape(-1, shape[-1])[::step] for name, values in p.items()}
        mass, diameter = (numbers(recorded, conditions, name) for name in ("mass_kg", "diameter_m"))
        return flat, mass, velocity.reshape(-1, shape[-1])[::step], diameter

    def _together(
        self,
        simulated: Callable[[dict[str, Array], Array, Array], dict[str, Array]],
        parameters: dict[str, Float[np.ndarray, "draw condition"]],
        mass: Float[np.ndarray, " condition"],
        velocity: Float[np.ndarray, "*draw condition"],
        diameter: Float[np.ndarray, " condition"],
        size: int,
    ) -> dict[str, Float[np.ndarray, "draw condition *place"]]:
        """What complete parameters, M and V come to in every draw and condition, ``size`` of them at once."""
        shape = parameters["K"].shape
        surroundings = {"diameter_m": diameter}
        if self.gravity:
            surroundings[GRAVITY] = np.full(shape[-1], self.gravity)
        p = parameters | {name: np.broadcast_to(flat, shape) for name, flat in surroundings.items()}
        flat = [np.broadcast_to(v, shape).ravel() for v in (*p.values(), mass, velocity)]
        parts: list[dict[str, Array]] = []
        for begin in range(0, flat[0].size, size):
            # The last part is filled up with what stands in it already.
            *values, M, V = (jnp.asarray(np.resize(v[begin : begin + size], size)) for v in flat)
            parts.append(simulated(dict(zip(p, values, strict=True)), M, V))
        columns = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
        return {
            name: column[: flat[0].size].reshape(*shape, *column.shape[1:])
            for name, column in columns.items()
        }


def simulated_step(draws: int, conditions: int) -> int:
    """One draw of so many is simulated, where each condition's draws are too many together."""
    needed = -(-draws * conditions // SETTINGS.simulated)
    return max(1, min(needed, draws // SETTINGS.of_a_condition))


def simulated_words(values: Mapping[str, Float[np.ndarray, "draw condition"]], draws: xr.Dataset) -> str:
    """How many of the draws stand behind values, where it is not all."""
    simulated, count = len(next(iter(values.values()))), draws.sizes["chain"] * draws.sizes["draw"]
    return "" if simulated == count else f"{simulated} of {count} draws were simulated"


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


def reached_depths(draws: xr.Dataset) -> Float[np.ndarray, " impact"] | None:
    """The median depth of each recorded impact [m]; None of a run without any."""
    if "peak_depth" not in draws:
        return None
    depth = draws["peak_depth"]
    return depth.median([name for name in depth.dims if name != "impact"]).to_numpy()


def deeper(
    reached: Float[np.ndarray, " impact"] | None, recorded: Recorded, condition: Condition, depth: float
) -> list[Coded]:
    """The note of a depth [m] beyond all of `reached_depths`; empty where it is none.

    Of those recorded at the condition's levels: how soft another pad is says nothing of the law of this one.
    """
    if reached is None:
        return []
    rows = _at_levels_of(recorded, condition)
    measured = float(reached[rows if rows.any() else slice(None)].max())
    if not depth > (1 + SETTINGS.deeper) * measured:
        return []
    return beyond("peak depth in mm", 1e3 * depth, [0.0, 1e3 * measured])


def _at_levels_of(recorded: Recorded, condition: Condition) -> Bool[np.ndarray, " impact"]:
    """Which impacts were recorded at a condition's levels, those alone that were recorded at all."""
    levels = {k: v for k, v in condition.items() if k in recorded.named and label_of(v) in recorded.levels(k)}
    return recorded.matching(levels)


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
