"""What impacts of planned studies come to: the law of force, tabulated where it has no closed form.

Posteriors of a block of studies have so many draws of K and C that a motion of each would take longer than
all else. At one mass, velocity and gravity an outcome is a function of log K and log C: it is solved on the
grids of square tiles of that plane, once in a plan, and is linear in between, or its log where it is above 0
throughout. With the step h of the grid that is off by at most h² / 8 of its second derivative. A jump, as
where an impactor is no longer thrown back, is spread over a cell, and a time that does not come at a corner
is taken as one that never comes in the cell. Tiles lie at fixed places, so that a number does not depend on
what was asked before it.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Float

from bayestissue.base.outcome_table import HEADFORM_OUTCOMES
from bayestissue.inference.answers.law import MET, Law, Values
from bayestissue.model.hierarchy.responses import RESPONSES
from bayestissue.model.hierarchy.specification import ModelSpecification
from bayestissue.recordings.dataset.dataset_file import Gravity, gravity_m_s2
from bayestissue.studies.planning.plan_settings import TABULATION as SETTINGS

if TYPE_CHECKING:
    from scipy.interpolate import RegularGridInterpolator


class PlannedLaw(Law):
    """A law of force whose parameters are K and C alone."""

    def outcomes(
        self, parameters: Values, motion: Values, names: Iterable[str] = HEADFORM_OUTCOMES
    ) -> Values:
        """Outcomes as of `Law`; of one motion in all draws by tables."""
        if self.in_closed_form or motion["velocity_m_s"].ndim > 1:
            return super().outcomes(parameters, motion, names)
        values = {name: np.empty(parameters["K"].shape) for name in names}
        for j, at in enumerate(zip(*(motion[name] for name in MET), strict=True)):
            logs = np.stack([np.log(parameters[q][..., j]).ravel() for q in RESPONSES])
            for name, of_motions in values.items():
                of_motions[..., j] = self._interpolated(name, logs, at).reshape(of_motions.shape[:-1])
        return values

    def of_motion(
        self, logs: Float[np.ndarray, "2 draw"], motion: tuple[float, ...]
    ) -> dict[str, Float[np.ndarray, " draw"]]:
        """Each outcome, solved, at log K and log C and of one mass, velocity and diameter."""
        parameters = {q: np.exp(log)[:, None] for q, log in zip(RESPONSES, logs, strict=True)}
        at = {name: np.array([number]) for name, number in zip(MET, motion, strict=True)}
        return {name: values[:, 0] for name, values in super().outcomes(parameters, at).items()}

    def _interpolated(
        self, name: str, logs: Float[np.ndarray, "2 draw"], motion: tuple[float, ...]
    ) -> Float[np.ndarray, " draw"]:
        tiles, of_draw = np.unique(np.floor(logs / SETTINGS.side).astype(int), axis=1, return_inverse=True)
        values = np.empty(logs.shape[1])
        for number, (i, j) in enumerate(tiles.T):
            within = of_draw.ravel() == number
            table = _tile(self, motion, int(i), int(j))[name]
            values[within] = table.at(logs[:, within])
        return values


class _Tabulated(NamedTuple):
    """An outcome over a tile, or its log."""

    grid: RegularGridInterpolator
    of_log: bool

    def at(self, logs: Float[np.ndarray, "2 draw"]) -> Float[np.ndarray, " draw"]:
        values = self.grid(logs.T)
        return np.where(np.isnan(values), np.inf, np.exp(values) if self.of_log else values)


@lru_cache(maxsize=SETTINGS.tiles)
def _tile(law: PlannedLaw, motion: tuple[float, ...], i: int, j: int) -> dict[str, _Tabulated]:
    """Each outcome over one tile."""
    from scipy.interpolate import RegularGridInterpolator

    axes = tuple(np.linspace(k, k + 1, SETTINGS.points) * SETTINGS.side for k in (i, j))
    solved = law.of_motion(np.stack(np.meshgrid(*axes, indexing="ij")).reshape(2, -1), motion)
    tables = {}
    for name, values in solved.items():
        positive = bool((values > 0).all())
        on_grid = (np.log(values) if positive else values).reshape(2 * [SETTINGS.points])
        tables[name] = _Tabulated(RegularGridInterpolator(axes, on_grid), positive)
    return tables


def planned_law(model: ModelSpecification, gravity: Gravity) -> Law:
    """What outcomes of a planned study follow; beside a discrepancy nothing does."""
    return PlannedLaw(model.element, gravity_m_s2(gravity), described=model.discrepancy != "always")
