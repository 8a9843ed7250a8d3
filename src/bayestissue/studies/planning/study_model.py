"""The hierarchy of a planned study: log K and log C of each impact, measured with a known precision.

What else a trace tells, such as its noise, is integrated out of its precision beforehand
(`bayestissue.studies.planning.information`), and everything that follows is the hierarchy of a fit: u ~ N(X
b, D^-1), with a Gaussian factor of u in the place of each trace.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import jax.numpy as jnp
import numpy as np
import xarray as xr
from jax import Array
from jaxtyping import Float
from numpyro.distributions import biject_to

from bayestissue.model.hierarchy import derived
from bayestissue.model.hierarchy.design import Design
from bayestissue.model.hierarchy.gaussian.arrangement import PopulationDesign
from bayestissue.model.hierarchy.levels import design_at
from bayestissue.model.hierarchy.population import (
    EffectParts,
    heavier,
    population_design,
    stated_mass_errors,
)
from bayestissue.model.hierarchy.priors import Priors
from bayestissue.model.hierarchy.responses import RESPONSES
from bayestissue.model.hierarchy.specification import ModelSpecification
from bayestissue.model.hierarchy.trace_models import Hierarchy, hyperparameters_at


@dataclass(frozen=True)
class PlannedModel(Hierarchy):
    """What the analysis of a planned study assumes.

    Attributes:
        locations: what the elements of b are.
        priors: of the analysis.
        correlated: whether the deviations of log K and log C of one impact are.
        log_mass_sd: standard deviation of the error of the recorded log mass.
        common_mass_sd: standard deviation of the log of a factor that all masses have in common, in the place
            of errors of their own; None where they have those.
    """

    locations: EffectParts
    priors: Priors
    correlated: bool
    log_mass_sd: float = 0.0
    common_mass_sd: float | None = None

    def at(self, y: Float[Array, " coordinate"]) -> tuple[dict[str, Array], Float[Array, ""]]:
        """The hyperparameters and their log prior density at unconstrained coordinates."""
        return hyperparameters_at(self, y)

    def unconstrained(self, values: Mapping[str, Any]) -> Float[np.ndarray, "study coordinate"]:
        """Coordinates of `at`, of any number of studies."""
        coordinates = [
            biject_to(self.prior_of(name).support).inv(jnp.asarray(values[name]))
            for name in self.hyperparameters
        ]
        return np.stack([np.asarray(coordinate) for coordinate in coordinates], axis=-1)

    def at_true_masses(
        self, b: Float[np.ndarray, "study draw location"], standard: Float[np.ndarray, "study draw"]
    ) -> Float[np.ndarray, "study draw location"]:
        """Effects at the true masses, whose common factor is drawn from standard normals given b."""
        if self.common_mass_sd is None:
            return b
        return heavier(self.locations, b, self.common_mass_sd * standard)

    def draws(
        self, design: Design, values: Mapping[str, np.ndarray], b: Float[np.ndarray, "chain draw location"]
    ) -> xr.Dataset:
        """Draws by the names that questions use, those of a typical person among them.

        Args:
            design: whose formulas the model has.
            values: hyperparameters, [chain, draw].
            b: all fixed and group effects.
        """
        design = replace(design, responses={q: design.responses[q] for q in RESPONSES})
        population = dict(values) | derived.effects_by_name(self.locations, design, b)
        draws = derived.labelled_draws(design, derived.formula_quantities(design, population))
        draws = draws.assign_coords(chain=np.arange(b.shape[0]), draw=np.arange(b.shape[1]))
        typical = {q: design_at(design.recorded, q, [{}]).log(draws)[..., 0] for q in RESPONSES}
        with np.errstate(over="ignore"):
            return draws.assign(
                {f"{q}_typical_person": (("chain", "draw"), np.exp(log)) for q, log in typical.items()}
            )


def planned_model(
    specification: ModelSpecification,
    design: Design,
    relative_mass_sd: float = 0.0,
) -> tuple[PlannedModel, PopulationDesign]:
    """The analysis of a study with this design, and its X arranged.

    Args:
        specification: the model file.
        design: its formulas over the rows of the study.
        relative_mass_sd: of the recorded mass.
    """
    priors = specification.complete_priors()
    # The parameters of an element besides K and C are part of a trace's precision.
    responses = {q: design.responses[q] for q in RESPONSES}
    mass_kg = design.recorded.rows["mass_kg"].to_numpy(float)
    own, common, masses = stated_mass_errors(
        specification.mass_error, relative_mass_sd, design.subject, mass_kg
    )
    effects, columns = population_design(replace(design, responses=responses), priors, (), masses)
    correlated = specification.residual_correlation
    return PlannedModel(effects, priors, correlated, own, common_mass_sd=common), columns
