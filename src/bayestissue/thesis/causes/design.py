"""The design that every simulated campaign follows, what was observed in it, and what of that is compared.

What is compared is a dozen numbers of a table of estimates, the same for one observed and many simulated.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float, Int

from bayestissue.declarations import declared

if TYPE_CHECKING:
    from bayestissue.dataset.published import PublishedTables
    from bayestissue.inference.points.fit import Method


@dataclass(frozen=True)
class Recorder:
    """How a dataset's impacts were recorded, and how its estimates are made.

    Attributes:
        dt: [impact], sampling interval, s.
        quiet: samples before contact.
        samples: samples from contact on.
        method: of the point estimates.
    """

    dt: Float[np.ndarray, " impact"]
    quiet: int
    samples: int
    method: Method


@dataclass(frozen=True)
class Design:
    """One campaign's impacts, ordered by condition.

    Attributes:
        mass: [impact], as recorded, kg.
        velocity: [impact], as recorded, m/s.
        subject: [impact], number of the person, from 0.
        trial: [impact], number of the condition, from 0.
        in_rows: [impact], whether this impact's own estimate is known, and not only its condition's average.
        recorder: of a dataset; None for published estimates, whose recorder isn't known.
    """

    mass: Float[np.ndarray, " impact"]
    velocity: Float[np.ndarray, " impact"]
    subject: Int[np.ndarray, " impact"]
    trial: Int[np.ndarray, " impact"]
    in_rows: Bool[np.ndarray, " impact"]
    recorder: Recorder | None = None

    @property
    def trials(self) -> int:
        """The number of conditions."""
        return int(self.trial.max()) + 1

    @property
    def subjects(self) -> int:
        """The number of people."""
        return int(self.subject.max()) + 1

    def trial_means(self, values: Float[np.ndarray, "*batch impact"]) -> Float[np.ndarray, "*batch trial"]:
        """The mean of ``values`` over each condition, leaving out NaN."""
        member = (self.trial[:, None] == np.arange(self.trials)).astype(float)
        known = np.isfinite(values)
        with np.errstate(invalid="ignore", divide="ignore"):
            return (np.where(known, values, 0) @ member) / (known @ member)

    @property
    def reference_mass(self) -> float:
        """Geometric mean of the conditions' masses, kg."""
        return float(np.exp(self.trial_means(np.log(self.mass)).mean()))

    @property
    def reference_velocity(self) -> float:
        """Geometric mean of the conditions' velocities, m/s."""
        return float(np.exp(self.trial_means(np.log(self.velocity)).mean()))


class Observed(NamedTuple):
    """The estimates that are to be explained: conditions' means of K and C, and single impacts' K and C.

    Attributes:
        trial_K, trial_C: [trial].
        K, C: [row], one per impact of the design that is ``in_rows``.
    """

    trial_K: Float[np.ndarray, " trial"]
    trial_C: Float[np.ndarray, " trial"]
    K: Float[np.ndarray, " row"]
    C: Float[np.ndarray, " row"]


def published_design(tables: PublishedTables) -> tuple[Design, Observed]:
    """The thesis's nine conditions and ten people; of the impacts, those whose rows survive.

    The averages of all nine conditions were printed (Tables 5.10 and 5.11); the rows of two are lost.
    """
    averages = tables.averages.set_index(["trial", "quantity"])["average"].unstack().sort_index()  # noqa: PD010
    conditions = tables.averages.drop_duplicates("trial").set_index("trial").loc[averages.index]
    rows = tables.estimates.set_index(["trial", "subject"])
    people = sorted(tables.estimates["subject"].unique())
    index = pd.MultiIndex.from_product([averages.index, people], names=["trial", "subject"])
    in_rows = index.isin(rows.index)
    trial = np.repeat(np.arange(len(averages)), len(people))
    printed = rows.reindex(index[in_rows])
    design = Design(
        mass=conditions["mass_kg"].to_numpy(float)[trial],
        velocity=conditions["velocity_m_s"].to_numpy(float)[trial],
        subject=np.tile(np.arange(len(people)), len(averages)),
        trial=trial,
        in_rows=np.asarray(in_rows),
    )
    return design, Observed(
        *(table[name].to_numpy(float) for table in (averages, printed) for name in ("K", "C"))
    )


_STATISTICS = declared(__package__, "statistics.toml")
WORDS: Mapping[str, str] = {name: entry["title"] for name, entry in _STATISTICS.items()}
MEANING: Mapping[str, str] = {name: entry["meaning"] for name, entry in _STATISTICS.items()}
# Told, but no part of the joint comparison: the size of K/M where its unit isn't known.
APART = ("without_estimate",)
LEVEL = "K_over_M_mean"
SIZES = tuple(name for name, entry in _STATISTICS.items() if entry.get("size"))
_TUKEY = 4.685
_STEPS = 15

type Batch = Float[np.ndarray, "campaign impact"]


def campaign_statistics(K: Batch, C: Batch, design: Design) -> dict[str, Float[np.ndarray, " campaign"]]:
    """The statistics of many campaigns; NaN in ``K`` and ``C`` marks impacts without an estimate.

    Such an impact takes its condition's mean, so that one failure costs one impact and not the campaign.
    """
    means = [design.trial_means(values) for values in (K, C)]
    filled = [np.where(np.isfinite(v), v, m[:, design.trial]) for v, m in zip((K, C), means, strict=True)]
    rows = [values[:, design.in_rows] for values in filled]
    return {
        **_statistics(design, *means, *rows),
        "without_estimate": np.mean(~np.isfinite(K) | ~np.isfinite(C), axis=1),
    }


