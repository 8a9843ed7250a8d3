"""Whether the standard deviations that `dataset.toml` states can be those of these recordings."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from bayestissue.dataset.motion import motion
from bayestissue.dataset.recordings import Recordings
from bayestissue.dataset.settings import FILE
from bayestissue.errors import Problem

# With half of a quantity as its standard deviation, none of it at all lies within two of them.
_MOST = 0.5


def stated_problems(recordings: Recordings) -> Iterator[Problem]:
    """Standard deviations that leave nothing known: of the velocity at contact, and of the recorder's zero.

    Args:
        recordings: with nothing wrong so far.
    """
    stated = recordings.uncertainty
    if not recordings.name.size:
        return
    velocity = recordings.velocity[np.isfinite(recordings.velocity)]
    if velocity.size and stated.velocity_sd_m_s >= _MOST * np.median(velocity):
        yield Problem(
            FILE,
            f"less than half of the velocity at contact (median {np.median(velocity):.4g} m/s)",
            "Write it in m/s: 5 mm/s is 0.005, and 1 % of 1.5 m/s is 0.015.",
            column="uncertainty.velocity_sd_m_s",
            value=stated.velocity_sd_m_s,
            code="stated-error-too-large",
        )
    moving = motion(recordings.samples, recordings.quantity)
    reach = float(np.median(np.maximum(np.abs(moving.high), np.abs(moving.low))))
    unit = "m" if recordings.quantity == "displacement" else "m/s^2"
    if stated.offset_sd >= _MOST * reach:
        yield Problem(
            FILE,
            f"less than half of the greatest {recordings.quantity} (median {reach:.4g} {unit})",
            f"Write it in {unit}, whatever signal.unit is.",
            column="uncertainty.offset_sd",
            value=stated.offset_sd,
            code="stated-error-too-large",
        )
