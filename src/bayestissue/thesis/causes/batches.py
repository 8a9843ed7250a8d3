"""One batch: campaigns of one cause from their draws to their statistics, the unit that is scheduled."""

from __future__ import annotations

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
import pandas as pd

from bayestissue.thesis.causes.design import Design
from bayestissue.thesis.causes.draws import Truth, draw_truth
from bayestissue.thesis.causes.pipeline import Estimates, Treatment, thesis_estimates
from bayestissue.thesis.causes.recording import decelerations, recorded
from bayestissue.thesis.causes.recordings import estimated_from_recordings
from bayestissue.thesis.causes.specification import Cause, CausesSpecification
from bayestissue.thesis.causes.statistics import of_campaigns

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
    rest = size.each - batch.number * size.batch
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
            **of_campaigns(K, C, batch.design),
        }
    )
    return table.iloc[: min(rest, size.batch)]


def estimated(
    truth: Truth, cause: Cause, design: Design, samples: int, random: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """K and C of every impact, one campaign after the other, as the data's own were estimated.

    ``samples`` is the length of a recording where the design doesn't tell.
    """
    if design.recorder is not None:
        return estimated_from_recordings(truth, cause, design, design.recorder, random)
    found = _estimated_as_published(truth, cause, design, samples, random)
    return found.K, found.C


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
    own = cause.mechanism == "own time"
    window = np.round(length * truth.samples_to_peak)
    by_eye = np.exp(
        truth.strength.get("window_sd", np.zeros(count))[:, None] * random.standard_normal((count, impacts))
    )
    about_rest = cause.mechanism in ("none", "conversion")
    choices = {
        "dt": dt,
        "velocity": flat(design.velocity),
        "mass": mass,
        "window": flat(np.array(0.0) if own else window[:, None]),
        "share": flat(length[:, None] * by_eye if own else np.array(1.0)),
        "centred": flat(np.array(0.0 if about_rest else 1.0)),
        "nominal": flat(own * truth.time_to_peak[:, None]),
        "by_theta1": flat(np.array(float(cause.mechanism == "conversion"))),
    }
    treatment = Treatment(**{name: jnp.asarray(values) for name, values in choices.items()})
    return thesis_estimates(d, treatment)