def observed_statistics(observed: Observed, design: Design) -> dict[str, float]:
    """The statistics of the observed estimates, by name."""
    statistics = _statistics(design, *(part[None] for part in observed))
    return {**{name: float(value[0]) for name, value in statistics.items()}, "without_estimate": 0.0}


def _statistics(
    design: Design, trial_K: np.ndarray, trial_C: np.ndarray, K: np.ndarray, C: np.ndarray
) -> dict[str, np.ndarray]:
    mass, rows = design.mass[design.in_rows], design.in_rows
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio, zeta = np.log(K / mass), C / (2 * np.sqrt(K * mass))
        statistics = {LEVEL: np.exp(np.mean(ratio, axis=1)), "zeta_median": np.median(zeta, axis=1)}
        statistics["K_over_M_scatter"] = np.std(ratio, axis=1, ddof=1)
        statistics |= _curve(ratio / 2, zeta)
        for name, means, values in (("K", trial_K, K), ("C", trial_C, C)):
            statistics |= _exponents(np.log(means), design, name)
            statistics |= _spreads(np.log(values), design.subject[rows], design.trial[rows], name)
    return {name: statistics[name] for name in WORDS if name in statistics}


def _exponents(log_means: np.ndarray, design: Design, name: str) -> dict[str, np.ndarray]:
    """Least squares over conditions: on log mass alone, and on log mass and log velocity together."""
    log_mass, log_velocity = (design.trial_means(np.log(v)) for v in (design.mass, design.velocity))
    exponents = {}
    mass_only = np.stack([np.ones_like(log_mass), log_mass], axis=1)
    mass_and_velocity = np.column_stack([mass_only, log_velocity])
    if np.linalg.matrix_rank(mass_only, tol=1e-6) == 2:
        exponents[f"mass_exponent_{name}"] = (np.linalg.pinv(mass_only) @ log_means.T)[1]
    if len(mass_and_velocity) > 3 and np.linalg.matrix_rank(mass_and_velocity, tol=1e-6) == 3:
        exponents[f"velocity_exponent_{name}"] = (np.linalg.pinv(mass_and_velocity) @ log_means.T)[2]
    return exponents


def _spreads(values: np.ndarray, subject: np.ndarray, trial: np.ndarray, name: str) -> dict[str, np.ndarray]:
    """Standard deviations between people and of the rest, by the two-way analysis of variance.

    Where people differ by less than the rest would make them, the component is below zero; its root then
    carries the minus sign.
    """
    trials = (trial[:, None] == np.unique(trial)).astype(float)
    people = (subject[:, None] == np.unique(subject)).astype(float)
    trials_and_people = np.column_stack([trials, people])
    rank_trials, rank_both = np.linalg.matrix_rank(trials), np.linalg.matrix_rank(trials_and_people)
    free = len(values[0]) - rank_both
    if rank_both == rank_trials or free < 1:
        return {}
    left_trials, left_both = (
        values - values @ (basis @ np.linalg.pinv(basis)).T for basis in (trials, trials_and_people)
    )
    residual = np.sum(left_both**2, axis=1)
    between = np.sum(left_trials**2, axis=1) - residual
    without_trials = people - trials @ (np.linalg.pinv(trials) @ people)
    # Henderson's third method: what a person's effect of variance 1 adds to the sum of squares.
    weight = np.trace(without_trials.T @ without_trials)
    variance = (between - (rank_both - rank_trials) * residual / free) / weight
    return {
        f"sd_subject_{name}": np.sign(variance) * np.sqrt(np.abs(variance)),
        f"sd_rest_{name}": np.sqrt(residual / free),
    }


def _curve(log_omega: np.ndarray, zeta: np.ndarray) -> dict[str, np.ndarray]:
    """How closely omega_n follows zeta: correlation, and what a robust parabola leaves of its scatter.

    The parabola is fitted by Tukey's biweight, so that a few impacts off a curve do not hide it. The
    residual is the median absolute one over the median absolute deviation of log omega_n.
    """
    x = zeta - np.median(zeta, axis=1, keepdims=True)
    x = x / np.maximum(np.std(x, axis=1, keepdims=True), 1e-12)
    y = log_omega - np.median(log_omega, axis=1, keepdims=True)
    total = np.maximum(np.median(np.abs(y), axis=1), 1e-12)
    powers = np.stack([np.ones_like(x), x, x**2], axis=2)
    left = y
    weight = np.ones_like(y)
    for _ in range(_STEPS):
        weighted = powers * weight[..., None]
        normal = np.swapaxes(powers, 1, 2) @ weighted + 1e-9 * np.eye(3)
        right = np.swapaxes(weighted, 1, 2) @ y[..., None]
        usable = np.isfinite(normal).all(axis=(1, 2), keepdims=True)
        coefficients = np.linalg.solve(np.where(usable, normal, np.eye(3)), np.where(usable, right, 0))
        left = y - (powers @ coefficients)[..., 0]
        scale = np.maximum(np.median(np.abs(left), axis=1, keepdims=True) / 0.6745, 1e-12)
        weight = np.maximum(1 - (left / (_TUKEY * scale)) ** 2, 0) ** 2
    centred = log_omega - np.mean(log_omega, axis=1, keepdims=True)
    zeta_deviation = zeta - np.mean(zeta, axis=1, keepdims=True)
    norm = np.sqrt(np.sum(centred**2, axis=1) * np.sum(zeta_deviation**2, axis=1))
    return {
        "omega_zeta_correlation": np.sum(centred * zeta_deviation, axis=1) / np.maximum(norm, 1e-300),
        "omega_zeta_residual": np.median(np.abs(left), axis=1) / total,
    }
