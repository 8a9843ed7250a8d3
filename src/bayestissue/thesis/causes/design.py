"""Who was hit with what: the design that every simulated campaign follows, and what was observed in it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float, Int

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


@dataclass(frozen=True)
class Observed:
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
    observed = Observed(
        averages["K"].to_numpy(float),
        averages["C"].to_numpy(float),
        printed["K"].to_numpy(float),
        printed["C"].to_numpy(float),
    )
    return design, observed
