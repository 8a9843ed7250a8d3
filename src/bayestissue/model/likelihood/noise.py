"""A recorder's noise, and the modes of what a trace holds beside the impact and the chain's errors.

Noise that went through the recorder's low-pass, beside a share f of white noise that entered behind it, has
the covariance sigma^2 T with T = f 1 + (1 - f) R, R being the correlations that the filter leaves
(`bayestissue.recordings.signal.filters`). Of a sample the p before it say all, to rounding, that all before
it do, p being some periods of the corner. So T^-1/2 = L^-1, T = L L', is a dense matrix for the first p
samples of a trace, and from there on the same few weights at every sample (an autoregression of order p; Box
and Jenkins, Time Series Analysis, section 7.4): the work goes with the number of samples. Where next to no
noise entered behind the filter, T has eigenvalues near 0, of what changes faster than the filter lets pass. A
likelihood would believe those frequencies above all others, and whatever the filter's description leaves out
there, and it would take the noise's size from them. So only every k-th sample is asked, as far apart as keeps
the least eigenvalue of T at `LEAST_EIGENVALUE`: some four in a period of the corner.

A discrepancy is a smooth force of unknown shape: delta(t), a Gaussian process on the force per mass (Kennedy
and O'Hagan 2001), with the covariance s^2 exp(-(t - t')^2 / (2 l^2)) over the window's own time t in [0, 1]
and l = 0.3, by its first six eigenvectors on the samples: delta = U c with c_j ~ N(0, s^2 lambda_j), six more
errors of the trace.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Bool, Float, Int
from scipy.linalg import solve_toeplitz, toeplitz

from bayestissue.base.impact_arrays import IndexPerImpact, JaxPerImpact, PerSample, bucket
from bayestissue.model.likelihood.channels import SensorTrace
from bayestissue.model.likelihood.linear_errors import Products
from bayestissue.model.likelihood.record import Discrepancy
from bayestissue.model.likelihood.recorder import Colour

LEAST_EIGENVALUE = 0.02
# f, at the least: what is divided by it keeps nine digits.
_LEAST_WHITE = 1e-3
# Weights of samples further back that are left out, together.
_LEFT_OUT = 1e-7
# Of a correlation that has died out; and the longest that is waited for, in samples.
_DIED_OUT, _LONGEST = 1e-6, 2**17
# Samples of which those eigenvalues are.
_SAMPLES = 48
# Half a swing of a force in a window, and no less: what changes faster is not a tissue's law.
LENGTH = 0.3
MODES = 6
# The kernel is a polynomial of this many terms in either time to rounding error.
_NODES = 24
# At lags in samples.
Correlation = Callable[[Int[np.ndarray, " lag"]], Float[np.ndarray, " lag"]]


class TraceNoise(NamedTuple):
    """The noise of one trace over its sigma, or with impacts along all first axes that of many.

    Attributes:
        inside: where there is a sample; what comes after, and before, is 0 everywhere.
        first, predictor: as `Colour` has them, at the trace's own sampling rate; empty of white noise.
    """

    inside: Bool[Array, " row"]
    first: Float[Array, "first first"]
    predictor: Float[Array, " lag"]

    @classmethod
    def of(cls, inside: Bool[Array, "impact row"], colour: Colour, rate: Int[Array, " impact"]) -> TraceNoise:
        """Of every impact, on every k-th sample: see `Colour.stride`."""
        return cls(inside[:, :: colour.stride], colour.first[rate], colour.predictor[rate])

    @property
    def is_white(self) -> bool:
        """Whether no sample shares anything with another."""
        return not self.predictor.shape[-1]

    def whitened(self, parts: Float[Array, "*part row"]) -> Float[Array, "*part row"]:
        """T^-1/2 p."""
        return parts if self.is_white else self.completed(parts, filtered(parts, self.predictor))

    def completed(
        self, parts: Float[Array, "*part row"], later: Float[Array, "*part row"]
    ) -> Float[Array, "*part row"]:
        """T^-1/2 p from p and what `filtered` makes of it, which is right after the first p samples."""
        size, rows = self.first.shape[-1], parts.shape[-1]
        begin = jnp.argmax(self.inside)
        padding = [(0, 0)] * (parts.ndim - 1) + [(0, size)]
        longer, whole = jnp.pad(parts, padding), jnp.pad(later, padding)
        start = jax.lax.dynamic_slice_in_dim(longer, begin, size, axis=-1) @ self.first.T
        whole = jax.lax.dynamic_update_slice_in_dim(whole, start, begin, axis=-1)
        return jnp.where(self.inside, whole[..., :rows], 0.0)

    def log_determinant(self) -> Float[Array, ""]:
        """Of T."""
        if self.is_white:
            return jnp.zeros(())
        size, count = len(self.first), self.inside.sum()
        of_first = jnp.where(jnp.arange(size) < count, jnp.log(jnp.diagonal(self.first)), 0.0).sum()
        return -2 * (of_first + jnp.maximum(count - size, 0) * jnp.log(self.predictor[0]))


def products(channel: SensorTrace[TraceNoise]) -> Products:
    """Of a channel's residual and columns."""
    white = channel.over_noise(channel.parts())
    return products_under(channel.noise, jnp.einsum("icar,icbr->abci", white, white), channel.log_sigma)


def products_under(noise: TraceNoise, gram: Any, log_sigma: JaxPerImpact) -> Products:
    """Of what the products are under T^-1, rows of entries [cell, impact]."""
    log_determinant = jax.vmap(TraceNoise.log_determinant)(noise)
    return Products.of_unit_noise(gram, log_determinant, noise.inside.sum(-1), log_sigma)


