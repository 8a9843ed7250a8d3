"""A study that is running: its fit and its recordings, from which a plan of what is still to come goes on.

The truths of planned studies are then draws of the running fit's posterior, the people and conditions that
were recorded among them; their recorded impacts have the sites that they really have, and only what is still
to come is drawn. What the analysis will say is therefore a draw of what it is going to say, given all that is
known today.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pandas as pd
import xarray as xr
from jaxtyping import Float

from bayestissue.base.errors import InputError
from bayestissue.base.impact_arrays import PerImpact
from bayestissue.inference.single.phantoms import prepare_without_phantoms
from bayestissue.model.hierarchy.specification import ModelSpecification
from bayestissue.recordings.dataset import read_dataset
from bayestissue.studies.finished import Fit, read_run
from bayestissue.studies.planning.candidates import Candidate
from bayestissue.studies.planning.design_prior import DesignPrior, FittedDraws, PlannedPopulation
from bayestissue.studies.planning.information import told_of_tissue
from bayestissue.studies.planning.plan_file import After
from bayestissue.studies.planning.plan_settings import PLAN as SETTINGS


@dataclass(frozen=True, eq=False)
class Running:
    """What a running study has recorded; nothing of one that has not begun.

    Attributes:
        rows: its impacts.
        centre: of each impact's site, of log K and log C.
        precision: of the same.
    """

    rows: pd.DataFrame = field(default_factory=pd.DataFrame)
    centre: Float[np.ndarray, "impact 2"] = field(default_factory=lambda: np.zeros((0, 2)))
    precision: Float[np.ndarray, "impact 2 2"] = field(default_factory=lambda: np.zeros((0, 2, 2)))

    @property
    def started(self) -> bool:
        """Whether there is anything."""
        return not self.rows.empty

    def followed_by(self, planned: pd.DataFrame) -> pd.DataFrame:
        """Its impacts, and then planned ones."""
        return pd.concat([self.rows, planned], ignore_index=True)


@dataclass(frozen=True, eq=False)
class Background:
    """What a plan starts from.

    Attributes:
        model: of the analysis; of a running study that of its fit, the formulas as they were evaluated.
        source: what messages call that.
        prior: where truths come from.
        words: what people, conditions and impacts are called.
        running: what is recorded already.
        again: whether the people of a design are first those that were recorded.
    """

    model: ModelSpecification
    source: str
    prior: DesignPrior
    words: Mapping[str, str] = field(default_factory=dict)
    running: Running = field(default_factory=Running)
    again: bool = False

    def named(self, designs: Sequence[Candidate]) -> tuple[Candidate, ...]:
        """Designs of what is still to come, with the recorded names of people and conditions."""
        if not self.running.started:
            return tuple(designs)
        rows = self.running.rows
        people = tuple(rows["subject"].astype(str).unique()) if self.again else ()
        conditions = rows[["mass_kg", "velocity_m_s", "trial"]].drop_duplicates()
        trials = tuple(conditions.itertuples(index=False, name=None))
        return tuple(
            replace(design, people_named=people, trials_named=trials, prefix="new") for design in designs
        )


def begun_study(after: After, beliefs: PlannedPopulation, source: str) -> Background:
    """The running study of a plan: its people and conditions too are those of its fit's draws.

    Args:
        after: its fit and its dataset.
        beliefs: about what the fit has no parameter for.
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
    running = Running(prepared.design.recorded.rows, *told_of_tissue(prepared))
    draws = draws_of_fit(fit, (source, None, "after.run", after.run))
    posterior = fit.posterior["posterior"].to_dataset()
    draws = with_levels(draws, posterior, running.rows["mass_kg"].to_numpy(float))
    return Background(model, after.run, DesignPrior(beliefs, draws), dataset.words, running, after.again)


def draws_of_fit(fit: Fit, where: tuple[str, int | None, str, str]) -> FittedDraws:
    """The population of a finished fit as what is believed of the next study.

    Args:
        fit: the fit.
        where: it is named: the plan, no row, the key and the run.

    Raises:
        InputError: it has a discrepancy, beside which K is the element's own and no stiffness of tissue.
    """
    posterior = fit.posterior["posterior"].dataset
    if "K_secant" in posterior:
        raise InputError.stated("impossible-plan.discrepancy", *where)
    single = {
        str(name): array.to_numpy().reshape(-1)
        for name, array in posterior.data_vars.items()
        if array.dims == ("chain", "draw")
    }
    return FittedDraws(single, float(fit.about["model"]["reference_mass_kg"]))


def with_levels(draws: FittedDraws, posterior: xr.Dataset, mass_kg: PerImpact) -> FittedDraws:
    """Some of the draws, with those of the running study's people, conditions and masses beside them.

    Args:
        draws: of the population.
        posterior: the group of the same fit.
        mass_kg: as declared of each of its impacts.
    """
    flat = posterior.stack(sample=("chain", "draw"))  # noqa: PD013 - of xarray
    rows = np.linspace(0, flat.sizes["sample"] - 1, min(SETTINGS.draws, flat.sizes["sample"])).astype(int)
    effects = {
        str(name): array.isel(sample=rows).transpose("sample", ...)
        for name, array in flat.data_vars.items()
        if array.ndim == 2 and "sample" in array.dims and "impact" not in array.dims
    }
    population = {name: np.asarray(values)[rows] for name, values in draws.population.items()}
    errors = None
    if "mass" in flat and "sample" in flat["mass"].dims:
        masses = flat["mass"].isel(sample=rows).transpose("sample", "impact").to_numpy()
        errors = np.log(masses / mass_kg)
    return FittedDraws(population, draws.reference_mass_kg, effects, errors)
