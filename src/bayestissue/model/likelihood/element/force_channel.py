"""A force that was recorded beside the deceleration: a further channel of the same motion.

F / M = (e^a - m / M) d(t) + zero + noise with M the recorded mass, m that of the tip in front of the sensor
and a the log of what the recorded mass is to be multiplied by, the force's gain counted in (that of the
accelerometer is an error of the deceleration alone). Below the tissue there is no tip, and in d's place
stands the tissue's own force over M, which is more where tissue moves along. d is behind the force's own
low-pass, where it went through one. Errors of velocity and contact move both channels.
"""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from bayestissue.model.likelihood.channels import SensorTrace
from bayestissue.model.likelihood.element.noise import TraceNoise
from bayestissue.model.likelihood.element.record import ForceRows
from bayestissue.model.likelihood.element.recorder import Colour
from bayestissue.model.likelihood.element.response import Response


def force_channel(
    answer: Response,
    force: ForceRows,
    log_ratio: Float[Array, " impact"],
    log_sigma: Float[Array, " impact"],
) -> SensorTrace[TraceNoise]:
    """The force over mass, for contact in each cell.

    Args:
        answer: the impact at the force's samples.
        force: what was recorded.
        log_ratio: a.
        log_sigma: log of the standard deviation of the noise of F / M [m/s^2].
    """
    d, by_velocity, jerk = (part if part.ndim == 3 else part[:, None] for part in answer[:3])
    inside = force.inside()
    share = jnp.where(inside, force.share(log_ratio)[:, None], 0.0)[:, None]
    one = jnp.broadcast_to(jnp.where(inside, 1.0, 0.0)[:, None], d.shape)
    none, late = jnp.zeros_like(one), -share * jerk
    residual = jnp.where(inside[:, None], force.y[:, None] - share * d, 0.0)
    columns = jnp.stack([share * by_velocity, none, one, late, none, late], axis=2)
    colour, rate = force.colour or Colour.white_noise(), force.rate
    rate = jnp.zeros(len(inside), int) if rate is None else rate
    return SensorTrace(residual, columns, log_sigma, TraceNoise.of(inside, colour, rate), colour.stride)
