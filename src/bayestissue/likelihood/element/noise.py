"""A recorder's noise, and what a trace holds beside the impact and the chain's errors.

The covariance of a trace, given impact and errors, is sigma^2 T with T = S + A A': white noise or one that
went through a filter, and a few modes A besides. By Woodbury's identity, with p~ = S^-1/2 p and
M = 1 + A~' A~,

    p' T^-1 q = p~'q~ - (A~'p~)' M^-1 (A~'q~),    log det T = log det S + log det M.

Two things make modes and S:

Noise that went through the recorder's low-pass, beside a share f of white noise that entered behind it: S = f
1 + (1 - f) R, R being the correlations that the filter leaves (`bayestissue.signal.filters`). Of a
sample the p before it say all, to rounding, that all before it do, p being some periods of the corner. So
S^-1/2 = L^-1, S = L L', is a dense matrix for the first p samples of a trace, and from there on the same few
weights at every sample (an autoregression of order p; Box and Jenkins, Time Series Analysis, section 7.4):
the work goes with the number of samples. Where next to no noise entered behind the filter, S has eigenvalues
near 0, of what changes faster than the filter lets pass. A likelihood would believe those frequencies above
all others, and whatever the filter's description leaves out there, and it would take the noise's size from
them. So only every k-th sample is asked, as far apart as keeps the least eigenvalue of S at
`LEAST_EIGENVALUE`: some four in a period of the corner.

A discrepancy, a smooth force of unknown shape: delta(t), a Gaussian process on the force per mass (Kennedy
and O'Hagan 2001), with the covariance s^2 exp(-(t - t')^2 / (2 l^2)) over the window's own time t in [0, 1]
and l = 0.3, by its first six eigenvectors on the samples: delta = U c with c_j ~ N(0, s^2 lambda_j). It adds
(s / sigma)^2 U diag(lambda) U' to T.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.scipy.linalg import solve_triangular
from jaxtyping import Bool, Float, Int
from scipy.linalg import solve_toeplitz, toeplitz

from bayestissue.likelihood.element.record import DecelerationRecord, Discrepancy
from bayestissue.likelihood.element.recorder import Colour
from bayestissue.padding import bucket

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


class Noise(NamedTuple):
    """The noise of one trace over its sigma, or with impacts along all first axes that of many.

    Attributes:
        inside: where there is a sample; what comes after, and before, is 0 everywhere.
        modes: A', 0 where there is no sample; none without a discrepancy.
        first, predictor: as `Colour` has them, at the trace's own sampling rate; empty where no filter
            coloured the noise.
    """

    inside: Bool[Array, " row"]
    modes: Float[Array, "mode row"]
    first: Float[Array, "first first"]
    predictor: Float[Array, " lag"]

    @property
    def is_white(self) -> bool:
        """Whether no sample shares anything with another."""
        return not (self.modes.shape[-2] or self.is_filtered)

    @property
    def is_filtered(self) -> bool:
        """Whether the noise went through a filter."""
        return bool(self.predictor.shape[-1])

    def whitened(self, parts: Float[Array, "*part row"]) -> Float[Array, "*part row"]:
        """S^-1/2 p."""
        return self.completed(parts, filtered(parts, self.predictor)) if self.is_filtered else parts

    def completed(
        self, parts: Float[Array, "*part row"], later: Float[Array, "*part row"]
    ) -> Float[Array, "*part row"]:
        """S^-1/2 p from p and what `filtered` makes of it, which is right after the first p samples."""
        size, rows = self.first.shape[-1], parts.shape[-1]
        begin = jnp.argmax(self.inside)
        padding = [(0, 0)] * (parts.ndim - 1) + [(0, size)]
        longer, whole = jnp.pad(parts, padding), jnp.pad(later, padding)
        start = jax.lax.dynamic_slice_in_dim(longer, begin, size, axis=-1) @ self.first.T
        whole = jax.lax.dynamic_update_slice_in_dim(whole, start, begin, axis=-1)
        return jnp.where(self.inside, whole[..., :rows], 0.0)

    def gram(self, parts: Float[Array, "part row"]) -> Float[Array, "part part"]:
        """The products p' T^-1 q of all parts with each other."""
        return self.gram_of_white(self.whitened(parts))

    def gram_of_white(self, white: Float[Array, "part row"]) -> Float[Array, "part part"]:
        """The same of parts that are `whitened`."""
        products = white @ white.T
        if self.modes.shape[0]:
            modes = self.whitened(self.modes)
            shared = solve_triangular(self._factor(), modes @ white.T, lower=True)
            products = products - shared.T @ shared
        return products

    def log_determinant(self) -> Float[Array, ""]:
        """Of T."""
        total = jnp.zeros(())
        if self.is_filtered:
            size, count = len(self.first), self.inside.sum()
            of_first = jnp.where(jnp.arange(size) < count, jnp.log(jnp.diagonal(self.first)), 0.0).sum()
            total = -2 * (of_first + jnp.maximum(count - size, 0) * jnp.log(self.predictor[0]))
        if self.modes.shape[0]:
            total = total + 2 * jnp.log(jnp.diagonal(self._factor())).sum()
        return total

    def _factor(self) -> Float[Array, "mode mode"]:
        """L of L L' = M."""
        modes = self.whitened(self.modes)
        return jnp.linalg.cholesky(jnp.eye(len(modes)) + modes @ modes.T)


