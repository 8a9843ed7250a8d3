"""A study that is running: its fit and its recordings, from which a plan of what is still to come goes on.

The truths of planned studies are then draws of the running fit's posterior, the people and conditions that
were recorded among them; their recorded impacts have the sites that they really have, and only what is still
to come is drawn. What the analysis will say is therefore a draw of what it is going to say, given all that is
known today.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
import xarray as xr
from jaxtyping import Float

from bayestissue.base.errors import InputError
from bayestissue.inference.single.phantoms import prepare_without_phantoms
from bayestissue.model.hierarchy.design import Design
from bayestissue.model.hierarchy.formulas.group_terms import common_coefficient
from bayestissue.model.hierarchy.specification import ModelSpecification
from bayestissue.model.hierarchy.trace_data import Prepared
from bayestissue.recordings.dataset import read_dataset
from bayestissue.studies.finished import Fit, read_run
from bayestissue.studies.planning.candidates import Candidate
from bayestissue.studies.planning.information import told_of_tissue
from bayestissue.studies.planning.plan_file import After
from bayestissue.studies.planning.plan_settings import PLAN as SETTINGS
from bayestissue.studies.planning.planned_population import Pilot, PlannedPopulation, Streams, Truths
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


def running_study(prepared: Prepared) -> Running:
    """What the recordings of a dataset tell, as planned designs go on from it.

    Args:
        prepared: the dataset under the running fit's model.
    """
    return Running(prepared.design.recorded.rows, *told_of_tissue(prepared))


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


@dataclass(frozen=True, eq=False)
class Begun:
    """A running study.

    Attributes:
        run: the folder of its fit.
        model: of that, the formulas as they were evaluated; also that of the analysis in the end.
        running: what its recordings tell.
        prior: what is believed now: draws of the fit's posterior.
        again: whether the people of a design are first those that were recorded.
        words: what the dataset calls people, conditions and impacts.
    """

    run: str
    model: ModelSpecification
    running: Running
    prior: RunningPrior
    again: bool
    words: Mapping[str, str]

    def named(self, designs: Sequence[Candidate]) -> tuple[Candidate, ...]:
        """Designs of what is still to come, with the recorded names of people and conditions."""
        rows = self.running.rows
        people = tuple(rows["subject"].astype(str).unique()) if self.again else ()
        conditions = rows[["mass_kg", "velocity_m_s", "trial"]].drop_duplicates()
        trials = tuple(conditions.itertuples(index=False, name=None))
        return tuple(
            replace(design, people_named=people, trials_named=trials, prefix="new") for design in designs
        )

    def all_rows(self, design: Candidate) -> pd.DataFrame:
        """What was recorded, and the impacts of a design."""
        return pd.concat([self.running.rows, design.rows()], ignore_index=True)


def begun_study(after: After, otherwise: PlannedPopulation, source: str) -> Begun:
    """The running study of a plan.

    Args:
        after: its fit and its dataset.
        otherwise: beliefs about what the fit has no parameter for.
        source: what messages call the plan.

    Raises:
        InputError: there is no such fit or dataset, or the fit is of other recordings.
    """
    fit, dataset = read_run(after.run), read_dataset(after.dataset)
    if dataset.input_hash != fit.about["input_hash"]:
        raise InputError.stated(
            "impossible-plan.recordings", source, None, "after.dataset", after.dataset, run=after.run
        )
    model = fit.specification
    _, prepared = prepare_without_phantoms(dataset, model, source=after.run)
    running = running_study(prepared)
    posterior = fit.posterior["posterior"].to_dataset()
    pilot = pilot_of(fit, otherwise, (source, None, "after.run", after.run))
    prior = RunningPrior.of_posterior(posterior, pilot, running.rows["mass_kg"].to_numpy(float))
    return Begun(after.run, model, running, prior, after.again, dataset.words)


def pilot_of(pilot: Fit, otherwise: PlannedPopulation, where: tuple[str, int | None, str, str]) -> Pilot:
    """A finished fit as what is believed of the next study.

    Args:
        pilot: the fit.
        otherwise: beliefs about what it has no parameter for.
        where: it is named: the plan, no row, the key and the run.

    Raises:
        InputError: it has a discrepancy, beside which K is the element's own and no stiffness of tissue.
    """
    posterior = pilot.posterior["posterior"].dataset
    if "K_secant" in posterior:
        raise InputError.stated("impossible-plan.discrepancy", *where)
    single = {
        str(name): array.to_numpy().reshape(-1)
        for name, array in posterior.data_vars.items()
        if array.dims == ("chain", "draw")
    }
    return Pilot(single, float(pilot.about["model"]["reference_mass_kg"]), otherwise)
