"""A study that has begun: its fit and its recordings, from which a plan of what is still to come goes on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import pandas as pd

from bayestissue.base.errors import InputError
from bayestissue.inference.single.phantoms import prepare_without_phantoms
from bayestissue.model.hierarchy.specification import ModelSpecification
from bayestissue.recordings.dataset import read_dataset
from bayestissue.studies.finished import Fit, read_run
from bayestissue.studies.planning.candidates import Candidate
from bayestissue.studies.planning.plan_file import After
from bayestissue.studies.planning.planned_population import Beliefs, Pilot
from bayestissue.studies.planning.running import Running, RunningPrior, running_study


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


def begun_study(after: After, otherwise: Beliefs, source: str) -> Begun:
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
    running = running_study(prepared, model)
    posterior = fit.posterior["posterior"].to_dataset()
    pilot = pilot_of(fit, otherwise, (source, None, "after.run", after.run))
    prior = RunningPrior.of_posterior(posterior, pilot, running.rows["mass_kg"].to_numpy(float))
    return Begun(after.run, model, running, prior, after.again, dataset.words)


def pilot_of(pilot: Fit, otherwise: Beliefs, where: tuple[str, int | None, str, str]) -> Pilot:
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
