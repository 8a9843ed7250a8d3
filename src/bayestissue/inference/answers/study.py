"""A finished fit at any conditions: the one evaluator of K, C, further parameters and outcomes.

With the law of force that was fitted, parameters p and a motion (M, V) come to an outcome y(p, M, V).
At given levels log p is the expected one (see `bayestissue.model.hierarchy.levels`); a new impact has the
scatter from impact to impact besides, N(0, S), S with the spreads sd_impact_K, sd_impact_C and their
correlation, and levels that are not given are new ones of their populations. All else that is said of levels
is a selection: contrasts are differences of the log, people and levels are conditions, curves grids of them,
predictions are of new impacts, and a question is a tree of them.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Float

from bayestissue.base.errors import Coded
from bayestissue.base.impact_arrays import MaskPerImpact, PerDraw, PerImpact
from bayestissue.base.outcome_table import HEADFORM_OUTCOMES, REFERENCE_OUTCOMES
from bayestissue.inference.answers.integration import SETTINGS
from bayestissue.inference.answers.law import MET, Law, beyond, moving
from bayestissue.inference.checking.model_form import of_impacts
from bayestissue.inference.results.meanings import element_alone
from bayestissue.mechanics.elements import REFERENCE_DIAMETER_M
from bayestissue.mechanics.elements.element import GRAVITY
from bayestissue.mechanics.elements.head_injury import HEADFORM
from bayestissue.model.hierarchy import SIDE_BY_SIDE
from bayestissue.model.hierarchy.formulas.formula import reference_row
from bayestissue.model.hierarchy.levels import design_at
from bayestissue.model.hierarchy.recorded import Condition, Recorded, label_of
from bayestissue.model.hierarchy.responses import parameter_of, sd_impact

GROUPS = ("posterior", "prior", "constant_data")
# Share of a trace's peak below which a discrepancy leaves an element's outcomes as they are.
SLIGHT = 0.01
DRAWN = ("chain", "draw")
# The seed of levels that nobody has met: the same wherever they stand.
_NEW_LEVELS = 1


@dataclass(frozen=True, eq=False)
class Study:
    """Draws of a fit, what was measured, and what impacts follow.

    Attributes:
        draws: of the posterior, or of the prior, [chain, draw, ...]; empty before there are any.
        recorded: what was measured.
        law: what impacts follow.
        prior: draws of the same quantities from the priors alone; None where there are none.
        velocity_m_s: that every impact has in place of its condition's, [chain, draw].
    """

    draws: xr.Dataset
    recorded: Recorded
    law: Law = field(default_factory=Law)
    prior: xr.Dataset | None = None
    velocity_m_s: PerDraw | None = None

    @classmethod
    def from_tree(cls, tree: xr.DataTree, model: Mapping[str, Any]) -> Study:
        """Of the groups `GROUPS` of ``posterior.nc`` and the model as ``run.json`` has it resolved.

        Beside a discrepancy impacts follow the element's law where it is `SLIGHT`.
        """
        posterior = tree["posterior"].to_dataset()
        constants = tree["constant_data"].to_dataset()
        recorded = Recorded.of_run(constants, model)
        law = Law(
            str(model.get("element", SIDE_BY_SIDE)),
            float(constants[GRAVITY]) if GRAVITY in constants else 0.0,
            HEADFORM in constants,
            # A reader may have left out what impacts have.
            described_impacts(posterior) if "discrepancy_mean" in posterior else True,
        )
        prior = tree["prior"].to_dataset() if "prior" in tree.children else None
        return cls(posterior, recorded, law, prior)

    @property
    def element_alone(self) -> bool:
        """Whether K is not the tissue's but the element's."""
        return element_alone(self.draws)

    @property
    def count(self) -> int:
        """How many draws all chains have."""
        return int(self.draws.sizes["chain"] * self.draws.sizes["draw"])

    def at(
        self,
        names: Iterable[str],
        conditions: Sequence[Condition],
        *,
        new: np.random.Generator | None = None,
        step: int = 1,
    ) -> xr.Dataset:
        """Responses and outcomes at given levels, [chain, draw, condition].

        Args:
            names: of responses, further parameters of the element, and outcomes.
            conditions: what is given in each, by column; see `bayestissue.model.hierarchy.levels`. A height
                of fall along gravity is a velocity.
            new: of the scatter of single impacts: then of a new impact each, levels that are not given being
                new.
            step: one draw of so many of each chain.
        """
        names = list(names)
        outcomes = [name for name in names if name in HEADFORM_OUTCOMES]
        responses = [name for name in names if name not in outcomes]
        of_law = self.law.parameters if outcomes else ()
        moved = [moving(condition, self.law.gravity) for condition in conditions]
        logs = {
            name: design_at(self.recorded, name, moved).log(self.draws, None if new is None else _NEW_LEVELS)
            for name in (*of_law, *responses)
        }
        if new is not None:
            noise = new.standard_normal((len(logs), *logs["K"].shape))
            if "residual_correlation" in self.draws:
                r = self.draws["residual_correlation"].to_numpy()[..., None]
                noise[1] = r * noise[0] + np.sqrt(1 - r**2) * noise[1]
            for name, standard in zip(logs, noise, strict=True):
                logs[name] += self.draws[sd_impact(parameter_of(name))].to_numpy()[..., None] * standard
        values = {name: ((*DRAWN, "condition"), np.exp(log)) for name, log in logs.items()}
        parameters = xr.Dataset(values, {name: self.draws[name].to_numpy() for name in DRAWN})
        parameters = parameters.isel(draw=slice(None, None, step))
        if not outcomes:
            return parameters
        return self.outcomes(parameters, conditions, outcomes).assign(parameters[responses])

    def outcomes(
        self,
        parameters: xr.Dataset,
        conditions: Sequence[Condition],
        names: Iterable[str] = HEADFORM_OUTCOMES,
    ) -> xr.Dataset:
        """What impacts of such parameters come to, [chain, draw, condition]; NaN where no law holds."""
        of_law = {name: parameters[name].to_numpy() for name in self.law.parameters}
        values = self.law.outcomes(of_law, self.motion(conditions), names)
        held = np.array([self.holds(condition) for condition in conditions])
        known = {name: ((*DRAWN, "condition"), np.where(held, y, np.nan)) for name, y in values.items()}
        return xr.Dataset(known, parameters.coords)

    def of_reference_impact(self, conditions: Sequence[Condition]) -> xr.Dataset:
        """`REFERENCE_OUTCOMES` at given levels, of the reference mass and velocity.

        None without a velocity, or where not all impacts follow the law. Where it has no closed form, draws
        are evenly left out: see `simulated_words`.
        """
        velocity = self.motion(conditions)["velocity_m_s"]
        if not (self.law.everywhere and len(conditions) and (velocity > 0).all()):
            return xr.Dataset()
        step = 1 if self.law.in_closed_form else simulated_step(self.count, len(conditions))
        return self.at(REFERENCE_OUTCOMES, conditions, step=step)

    def loops(self, conditions: Sequence[Condition], step: int) -> xr.Dataset:
        """Force over depth at given levels and motions, [chain, draw, condition, place]: see `Law.loops`."""
        parameters = self.at(self.law.parameters, conditions, step=step)
        of_law = {str(name): values.to_numpy() for name, values in parameters.items()}
        loops = self.law.loops(of_law, self.motion(conditions))
        return xr.Dataset({name: ((*DRAWN, "condition", "place"), way) for name, way in loops.items()})

    def motion(self, conditions: Sequence[Condition]) -> dict[str, Float[np.ndarray, "*draw condition"]]:
        """`MET` in each condition: what is given, else that of the reference row, else NaN."""
        reference = reference_row(self.recorded.rows, self.recorded.reference_mass_kg)
        if not np.isfinite(reference.get("diameter_m", np.nan)):
            reference |= {"diameter_m": REFERENCE_DIAMETER_M}
        moving_at = [reference | dict(moving(condition, self.law.gravity)) for condition in conditions]
        motion = {name: np.array([float(at.get(name, np.nan)) for at in moving_at]) for name in MET}
        if self.velocity_m_s is not None:
            motion["velocity_m_s"] = np.repeat(self.velocity_m_s[..., None], len(conditions), axis=-1)
        return motion

    def simulated_words(self, values: xr.Dataset) -> str:
        """How many of the draws stand behind values, where it is not all."""
        simulated = values.sizes["chain"] * values.sizes["draw"]
        return "" if simulated == self.count else f"{simulated} of {self.count} draws were simulated"

    def holds(self, condition: Condition) -> bool:
        """Whether impacts at the condition's levels follow the law, as all do that were recorded there."""
        if self.law.everywhere:
            return True
        rows = self._recorded_at(condition)
        return bool(rows.any() and np.broadcast_to(self.law.described, rows.shape)[rows].all())

    def held(self, condition: Condition) -> str:
        """Levels of the condition's columns at which the law holds, as words."""
        recorded = self.recorded
        columns = [column for column in condition if column in recorded.named] or recorded.needed
        at = {
            name: [label for label in recorded.levels(name) if self.holds({name: label})]
            for name in columns
            if name in recorded.named
        }
        return "; ".join(f"{name} {', '.join(labels)}" for name, labels in at.items() if labels)

    def deeper(self, condition: Condition, depth: float) -> list[Coded]:
        """The note of a depth [m] beyond those of recorded impacts; empty where it is none.

        Of those recorded at the condition's levels: how soft another pad is says nothing of the law of this
        one.
        """
        if self._reached is None:
            return []
        rows = self._recorded_at(condition)
        measured = float(self._reached[rows if rows.any() else slice(None)].max())
        if not depth > (1 + SETTINGS.deeper) * measured:
            return []
        return beyond("peak depth in mm", 1e3 * depth, [0.0, 1e3 * measured])

    def deeper_at(self, conditions: Sequence[Condition]) -> list[Coded]:
        """The first note of `deeper` of impacts at these levels, at the medians of their parameters."""
        if self._reached is None:
            return []
        typical = self.at(self.law.parameters, conditions).median(DRAWN).expand_dims(DRAWN)
        depths = self.outcomes(typical, conditions, ["peak_depth"])["peak_depth"][0, 0].to_numpy()
        of_each = (self.deeper(*pair) for pair in zip(conditions, depths, strict=True))
        return next(filter(None, of_each), [])

    @cached_property
    def _reached(self) -> PerImpact | None:
        """The median depth of each recorded impact [m]; None of a run without any."""
        return of_impacts(self.draws["peak_depth"]).to_numpy() if "peak_depth" in self.draws else None

    def _recorded_at(self, condition: Condition) -> MaskPerImpact:
        """The impacts that were recorded at a condition's levels, of those alone that were recorded."""
        named = {name: value for name, value in condition.items() if name in self.recorded.named}
        known = {k: v for k, v in named.items() if label_of(v) in self.recorded.levels(k)}
        return self.recorded.matching(known)


def simulated_step(draws: int, conditions: int) -> int:
    """One draw of so many is simulated, where each condition's draws are too many together."""
    needed = -(-draws * conditions // SETTINGS.simulated)
    return max(1, min(needed, draws // SETTINGS.of_a_condition))


def described_impacts(posterior: xr.Dataset) -> MaskPerImpact | bool:
    """Beside a discrepancy the impacts in which it is `SLIGHT`; none of draws without single impacts."""
    return of_impacts(posterior["discrepancy"]).to_numpy() < SLIGHT if "discrepancy" in posterior else False
