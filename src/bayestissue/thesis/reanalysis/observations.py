"""What was published: rows where they survive, averages where only these do, and what is random in those."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from jaxtyping import Array, Float

from bayestissue.model.hierarchy.design import Design, build_design
from bayestissue.model.hierarchy.responses import RESPONSES
from bayestissue.model.hierarchy.specification import Formulas, ModelSpecification
from bayestissue.model.likelihood import small
from bayestissue.recordings.dataset.published import PublishedTables

REPLICATES = 20_000
SPREADS = np.geomspace(0.005, 3.0, 40)


def average_statistics(average: Any, sd: Any) -> tuple[Any, Any]:
    """Mean of the logs and cube root of their variance that an average and standard deviation imply.

    By the moments of the lognormal: s² = log(1 + sd²/average²), m = log(average) − s²/2. Of lognormal data
    these two are almost independent and almost normal, as the average and its standard deviation
    themselves are not; the cube root is Wilson and Hilferty's (1931) normalising transform of a variance.
    """
    variance = np.log1p((sd / average) ** 2)
    return np.log(average) - variance / 2, np.cbrt(variance)


def average_and_sd(mean_of_logs: np.ndarray, cube_root: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The inverse of `average_statistics`."""
    variance = np.asarray(cube_root) ** 3
    average = np.exp(mean_of_logs + variance / 2)
    return average, average * np.sqrt(np.expm1(variance))


def moments_of_people(
    mean: Float[Array, "*batch 2"],
    scatter: Float[Array, "*batch 2"],
    scale_tril: Float[Array, "*batch 2 2"],
    n: int,
) -> tuple[Float[Array, "*batch 4"], Float[Array, "*batch 4"], Float[Array, "*batch 2"]]:
    """Moments of what n pairs (K, C) leave behind when only averages and standard deviations were published.

    The pairs are independent and bivariate lognormal, with their own log means and one covariance of the
    logs. What is left of them is (m_K, m_C, cbrt s²_K, cbrt s²_C), see `average_statistics`; the standard
    deviation has the divisor n - 1. It is taken as normal (a synthetic likelihood: Wood 2010,
    doi:10.1038/nature09319).

    With the spread of the logs about their common mean, s² = variance + ``scatter``, all moments follow from
    a table over s that is simulated once for each n. m_K and m_C are normal about ``mean`` and an offset;
    everything else depends on the spread alone. An effect that the n pairs share can so be integrated out in
    closed form.

    Args:
        mean: of the pairs' log means.
        scatter: their variance, with the divisor n - 1.
        scale_tril: Cholesky factor of the covariance of the logs.
        n: how many pairs.

    Returns:
        Mean and standard deviation, and two correlations: those of m_K with m_C, and of cbrt s²_K with cbrt
        s²_C; the other four vanish nearly.
    """
    variance = jnp.square(scale_tril).sum(-1)
    spread = jnp.sqrt(variance + scatter)
    table = jnp.asarray(_calibration(n))
    bias, sd_mean, mean_root, sd_root = jax.vmap(jnp.interp, (None, None, 0))(
        jnp.log(spread), np.log(SPREADS), table
    )
    within = jnp.sqrt(variance)
    moments = jnp.concatenate([mean + bias * spread, mean_root * spread ** (2 / 3)], axis=-1)
    sd = jnp.concatenate([sd_mean * within, sd_root * spread ** (2 / 3)], axis=-1)
    r = scale_tril[..., 1, 0] / within[..., 1]
    return moments, sd, jnp.broadcast_to(jnp.stack([r, r**2], axis=-1), (*sd.shape[:-1], 2))


def pair_covariance(
    sd: Float[Array, "2 ..."], correlation: Float[Array, "*batch"]
) -> Float[Array, "2 2 *batch"]:
    """Covariance of pairs from their two standard deviations and their correlation."""
    between = correlation * sd[0] * sd[1]
    return small.stacked([[sd[0] ** 2, between], [between, sd[1] ** 2]])


@cache
def _calibration(n: int) -> np.ndarray:
    """Moments of the two statistics of n lognormals, in units of the spread: [moment, spread].

    Rows: (mean of m − true mean)/s, sd of m/s, mean of cbrt(s²)/s^⅔, sd of cbrt(s²)/s^⅔. One set of normals
    serves every spread, so that the table is smooth.
    """
    noise = np.random.default_rng(0).standard_normal((REPLICATES, n))
    noise = np.concatenate([noise, -noise])
    columns = []
    for spread in SPREADS:
        values = np.exp(spread * noise)
        average, sd = values.mean(-1), values.std(-1, ddof=1)
        variance = np.log1p((sd / average) ** 2)
        m, root = (np.log(average) - variance / 2) / spread, np.cbrt(variance / spread**2)
        columns.append([m.mean(), m.std(), root.mean(), root.std()])
    return np.array(columns).T


@dataclass(frozen=True)
class PublishedObservations:
    """What was published of every subject's impact in every trial.

    ``cells`` is a table with one row per subject and trial. ``impact_cell`` [impact] points into it for the
    estimates that survive, ``log_estimates`` [impact, 2] are their (log K, log C). ``averaged_cells``
    [trial, subject] are the cells of the trials of which only summaries survive, ``averages`` [trial, 4]
    their statistics, see `moments_of_people`.
    """

    cells: pd.DataFrame
    impact_cell: np.ndarray
    log_estimates: np.ndarray
    averaged_cells: np.ndarray
    averages: np.ndarray

    @property
    def impacts(self) -> list[str]:
        """A label for each surviving estimate, such as ``t08-s01``."""
        cells = self.cells.loc[self.impact_cell]
        pairs = zip(cells["trial"], cells["subject"], strict=True)
        return [f"t{int(trial):02d}-{subject}" for trial, subject in pairs]

    @property
    def averaged_trials(self) -> list[str]:
        """The trials of which only averages and standard deviations survive."""
        return [str(self.cells.loc[row[0], "trial"]) for row in self.averaged_cells]


def published_observations(published: PublishedTables) -> PublishedObservations:
    """Arrange the published tables for the model; no row is invented for a lost table."""
    estimates, averages = published.estimates, published.averages
    conditions = averages.drop_duplicates("trial").sort_values("trial")
    trials, subjects = conditions["trial"].to_numpy(), np.sort(estimates["subject"].unique())
    everyone = pd.DataFrame({"subject": [f"s{subject:02d}" for subject in subjects]})
    columns = ["trial", "energy_J", "velocity_m_s", "mass_kg"]
    cells = conditions[columns].astype({"trial": str}).merge(everyone, how="cross")
    number = np.arange(len(cells)).reshape(len(trials), len(subjects))
    lost = ~np.isin(trials, estimates["trial"])
    summaries = averages.pivot_table(["average", "sd"], "trial", "quantity").loc[trials[lost]]
    average, sd = (summaries[name][list(RESPONSES)].to_numpy(float) for name in ("average", "sd"))
    return PublishedObservations(
        cells,
        number[np.searchsorted(trials, estimates["trial"]), np.searchsorted(subjects, estimates["subject"])],
        np.log(estimates[list(RESPONSES)].to_numpy(float)),
        number[lost],
        np.concatenate(average_statistics(average, sd), axis=1),
    )


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
