"""The hierarchy over published estimates: rows where they survive, averages where only these do."""

from __future__ import annotations

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
import pandas as pd

from bayestissue.dataset.published import PublishedTables
from bayestissue.errors import InputError, Problem
from bayestissue.hierarchy.design import Design, build_design
from bayestissue.hierarchy.effects import RESPONSES
from bayestissue.hierarchy.specification import Formulas, ModelSpecification
from bayestissue.thesis.reanalysis.averages import average_statistics


@dataclass(frozen=True)
class PublishedObservations:
    """What was published of every subject's impact in every trial.

    ``cells`` is a table with one row per subject and trial. ``impact_cell`` [impact] points into it for the
    estimates that survive, ``log_estimates`` [impact, 2] are their (log K, log C). ``averaged_cells``
    [trial, subject] are the cells of the trials of which only summaries survive, ``averages`` [trial, 4]
    their statistics, see `AveragesOfLognormals`.
    """

    cells: pd.DataFrame
    impact_cell: np.ndarray
    log_estimates: np.ndarray
    averaged_cells: np.ndarray
    averages: np.ndarray

    @property
    def impacts(self) -> list[str]:
        """A label for each surviving estimate, such as ``t08-s01``."""
        return [
            f"t{int(trial):02d}-{subject}"
            for trial, subject in self.cells.loc[self.impact_cell, ["trial", "subject"]].itertuples(
                index=False
            )
        ]

    @property
    def averaged_trials(self) -> list[str]:
        """The trials of which only averages and standard deviations survive."""
        return [str(self.cells.loc[row[0], "trial"]) for row in self.averaged_cells]


def published_observations(published: PublishedTables) -> PublishedObservations:
    """Arrange the published tables for the model; no row is invented for a lost table.

    Raises:
        InputError: an estimate or average that is not above zero, whose logarithm does not exist.
    """
    estimates = published.estimates
    averages = published.averages
    _require_positive(published)
    conditions = averages.drop_duplicates("trial").sort_values("trial")
    subjects = np.sort(estimates["subject"].unique())
    columns = ["trial", "energy_J", "velocity_m_s", "mass_kg"]
    cells = conditions[columns].loc[conditions.index.repeat(len(subjects))].reset_index(drop=True)
    cells["subject"] = [f"s{subject:02d}" for subject in np.tile(subjects, len(conditions))]
    cells["trial"] = cells["trial"].astype(str)
    number = pd.Series(cells.index, index=pd.MultiIndex.from_frame(cells[["trial", "subject"]]))
    trials, people = estimates["trial"].astype(str), (f"s{subject:02d}" for subject in estimates["subject"])
    lost = [trial for trial in conditions["trial"].astype(str) if trial not in set(trials)]
    averaged = np.array([np.flatnonzero(cells["trial"] == trial) for trial in lost], dtype=int)
    by_trial = averages.assign(trial=averages["trial"].astype(str)).set_index(["quantity", "trial"])
    summaries = by_trial.reindex([(q, trial) for q in RESPONSES for trial in lost])
    average, sd = (jnp.asarray(summaries[name].to_numpy(float)).reshape(2, -1) for name in ("average", "sd"))
    means, roots = average_statistics(average, sd)
    return PublishedObservations(
        cells,
        number.loc[list(zip(trials, people, strict=True))].to_numpy(),
        np.log(estimates[["K", "C"]].to_numpy(float)),
        averaged.reshape(len(lost), len(subjects)),
        np.concatenate([means, roots]).T,
    )


def _require_positive(published: PublishedTables) -> None:
    problems = [
        Problem(
            f"{name}.csv",
            "a number above 0",
            "Correct the value, or take the row out.",
            row=int(position) + 2,
            column=column,
            value=float(frame[column].iloc[position]),
            code="published-table",
        )
        for name, frame, columns in (
            ("estimates", published.estimates, ("mass_kg", "K", "C")),
            ("averages", published.averages, ("mass_kg", "average", "sd")),
        )
        for column in columns
        for position in np.flatnonzero(~(frame[column].to_numpy(float) > 0))
    ]
    if problems:
        raise InputError(problems)


def published_design(
    observations: PublishedObservations,
    specification: ModelSpecification,
    *,
    formulas: Formulas | None = None,
    source: str = "model",
) -> Design:
    """The design over all cells, by the model's formulas or by others that compete with them."""
    return build_design(
        formulas or specification.formula,
        observations.cells,
        reference_mass_kg=specification.reference_mass_kg,
        source=source,
    )
