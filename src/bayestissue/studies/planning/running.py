"""A study that is running: what it has recorded, as the beginning of each design that goes on from it.

The truths of planned studies are then draws of the running fit's posterior, the people and conditions that
were recorded among them; their recorded impacts have the sites that they really have, and only what is still
to come is drawn. What the analysis will say is therefore a draw of what it is going to say, given all that is
known today.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd
import xarray as xr
from jaxtyping import Float

from bayestissue.inference.factors.expansions import expanded
from bayestissue.model.hierarchy.design import Design
from bayestissue.model.hierarchy.formulas.group_terms import common_coefficient
from bayestissue.model.hierarchy.specification import ModelSpecification
from bayestissue.model.hierarchy.trace_data import Prepared
from bayestissue.studies.planning.information import spreads_of_nuisance, without_nuisance
from bayestissue.studies.planning.plan_settings import PLAN as SETTINGS
from bayestissue.studies.planning.planned_population import Pilot, Streams, Truths
from bayestissue.studies.planning.study_model import PlannedModel


@dataclass(frozen=True, eq=False)
class Running:
    """What a running study has recorded.

    Attributes:
        rows: its impacts.
        centre: of each impact's site, of log K and log C.
        precision: of the same.
    """

    rows: pd.DataFrame
    centre: Float[np.ndarray, "impact 2"]
    precision: Float[np.ndarray, "impact 2 2"]


def running_study(prepared: Prepared, specification: ModelSpecification) -> Running:
    """What the recordings of a dataset tell, as planned designs go on from it.

    Args:
        prepared: the dataset under the running fit's model.
        specification: that model.
    """
    sites = expanded(prepared)
    spread = spreads_of_nuisance(specification, prepared.model.nuisance)
    centre, precision = without_nuisance(sites, spread)
    return Running(prepared.design.recorded.rows, centre, precision)


@dataclass(frozen=True, eq=False)
class RunningPrior:
    """Truths of a running study: draws of its posterior, of its people and conditions too.

    Attributes:
        pilot: the parameters of the population.
        effects: of the levels that were recorded, [draw, level], by name, with the levels' names.
        mass_errors: of log mass of the impacts that were recorded, [draw, impact]; None where these are so
            many that not all draws were kept.
    """

    pilot: Pilot
    effects: Mapping[str, xr.DataArray]
    mass_errors: Float[np.ndarray, "draw impact"] | None = None

    @classmethod
    def of_posterior(
        cls, posterior: xr.Dataset, pilot: Pilot, mass_kg: Float[np.ndarray, " impact"]
    ) -> RunningPrior:
        """From the group posterior of the running fit.

        Args:
            posterior: of that fit.
            pilot: the same draws of the population.
            mass_kg: as declared of each of its impacts.
        """
        flat = posterior.stack(sample=("chain", "draw"))  # noqa: PD013 - of xarray
        rows = np.linspace(0, flat.sizes["sample"] - 1, min(SETTINGS.draws, flat.sizes["sample"])).astype(int)
        effects = {
            str(name): array.isel(sample=rows).transpose("sample", ...)
            for name, array in flat.data_vars.items()
            if array.ndim == 2 and "sample" in array.dims and "impact" not in array.dims
        }
        drawn = {name: np.asarray(values)[rows] for name, values in pilot.draws.items()}
        errors = None
        if "mass" in flat and "sample" in flat["mass"].dims:
            masses = flat["mass"].isel(sample=rows).transpose("sample", "impact").to_numpy()
            errors = np.log(masses / mass_kg)
        return cls(Pilot(drawn, pilot.reference_mass_kg, pilot.otherwise), effects, errors)

    def truths(self, model: PlannedModel, design: Design, streams: Streams) -> Truths:
        """One draw of the posterior a study, its recorded levels' effects in their places."""
        truths = self.pilot.truths(model, design, streams)
        row = self.pilot.rows(streams)
        effects = {}
        for part in design.responses.values():
            for term, column in part.terms.items():
                name = term.variable(part.response)
                if name not in self.effects:
                    continue
                # Of levels that were not recorded nothing is known.
                levels = list(design.groupings[term.grouping].levels)
                values = self.effects[name].reindex({term.grouping: levels}).to_numpy()[row]
                shared = common_coefficient(term.slope, part.response) if term.slope else ""
                if shared in self.pilot.draws:
                    values = values - np.asarray(self.pilot.draws[shared])[row][:, None]
                effects[term.effect(part.response)] = values * column.scale
        errors = None if self.mass_errors is None else self.mass_errors[row]
        return Truths(truths.hyperparameters, truths.fixed, effects, errors)
