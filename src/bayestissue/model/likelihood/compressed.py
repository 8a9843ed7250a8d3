"""Traces on a spring and damper side by side, at a few nodes in place of all samples.

With p = C / M and q = K / M an impact at unit velocity moves by x'' + p x' + q x = 0. With the time s in half
windows from the window's middle, and p and q in the same unit, it is the series sum_k c_k s^k with

    (k + 1) (k + 2) c_(k+2) = -p (k + 1) c_(k+1) - q c_k,

which has no seam at critical damping. In the norm (q x^2 + x'^2)^1/2 the matrix of this motion has the norm
r = (p + (p^2 + 4 q)^1/2) / 2, so that n terms leave out at most r^n / n! / (1 - r / (n + 1)) of the motion at
the middle: up to r = `RADIUS`, less than 2^-53 with `TERMS` of them, which no double tells from none. So it
is known of K and C alone where the series is the motion.

For polynomials f and g of fewer than n terms Gauss's rule for the measure of N samples has the sum over these
exactly, sum_j f_j g_j = sum_i w_i f(s_i) g(s_i), i = 1 ... n (Golub and Welsch 1969, doi:10.2307/2004418). So
with d^ the polynomial that is nearest to a trace d

    sum_j (d_j - f_j)^2 = sum_i w_i (d^(s_i) - f(s_i))^2 + sum_j (d_j - d^_j)^2,

and likewise for products with any other f. What w_i^1/2 d^(s_i) are and the last sum is made once; it is all
that a trace says through white noise. Modes of a discrepancy are polynomials of 24 terms.
"""

from __future__ import annotations

from functools import partial
from math import gcd
from typing import NamedTuple, Self

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Bool, Float

from bayestissue.base.impact_arrays import JaxPerImpact
from bayestissue.mechanics.elements import Element
from bayestissue.mechanics.entire import horner
from bayestissue.model.likelihood.arma21 import sums_over_frequencies
from bayestissue.model.likelihood.displacements import DisplacementRecord
from bayestissue.model.likelihood.impact import MeasuredImpact
from bayestissue.model.likelihood.linear_errors import (
    Products,
    from_lower_entries,
    marginal_log_likelihood,
)
from bayestissue.model.likelihood.record import DecelerationRecord

TERMS, RADIUS = 28, 3.0
_PAIRS = TERMS // 2
# Of more than twice so many impacts one block of at most so many is summed after the other, in fast memory.
LANES = 128


class CompressedTraces(NamedTuple):
    """What stands for the samples of each trace, blocks of impacts along the first axis.

    Attributes:
        later: the nodes after the window's middle, in half windows from there; the others are as far before.
        root_weight: w^1/2 of all nodes in order of time, w being how many samples a node stands for; 0 of one
            that is not needed.
        values: w^1/2 d^ of each trace, and then w^1/2 times the modes of its discrepancy [m/s^2].
        half: half of the window, from the first sample to the last [s].
        n_samples: how many there are.
        left: sum of squares of what the polynomial leaves of the trace [m^2/s^4].
    """

    later: Float[Array, "block pair lane"]
    root_weight: Float[Array, "block node lane"]
    values: Float[Array, "block part node lane"]
    half: JaxPerImpact
    n_samples: JaxPerImpact
    left: JaxPerImpact

    @classmethod
    def of(cls, element: Element, record: DecelerationRecord | DisplacementRecord) -> Self | None:
        """Of traces with even times, white noise and known contact; None of others.

        None too where there are fewer than twice as many samples as nodes, and little to gain.
        """
        if not isinstance(record, DecelerationRecord) or record.contact.reach or not record.colour.is_white:
            return None
        special = (record.low_pass, record.uneven, record.clipped, record.force, element.added_mass)
        if element.states or not element.linear or any(part is not None for part in special):
            return None
        if record.d.shape[1] < 2 * TERMS:
            return None
        lengths, dt = np.asarray(record.n_samples), np.asarray(record.dt)
        rows = np.concatenate([np.asarray(record.d)[:, None], np.asarray(record.discrepancy.basis)], axis=1)
        later, root_weight = np.zeros((len(lengths), _PAIRS)), np.zeros((len(lengths), TERMS))
        values, left = np.zeros((*rows.shape[:2], TERMS)), np.zeros(len(lengths))
        for count in np.unique(lengths):
            of_count, number = lengths == count, min(count, TERMS)
            nodes, frame = _gauss(np.linspace(-1.0, 1.0, count), number)
            pairs, odd = divmod(number, 2)
            columns = np.r_[_PAIRS - odd - pairs : _PAIRS - odd, _PAIRS : _PAIRS + pairs + odd]
            inside = rows[of_count, :, :count]
            at_nodes = inside @ frame.T
            later[of_count, : pairs + odd] = nodes[pairs:]
            root_weight[np.ix_(of_count, columns)] = frame.sum(1)
            values[np.ix_(of_count, range(len(rows[0])), columns)] = at_nodes
            left[of_count] = ((inside - at_nodes @ frame)[:, 0] ** 2).sum(-1)
        lanes = len(dt) if len(dt) <= 2 * LANES else gcd(len(dt), LANES)
        blocks = (
            np.moveaxis(part.reshape(-1, lanes, *part.shape[1:]), 1, -1)
            for part in (later, root_weight, values)
        )
        parts = (*blocks, dt * (lengths - 1) / 2, lengths, left)
        return cls(*(jnp.asarray(part, float) for part in parts))