def filtered(
    parts: Float[Array, "*part row"], predictor: Float[Array, " lag"], stride: int = 1
) -> Float[Array, "*part row"]:
    """sum_j w_j p_(t - k j) with the weights w of a predictor on every k-th sample; p is 0 before."""
    rows, reach = parts.shape[-1], stride * (predictor.shape[-1] - 1)
    length = bucket(rows + reach)
    weights = jnp.zeros(length).at[: reach + 1 : stride].set(predictor)
    product = jnp.fft.rfft(parts, length) * jnp.fft.rfft(weights)
    return jnp.fft.irfft(product, length)[..., :rows]


def colour_of(white: float, correlations: Sequence[Correlation], rows: int) -> Colour:
    """Noise that went through a filter, on so many rows.

    Args:
        white: f.
        correlations: for each sampling rate those of filtered noise at lags in samples.
        rows: of the longest trace, the samples before its first one included.
    """
    white = max(white, _LEAST_WHITE)
    stride = max(_stride(white, correlation) for correlation in correlations)

    def at(correlation: Correlation, lag: np.ndarray) -> np.ndarray:
        return np.where(lag == 0, 1.0, (1 - white) * correlation(lag))

    autocorrelations = [
        at(correlation, stride * np.arange(-(-rows // stride))) for correlation in correlations
    ]
    order = max(_order(of_lags) for of_lags in autocorrelations)
    length = max(_length(partial(at, correlation), rows) for correlation in correlations)
    wheel = np.minimum(np.arange(2 * length), 2 * length - np.arange(2 * length))
    firsts, predictors, spectra = [], [], []
    for of_lags, correlation in zip(autocorrelations, correlations, strict=True):
        factor = np.linalg.cholesky(toeplitz(of_lags[: order + 1]))
        inverse = np.linalg.inv(factor)
        firsts.append(inverse[:order, :order])
        # The weights of a sample, its own first, on those before it.
        predictors.append(inverse[order, ::-1])
        spectra.append(np.sqrt(np.maximum(np.fft.rfft(at(correlation, wheel)).real, 0.0)))
    first, predictor, spectrum = (jnp.asarray(np.stack(part)) for part in (firsts, predictors, spectra))
    return Colour(first, predictor, spectrum, jnp.zeros(stride))


def _order(of_lags: Float[np.ndarray, " lag"]) -> int:
    """How many samples before it a sample has to be told by."""
    weights = solve_toeplitz(of_lags[:-1], of_lags[1:])
    left_out = np.cumsum(np.abs(weights[::-1]))[::-1]
    return int((left_out > _LEFT_OUT).sum())


def _length(at: Callable[[np.ndarray], np.ndarray], rows: int) -> int:
    """Samples after which, and after all of a trace, the correlations have died out."""
    length = bucket(rows)
    while length < _LONGEST and np.abs(at(length // 2 + np.arange(length // 2))).max() > _DIED_OUT:
        length *= 2
    return length


def _stride(white: float, correlations: Correlation) -> int:
    """How far apart samples must be for T to have no eigenvalue below `LEAST_EIGENVALUE`."""
    stride = 1
    while True:
        least = np.linalg.eigvalsh(toeplitz(correlations(stride * np.arange(_SAMPLES))))[0]
        if white + (1 - white) * least >= LEAST_EIGENVALUE:
            return stride
        stride += 1


def drawn(
    colour: Colour, rate: Int[Array, " impact"], key: Array, shape: tuple[int, ...]
) -> Float[Array, "*batch impact sample"]:
    """Noise over sigma on all samples: coloured, part of a circle of them, whose covariance is circulant."""
    if colour.is_white:
        return jax.random.normal(key, shape)
    root = colour.spectrum[rate]
    length = 2 * (root.shape[-1] - 1)
    white = jnp.fft.rfft(jax.random.normal(key, (*shape[:-1], length)))
    return jnp.fft.irfft(root * white, length)[..., : shape[-1]]


def discrepancy_modes(n_samples: IndexPerImpact, since_first: PerSample) -> Discrepancy:
    """Eigenvectors U and eigenvalues lambda of a discrepancy's kernel on each impact's samples.

    The kernel is taken through its polynomial at Chebyshev's points, so that the eigenvectors of 24 by 24
    matrices give those on any number of samples.

    Args:
        n_samples: of each impact, six or more.
        since_first: when the samples were, since the first of each row, in any unit.

    Returns:
        U, orthonormal over each impact's samples and 0 past its end, and lambda, greatest first, with the
        sum n_samples, so that s is the root of delta's mean square.
    """
    count = np.asarray(n_samples)[:, None]
    index = np.arange(since_first.shape[1])
    last = np.take_along_axis(since_first, count - 1, axis=1)
    time = np.where(index < count, 2 * since_first / last - 1, 0.0)
    nodes = np.polynomial.chebyshev.chebpts1(_NODES)
    to_values = np.polynomial.chebyshev.chebvander(time, _NODES - 1)
    through = to_values @ np.linalg.inv(np.polynomial.chebyshev.chebvander(nodes, _NODES - 1))
    through = np.where((index < count)[..., None], through, 0.0)
    # Chebyshev's times go from -1 to 1.
    kernel = np.exp(-((nodes[:, None] - nodes) ** 2) / (2 * (2 * LENGTH) ** 2))
    frame, triangle = np.linalg.qr(through)
    values, vectors = np.linalg.eigh(triangle @ kernel @ triangle.swapaxes(1, 2))
    values, vectors = values[:, : -MODES - 1 : -1], vectors[:, :, : -MODES - 1 : -1]
    basis = np.where((index < count)[:, None], (frame @ vectors).swapaxes(1, 2), 0.0)
    share = values * count / values.sum(1, keepdims=True)
    return Discrepancy(jnp.asarray(basis), jnp.asarray(share))
