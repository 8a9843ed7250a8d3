"""Errors that enter traces linearly, integrated out in closed form: a trace is channels that share them.

A channel is y = f + sum_a e_a q_a + noise, with the errors e_a normal about 0 and independent, q_a known
columns, and noise with covariance sigma^2 T. All that the density needs of the data are the products of
the columns under (sigma^2 T)^-1, y - f being column 0: those of several channels with the same errors add up.
The last error may be uniform about 0 instead, as a moment is that lies anywhere between two samples.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jax.scipy.special import log_ndtr
from jaxtyping import Bool, Float

from bayestissue.base.impact_arrays import JaxPerImpact
from bayestissue.model.likelihood import small

_LOG_ROOT_HALF_PI = 0.22579135264472744
_ROOT_3 = 3**0.5
_LEAST_PIVOT = 1e-12


class Errors(NamedTuple):
    """What is known of a trace's errors beforehand.

    Attributes:
        sd: standard deviation of each; 0 where there is none.
        uniform: where the last one is uniform, with that standard deviation above 0.
    """

    sd: Float[Array, "*cell impact error"]
    uniform: Bool[Array, " impact"]

    @property
    def unit(self) -> Float[Array, "*cell impact error"]:
        """Their standard deviations, and a uniform one's half width."""
        return self.sd.at[..., -1].multiply(jnp.where(self.uniform, _ROOT_3, 1.0))

    def drawn(self, key: Array) -> Float[Array, "impact error"]:
        """A draw before any trace is seen."""
        errors = self.sd * jax.random.normal(key, self.sd.shape)
        even = jax.random.uniform(jax.random.fold_in(key, 1), errors.shape[:-1], minval=-1.0, maxval=1.0)
        last = jnp.where(self.uniform, self.unit[..., -1] * even, errors[..., -1])
        return errors.at[..., -1].set(last)


class Products(NamedTuple):
    """What is left of a set of traces once the shape of each is given.

    Attributes:
        gram: products of column a with column b under (sigma^2 T)^-1, as rows of entries [impact].
        log_scale: log det(2 pi sigma^2 T).
    """

    gram: Any
    log_scale: JaxPerImpact

    @classmethod
    def of_unit_noise(
        cls, gram: Any, log_determinant: Array, count: Array, log_sigma: JaxPerImpact
    ) -> Products:
        """From products under T^-1, log det T, the number of values of each trace, and log sigma."""
        precision = jnp.exp(-2 * log_sigma)
        in_units = jax.tree.map(lambda entry: entry * precision, gram)
        return cls(in_units, log_determinant + count * (small.LOG_2PI + 2 * log_sigma))

    def beside(self, other: Products) -> Products:
        """Of two channels together."""
        gram = [
            [a + b for a, b in zip(*rows, strict=True)] for rows in zip(self.gram, other.gram, strict=True)
        ]
        return Products(gram, self.log_scale + other.log_scale)


def marginal_log_likelihood(products: Products, errors: Errors) -> Float[Array, "*cell impact"]:
    """Log density of each trace with its errors integrated out.

    -(log det(2 pi sigma^2 T) + log det M + G_00 - h' M^-1 h) / 2 with M = 1 + S G S, h = S G_.0 and S the
    standard deviations of the errors: the matrix determinant lemma and the Woodbury identity. Where the last
    error is uniform, M has no 1 for it and S its half width; with L L' = M and y = L^-1 h the integral over
    it leaves the factor (pi / 2)^1/2 (Phi(l - y) - Phi(-l - y)), l and y the last of L's diagonal and of y.

    Args:
        products: of residual and error columns.
        errors: those that are integrated out.
    """
    factor, right = _system(products, errors)
    solved = small.solve_lower(factor, right)
    explained = sum(value**2 for value in solved)
    log_density = -(products.log_scale + products.gram[0][0] - explained) / 2 - small.log_diagonal(factor)
    half, centre = factor[-1][-1], jnp.abs(solved[-1])
    near, far = log_ndtr(half - centre), log_ndtr(-half - centre)
    share = _LOG_ROOT_HALF_PI + near + jnp.log1p(-jnp.exp(far - near))
    return log_density + jnp.where(errors.uniform, share, 0.0)


def predicted_given(
    products: Products, errors: Errors, columns: Float[Array, "error row *cell impact"]
) -> tuple[Float[Array, "row *cell impact"], list[Float[Array, "row *cell impact"]]]:
    """What the errors add to further values given the trace: their mean, and what is unknown of it.

    Given the trace the errors are normal with mean S M^-1 h and covariance S M^-1 S, so that they add
    q' S M^-1 h + b' z to a value with the entries q in the columns, z being standard normals that all values
    share and b = L^-1 S q, L L' = M.

    Args:
        products: of residual and error columns over the values that are there.
        errors: as of `marginal_log_likelihood`; a uniform one's normal is not cut off at its bounds here.
        columns: of the errors, at the further values.
    """
    factor, right = _system(products, errors)
    along = small.solve_lower(factor, [errors.unit[..., a] * column for a, column in enumerate(columns)])
    return small.dot(along, small.solve_lower(factor, right)), along


def draw_errors(key: Array, products: Products, errors: Errors) -> Float[Array, "impact error"]:
    """The errors given the trace and everything else: normal with mean S M^-1 h and covariance S M^-1 S.

    A uniform last error is drawn from its normal cut off at its bounds, the others given it. Arguments as
    those of `marginal_log_likelihood`.
    """
    factor, right = _system(products, errors)
    standard = jax.random.normal(key, errors.sd.shape)
    mean = small.solve_lower(factor, right)
    whole = [value + standard[..., a] for a, value in enumerate(mean)]
    half, centre = factor[-1][-1], mean[-1]
    within = jax.random.truncated_normal(
        jax.random.fold_in(key, 1), -half - centre, half - centre, centre.shape
    )
    whole[-1] = jnp.where(errors.uniform, centre + within, whole[-1])
    return errors.unit * jnp.stack(small.solve_upper(factor, whole), axis=-1)


def _system(products: Products, errors: Errors) -> tuple[list[list[Array]], list[Array]]:
    """L of L L' = M, and h."""
    entries, unit = products.gram, errors.unit
    scale = [unit[..., a] for a in range(unit.shape[-1])]
    # A trace that said nothing of a uniform error would leave a zero pivot.
    prior = [*[1.0] * (len(scale) - 1), jnp.where(errors.uniform, _LEAST_PIVOT, 1.0)]

    def of_both(a: int, b: int) -> Array:
        return scale[a] * scale[b] * entries[a + 1][b + 1] + (prior[a] if a == b else 0.0)

    right = [scale[a] * entries[a + 1][0] for a in range(len(scale))]
    return small.cholesky(small.symmetric(len(scale), of_both)), right


def from_lower_entries(entries: Sequence[Array]) -> list[list[Array]]:
    """The rows of a symmetric matrix from those of its lower triangle."""
    size = int((8 * len(entries) + 1) ** 0.5) // 2
    return small.symmetric(size, lambda a, b: entries[a * (a + 1) // 2 + b])


def part_of(error: JaxPerImpact, sd: JaxPerImpact, share: JaxPerImpact, key: Array) -> JaxPerImpact:
    """A draw of one of two normal errors whose sum is known: N(share error, share (1 - share) sd^2).

    Args:
        error: the sum.
        sd: its standard deviation.
        share: of its variance that of the one.
        key: of the draw.
    """
    spread = sd * jnp.sqrt(share * (1 - share))
    return share * error + spread * jax.random.normal(key, error.shape)