def _gauss(
    samples: Float[np.ndarray, " sample"], number: int
) -> tuple[Float[np.ndarray, " node"], Float[np.ndarray, "node sample"]]:
    """Gauss's nodes for samples, and the matrix that makes w^1/2 d^ there of a trace d.

    The nodes are the eigenvalues of the multiplication by s among polynomials, in any orthonormal basis.
    """
    frame = np.linalg.qr(np.polynomial.chebyshev.chebvander(samples, number - 1))[0].T
    nodes, turn = np.linalg.eigh(frame * samples @ frame.T)
    at_nodes = turn.T @ frame
    # Eigenvectors have any sign, and ones are ones at the nodes too.
    return nodes, at_nodes * np.sign(at_nodes.sum(1, keepdims=True))


def within(traces: CompressedTraces, impacts: MeasuredImpact) -> Bool[Array, " impact"]:
    """Where the series is the motion to rounding, from contact to the middle and from there to both ends."""
    p, q = _coefficients(impacts)
    rate = (p + jnp.sqrt(p**2 + 4 * q)) / 2
    longest = jnp.maximum(traces.half, jnp.abs(impacts.record.first_time + traces.half))
    return rate * longest <= RADIUS


def log_density(traces: CompressedTraces, impacts: MeasuredImpact) -> JaxPerImpact:
    """Log density of the recorded traces, errors and discrepancies integrated out, right `within` the bound.

    Args:
        traces: the compressed ones.
        impacts: of the record that they were made of, or of one with another moment of contact.
    """
    record, lanes = impacts.record, traces.later.shape[-1]
    log_sigma, log_gain = impacts.noise_parameters.log_sigma, impacts.noise_parameters.log_gain
    gain = jnp.ones_like(log_sigma) if log_gain is None else jnp.exp(log_gain)
    of_motion = (*_coefficients(impacts), traces.half, record.first_time, record.velocity, record.gravity)
    of_impacts = (*of_motion, gain)
    blocks = (*traces[:3], *(values.reshape(-1, lanes) for values in of_impacts))
    entries = jax.lax.map(partial(_sums, gain=not record.side_by_side), blocks)
    of_residual, *others = (entry.ravel() for entry in entries)
    gram = from_lower_entries([of_residual + traces.left, *others])
    products = Products.of_unit_noise(gram, jnp.zeros_like(log_sigma), traces.n_samples, log_sigma)
    return marginal_log_likelihood(products, impacts.errors) + record.log_seen_in_interval()


def _sums(block: tuple[Array, ...], *, gain: bool) -> tuple[Float[Array, " lane"], ...]:
    """Of a block of impacts, products of residual and errors' columns: the lower triangle, row by row.

    The columns are those of a discrepancy's modes, and as `DecelerationRecord.error_sd` has them, with one of
    the ``gain`` by itself or without.
    """
    later, root_weight, values, p, q, half, first_time, velocity, gravity, scale = block
    shown = scale * root_weight
    x, v = (shown * part for part in _unit_motion(later, p, q, half, first_time))
    # Without the barrier they are made anew in every product.
    x, v = jax.lax.optimization_barrier((x, v))
    unit = p * v + q * x
    d = velocity * unit + gravity * (shown - v)
    jerk = velocity * (q * v - p * unit) + gravity * unit
    trace, *modes = values
    parts = [trace - d, *modes, unit, *[d] * gain, root_weight, -jerk]
    pairs = (parts[a] * parts[b] for a in range(len(parts)) for b in range(a + 1))
    return sums_over_frequencies(tuple(pair[..., None] for pair in pairs))


def _coefficients(impacts: MeasuredImpact) -> tuple[JaxPerImpact, JaxPerImpact]:
    """Damping p [1/s] and stiffness q [1/s^2] over mass."""
    K, C = impacts.parameters
    return C / impacts.record.mass, K / impacts.record.mass


def _unit_motion(
    later: Array, p: Array, q: Array, half: Array, first_time: Array
) -> tuple[Float[Array, "node lane"], Float[Array, "node lane"]]:
    """Penetration [s] and velocity at the nodes of an impact at unit velocity."""
    middle = first_time + half
    of_middle = _series(jnp.zeros_like(p), jnp.ones_like(p), p, q, middle)
    # Without the barriers what is an impact's is made anew at every node.
    x, v = jax.lax.optimization_barrier([sum(series) for series in of_middle])
    of_window = jax.lax.optimization_barrier(_series(x, v, p, q, half))
    x, v = (_at_nodes(series, later) for series in of_window)
    return x, v


def _series(x: Array, v: Array, p: Array, q: Array, unit: Array) -> tuple[list[Array], list[Array]]:
    """Of penetration and velocity after x and v, in powers of time over ``unit``."""
    p, q, c = p * unit, q * unit**2, [x, v * unit]
    for k in range(TERMS - 2):
        c.append(-(p * (k + 1) * c[-1] + q * c[-2]) / ((k + 1) * (k + 2)))
    return c, [k * coefficient / unit for k, coefficient in enumerate(c)][1:]


def _at_nodes(series: list[Array], later: Float[Array, "pair lane"]) -> Float[Array, "node lane"]:
    """The sum of a series at these nodes and as far before: even terms and odd ones apart, each once."""
    square = later**2
    even, odd = (horner(series[start::2], square) for start in (0, 1))
    even, odd = jax.lax.optimization_barrier((even, odd * later))
    return jnp.concatenate([(even - odd)[::-1], even + odd])