def noise_of(record: DecelerationRecord, discrepancy_ratio: Float[Array, " impact"]) -> Noise:
    """The noise of every trace, on the samples that it is asked at, those before the first among them.

    Args:
        record: what was recorded.
        discrepancy_ratio: s / sigma; nothing without a discrepancy.
    """
    colour, contact, stride = record.colour, record.contact, record.colour.stride
    inside = jnp.concatenate([contact.counts, record.observed()], axis=1)[:, ::stride]
    basis = jnp.pad(record.discrepancy.basis, ((0, 0), (0, 0), (contact.reach, 0)))[..., ::stride]
    if record.clipped is not None:
        basis = jnp.where(inside[:, None], basis, 0.0)
    scale = discrepancy_ratio[:, None] * jnp.sqrt(record.discrepancy.share)
    first, predictor = colour.first[record.rate], colour.predictor[record.rate]
    return Noise(inside, scale[..., None] * basis, first, predictor)


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
    """Coloured noise over sigma on all samples: part of a circle of them, whose covariance is circulant."""
    root = colour.spectrum[rate]
    length = 2 * (root.shape[-1] - 1)
    white = jnp.fft.rfft(jax.random.normal(key, (*shape[:-1], length)))
    return jnp.fft.irfft(root * white, length)[..., : shape[-1]]


def innovations(
    colour: Colour, rate: Int[Array, " impact"], left: Float[Array, "impact row"]
) -> Float[Array, "impact row"]:
    """What each sample has beside what those before it say of it, as white as the noise's model is right.

    L^-1 e with T = L L'.

    Args:
        colour: the noise.
        rate: which of its sampling rates each impact has.
        left: residuals at every k-th sample: see `Colour.stride`.
    """

    def of_one(left: Array, first: Array, predictor: Array) -> Array:
        none = jnp.zeros((0, len(left)))
        return Noise(jnp.ones(len(left), bool), none, first, predictor).whitened(left)

    return jax.vmap(of_one)(left, colour.first[rate], colour.predictor[rate])


def discrepancy_modes(
    n_samples: Int[np.ndarray, " impact"], since_first: Float[np.ndarray, "impact sample"]
) -> Discrepancy:
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


def weights_given(
    left: Float[Array, " row"],
    basis: Float[Array, "mode row"],
    noise: Noise,
    sd: Float[Array, " mode"],
    shock: Float[Array, " mode"],
) -> Float[Array, " mode"]:
    """A draw of the weights c of a discrepancy's modes, given what is left of one trace.

    Normal with mean S M^-1 S U' N^-1 left and covariance sigma^2 S M^-1 S, M = 1 + S U' N^-1 U S, for noise
    of covariance sigma^2 N.

    Args:
        left: of the trace, impact and errors of the chain taken off [m/s^2].
        basis: U'.
        noise: N, without the discrepancy.
        sd: S, standard deviations of the weights over sigma.
        shock: sigma times standard normals.
    """
    products = noise.gram(jnp.concatenate([left[None], basis]))
    factor = jnp.linalg.cholesky(jnp.eye(len(sd)) + sd[:, None] * sd * products[1:, 1:])
    mean = solve_triangular(factor, sd * products[0, 1:], lower=True)
    return sd * solve_triangular(factor.T, mean + shock, lower=False)
