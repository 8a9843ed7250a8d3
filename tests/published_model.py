"""The model of published estimates from the top down, by numpyro: the chain's model written a second time."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpyro
import numpyro.distributions as dist
from jaxtyping import Array, Float
from numpyro.distributions import constraints
from numpyro.distributions.util import validate_sample

from bayestissue.model.hierarchy.gaussian.arrangement import expected
from bayestissue.model.hierarchy.trace_models import sample_hyperparameters
from bayestissue.model.likelihood import small
from bayestissue.thesis.reanalysis.observations import average_statistics, moments_of_people, pair_covariance
from bayestissue.thesis.reanalysis.table_model import EstimatesData, EstimatesModel, people_deviations


class AveragesOfLognormals(dist.Distribution):
    """What n pairs (K, C) leave behind when only their averages and standard deviations were published.

    The pairs are independent and bivariate lognormal, with their own log means ``loc`` [..., n, 2] and one
    covariance of the logs, given by its Cholesky factor ``scale_tril`` [..., 2, 2]. The event is
    (m_K, m_C, cbrt s²_K, cbrt s²_C), see `average_statistics`; the standard deviation has the divisor n − 1.

    `sample` draws the n pairs and summarises them. `log_prob` is a synthetic likelihood (Wood 2010,
    doi:10.1038/nature09319): normal, with the moments given by `average_moments`.
    """

    arg_constraints = {  # noqa: RUF012 - numpyro's convention
        "loc": constraints.independent(constraints.real, 2),
        "scale_tril": constraints.lower_cholesky,
    }
    support = constraints.real_vector
    pytree_data_fields = ("loc", "scale_tril")

    def __init__(self, loc: Array, scale_tril: Array, *, validate_args: bool | None = None) -> None:
        self.loc = loc
        self.scale_tril = jnp.broadcast_to(scale_tril, (*loc.shape[:-2], 2, 2))
        super().__init__(batch_shape=loc.shape[:-2], event_shape=(4,), validate_args=validate_args)

    def sample(self, key: Array | None, sample_shape: tuple[int, ...] = ()) -> Array:
        """Draw the n pairs and summarise them; exact."""
        if key is None:
            raise ValueError("sampling needs a key")
        noise = jax.random.normal(key, (*sample_shape, *self.loc.shape))
        pairs = jnp.exp(self.loc + jnp.einsum("...ij,...nj->...ni", self.scale_tril, noise))
        return jnp.concatenate(average_statistics(pairs.mean(-2), pairs.std(-2, ddof=1)), axis=-1)

    @validate_sample
    def log_prob(self, value: Array, intermediates: object = None) -> Array:
        """The synthetic normal density of the event."""
        mean, sd, correlation = average_moments(self.loc, self.scale_tril)
        # Two independent pairs (K, C) of correlated normals: the means of the logs, and the spreads.
        deviation, sd = jnp.moveaxis(value - mean, -1, 0), jnp.moveaxis(sd, -1, 0)
        means, roots = (pair_covariance(sd[a : a + 2], correlation[..., a // 2]) for a in (0, 2))
        return small.normal_log_density(deviation[:2], means) + small.normal_log_density(deviation[2:], roots)


def average_moments(
    loc: Float[Array, "*batch pair 2"], scale_tril: Float[Array, "*batch 2 2"]
) -> tuple[Float[Array, "*batch 4"], Float[Array, "*batch 4"], Float[Array, "*batch 2"]]:
    """Mean and standard deviation of the event of `AveragesOfLognormals`, and two correlations.

    The correlations are those of m_K with m_C, and of cbrt s²_K with cbrt s²_C; the other four vanish
    nearly. See `moments_of_people`.
    """
    return moments_of_people(loc.mean(-2), loc.var(-2, ddof=1), scale_tril, loc.shape[-2])


def plain_model(model: EstimatesModel, data: EstimatesData) -> None:
    """The model from the top down: hyperparameters, b, every estimate, the lost tables' averages."""
    covariances = model.covariances(sample_hyperparameters(model))
    b = numpyro.sample("locations", dist.Normal(data.location_mean, covariances.locations).to_event(1))
    expectation = expected(data.design, b).T
    tables, factor = len(data.roots), jnp.linalg.cholesky(covariances.pair_matrix)
    with numpyro.plate("averaged_trial", tables):
        lost = AveragesOfLognormals(expectation[:tables, None] + people_deviations(data, b), factor)
        events = jnp.concatenate([data.value[:tables], data.roots], axis=-1)
        numpyro.sample("averages", lost.mask(data.included[:tables] > 0), obs=events)
    with numpyro.plate("impact", len(data.value) - tables):
        estimates = dist.MultivariateNormal(expectation[tables:], scale_tril=factor)
        numpyro.sample("estimates", estimates.mask(data.included[tables:] > 0), obs=data.value[tables:])
