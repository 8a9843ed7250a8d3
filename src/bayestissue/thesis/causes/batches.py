"""Batches of campaigns of one cause: from their draws to their statistics, by any number of processes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pandas as pd

from bayestissue.inference.execution.chunks import Progress, silent
from bayestissue.inference.execution.workers import computed
from bayestissue.results import whole_file
from bayestissue.thesis.causes.design import Design
from bayestissue.thesis.causes.draws import Truth, draw_truth
from bayestissue.thesis.causes.pipeline import (
    Estimates,
    Treatment,
    estimated_from_recordings,
    thesis_estimates,
)
from bayestissue.thesis.causes.recording import decelerations, recorded
from bayestissue.thesis.causes.specification import Cause, CausesSpecification
from bayestissue.thesis.causes.statistics import campaign_statistics

# A recording goes on to this many times the typical time to peak.
REACH = 3.2


@dataclass(frozen=True)
class Batch:
    """What determines a batch's numbers, whoever computes it.

    Attributes:
        design: of every campaign.
        specification: of the priors.
        cause: its name.
        number: of the batch among those of its cause, from 0.
        seed: of the whole run.
    """

    design: Design
    specification: CausesSpecification
    cause: str
    number: int
    seed: int

    @property
    def name(self) -> str:
        """A name of its own among the batches of a run."""
        return f"{self.cause}-{self.number:05d}"


def batches(design: Design, specification: CausesSpecification, seed: int) -> list[Batch]:
    """All batches of a run, those of the causes in turn."""
    count = -(-specification.campaigns.each // specification.campaigns.batch)
    return [
        Batch(design, specification, cause, number, seed)
        for number in range(count)
        for cause in specification.causes
    ]


def run_batch(batch: Batch) -> pd.DataFrame:
    """The strengths and statistics of a batch's campaigns, one row each.

    The numbers depend on the batch alone: its random stream is that of seed, cause and number.
    """
    cause, size = batch.specification.causes[batch.cause], batch.specification.campaigns
    remaining = size.each - batch.number * size.batch
    stream = [batch.seed, batch.number, *batch.cause.encode()]
    random = np.random.default_rng(np.random.SeedSequence(stream))
    truth = draw_truth(cause, batch.specification, batch.design, random, size.batch)
    shape = (size.batch, len(batch.design.mass))
    samples = int(np.ceil(REACH * batch.specification.recording.samples_to_peak.high))
    K, C = (part.reshape(shape) for part in estimated(truth, cause, batch.design, samples, random))
    table = pd.DataFrame(
        {
            "cause": batch.cause,
            "batch": batch.number,
            "campaign": np.arange(size.batch),
            **{f"strength_{name}": value for name, value in truth.strength.items()},
            **campaign_statistics(K, C, batch.design),
        }
    )
    return table.iloc[: min(remaining, size.batch)]


def estimated(
    truth: Truth, cause: Cause, design: Design, samples: int, random: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """K and C of every impact, one campaign after the other, as the data's own were estimated.

    ``samples`` is the length of a recording where the design doesn't tell.
    """
    if design.recorder is not None:
        return estimated_from_recordings(truth, cause, design, design.recorder, random)
    estimates = _estimated_as_published(truth, cause, design, samples, random)
    return estimates.K, estimates.C


def _estimated_as_published(
    truth: Truth, cause: Cause, design: Design, samples: int, random: np.random.Generator
) -> Estimates:
    """Record the campaigns and estimate every impact as the thesis did, but for what the cause changes."""
    count, impacts = truth.velocity.shape

    def flat(values: np.ndarray) -> np.ndarray:
        return np.broadcast_to(values, (count, impacts)).ravel()

    mass, dt = flat(design.mass), flat(truth.dt[:, None])
    phase = random.uniform(size=count * impacts) * dt
    parameters = {name: flat(value) for name, value in truth.parameters.items()}
    d = decelerations(truth.element, parameters, mass, flat(truth.velocity), phase, dt, samples)
    offset = flat(truth.offset_sd[:, None]) * random.standard_normal(count * impacts)
    noise = flat(truth.noise[:, None])[:, None] * random.standard_normal((count * impacts, samples))
    d = recorded(d, flat(truth.gain[:, None]), offset, noise)
    length = truth.strength.get("window_over_time_to_peak", np.zeros(count))
    own_time = cause.mechanism == "own time"
    window = np.round(length * truth.samples_to_peak)
    by_eye = np.exp(
        truth.strength.get("window_sd", np.zeros(count))[:, None] * random.standard_normal((count, impacts))
    )
    about_rest = cause.mechanism in ("none", "conversion")
    choices = {
        "dt": dt,
        "velocity": flat(design.velocity),
        "mass": mass,
        "window": flat(np.array(0.0) if own_time else window[:, None]),
        "share": flat(length[:, None] * by_eye if own_time else np.array(1.0)),
        "centred": flat(np.array(0.0 if about_rest else 1.0)),
        "nominal": flat(own_time * truth.time_to_peak[:, None]),
        "by_theta1": flat(np.array(float(cause.mechanism == "conversion"))),
    }
    treatment = Treatment(**{name: jnp.asarray(values) for name, values in choices.items()})
    return thesis_estimates(d, treatment)


def run_batches(
    batches: Sequence[Batch],
    *,
    jobs: int = 1,
    scheduler: str | None = None,
    folder: Path | None = None,
    progress: Progress = silent,
) -> list[pd.DataFrame]:
    """The tables of all batches, in their order.

    Args:
        batches: what to compute.
        jobs: worker processes on this machine; 1 computes in this process.
        scheduler: address of a Dask scheduler that is to compute instead, such as ``tcp://host:8786``.
        folder: an existing folder to which finished batches are written, and where those of an earlier run of
            the same job are looked for.
        progress: told after every batch how many are done, and of how many.

    Raises:
        InputError: Dask is not installed, or the scheduler doesn't answer.
        RuntimeError: workers die again and again.
    """
    done = {batch.name: table for batch in batches if (table := _read(folder, batch)) is not None}
    left = [batch for batch in batches if batch.name not in done]
    progress(len(done), len(batches))
    for index, table in computed(run_batch, left, jobs=jobs, scheduler=scheduler):
        batch = left[index]
        done[batch.name] = table
        if folder is not None:
            with whole_file(folder / f"{batch.name}.parquet") as staging:
                table.to_parquet(staging)
        progress(len(done), len(batches))
    return [done[batch.name] for batch in batches]


def _read(folder: Path | None, batch: Batch) -> pd.DataFrame | None:
    path = None if folder is None else folder / f"{batch.name}.parquet"
    return pd.read_parquet(path) if path is not None and path.is_file() else None
