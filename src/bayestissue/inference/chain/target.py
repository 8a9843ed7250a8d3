"""The posterior of a fit in the pieces that the chain's moves ask for.

The hyperparameters ψ have unconstrained coordinates y; b are the fixed and group effects, u each impact's
parameters, and p(ψ, b, u, traces) = p(y) p(b | ψ) Π N(u; X b, D⁻¹) p(trace | u). It is the density of
`bayestissue.model.hierarchy.trace_models.plain_model`, but that standard deviations below `LEAST` are left
out: of a log that is no physics, and the algebra would lose its digits there.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple, Self

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Bool, Float, Int, Shaped

from bayestissue.base.impact_arrays import bucket, padded_impacts
from bayestissue.inference.execution.kept import all_kept, some_impacts
from bayestissue.inference.factors.sites import log_likelihoods
from bayestissue.mechanics.elements import element
from bayestissue.model.hierarchy.gaussian.arrangement import expected, expected_by_cell
from bayestissue.model.hierarchy.gaussian.effects import (
    Covariances,
    EffectsPosterior,
    SitesByCell,
    effects_from_standard,
    integrate_effects,
    standard_effects,
)
from bayestissue.model.hierarchy.gaussian.factor import Conditional, GaussianFactor
from bayestissue.model.hierarchy.trace_data import Prepared
from bayestissue.model.hierarchy.trace_models import (
    GAIN,
    TraceData,
    TraceModel,
    added_mass_of,
    hyperparameters_at,
    impact_likelihood,
    log_likelihood,
)
from bayestissue.model.likelihood.compressed import LANES, CompressedTraces, log_density, within

LEAST = 1e-4
# The axis of devices, each of which has some of the impacts.
AXIS = "impact"
_MOST_CORRELATION = 1 - 1e-9


class CellSums(NamedTuple):
    """Number, sum and squares, by cell of the design, of u about its mean under b's prior."""

    number: Float[Array, " entry"]
    deviation: Float[Array, "parameter entry"]
    squares: Float[Array, "parameter parameter entry"]


class LogRatios(NamedTuple):
    """Log of likelihood over site: of the impacts that are shown, summed over each grouping's levels."""

    impacts: Float[Array, " shown"]
    groups: tuple[Float[Array, " level"], ...]


class ConditionalEffects(NamedTuple):
    """b given the hyperparameters and what stands for the data, and the log density of these together."""

    conditional: EffectsPosterior
    log_density: Float[Array, ""]


FIELDS = ["model", "data", "compressed", "present", "shown", "groups", "level", "level_present"]
SIZES = ["levels", "shards"]


@partial(jax.tree_util.register_dataclass, data_fields=FIELDS, meta_fields=SIZES)
@dataclass(frozen=True)
class Target:
    """The posterior of one prepared dataset.

    Attributes:
        model: what is assumed.
        data: the traces and the design, as many impacts as a `bucket` holds.
        compressed: the traces at a few nodes, if these can be.
        present: which of them there are.
        shown: numbers of those that everything is kept of.
        groups: of each grouping of the design, the level of every impact.
        level: of the grouping that is eliminated first, likewise; of a design without one all are of one.
        level_present: which of these levels have impacts.
        levels: how many levels each has.
        shards: over how many devices the impacts are shared out.
    """

    model: TraceModel
    data: TraceData
    compressed: CompressedTraces | None
    present: Bool[Array, " impact"]
    shown: Int[Array, " shown"]
    groups: tuple[Int[Array, " impact"], ...]
    level: Int[Array, " impact"]
    level_present: Bool[Array, " level"]
    levels: tuple[int, ...]
    shards: int = 1

    @classmethod
    def from_prepared(cls, prepared: Prepared) -> Self:
        """The posterior of a fit."""
        data, count = prepared.data.padded, len(prepared.impacts)
        present = np.arange(len(data.log_mass)) < count
        # Of some impacts alone, as `some_of` has them, the design is still that of all.
        groupings = [one for one in prepared.design.groupings.values() if len(one.code) == count]
        shown = np.arange(len(present)) if all_kept(count) else some_impacts(count)
        design = data.design
        level = np.asarray(design.level)[np.asarray(design.cell) // design.inner[0].shape[2]]
        level_present = np.isin(np.arange(design.inner_element[0].shape[1]), level[present])
        return cls(
            prepared.model,
            jax.tree.map(jnp.asarray, data),
            CompressedTraces.of(element(prepared.model.element), data.record),
            jnp.asarray(present),
            jnp.asarray(shown),
            tuple(jnp.asarray(padded_impacts(grouping.code)) for grouping in groupings),
            jnp.asarray(level),
            jnp.asarray(level_present),
            tuple(bucket(len(grouping.levels)) for grouping in groupings),
        )

    def shared_out(self) -> Self:
        """The same over all devices, where traces are compressed and each gets as many blocks of them.

        A loop over a single block is compiled as none, and its last digits are others: of less than two
        blocks a device, and of traces that aren't compressed, one has all.
        """
        blocks, rest = divmod(len(self.present), LANES * jax.device_count())
        shared = self.compressed is not None and blocks > 1 and not rest
        return replace(self, shards=jax.device_count()) if shared else self

    @property
    def level_effects(self) -> Int[Array, "inner level"]:
        """Elements of b of each level of the grouping that is eliminated first; one past the last: none.

        Of a design without groupings all of b is one level's: an effect on a parameter that its traces leave
        open moves with these impacts, where their sites have no such tail.
        """
        of_levels = jnp.concatenate(self.data.design.inner_element)
        return of_levels if len(of_levels) else jnp.arange(len(self.data.location_mean))[:, None]

    @property
    def parts(self) -> int:
        """The most parts of a proposal that are accepted or not: impacts, or levels."""
        return max(self.impacts, self.level_effects.shape[1])

    @property
    def impacts(self) -> int:
        """How many there are, those that fill up and those of other devices included."""
        return self.shards * len(self.present)

    @property
    def numbers(self) -> Int[Array, " impact"]:
        """Of the impacts that this device has."""
        return self.shard(jnp.arange(self.impacts))

    def shard(self, values: Shaped[Array, "*batch all"]) -> Shaped[Array, "*batch impact"]:
        """What this device has of the values of all impacts."""
        if self.shards == 1:
            return values
        size = len(self.present)
        return jax.lax.dynamic_slice_in_dim(values, jax.lax.axis_index(AXIS) * size, size, axis=-1)

    def gathered(self, values: Array, axis: int = -1) -> Array:
        """The values of all impacts, in their order along one axis, of what each device has."""
        return values if self.shards == 1 else jax.lax.all_gather(values, AXIS, axis=axis, tiled=True)

    def covariances(self, y: Float[Array, " hyperparameter"]) -> Covariances:
        """Of an impact's parameters about X b, and of b."""
        return self.model.covariances(hyperparameters_at(self.model, y)[0])

    def log_prior(self, y: Float[Array, " hyperparameter"]) -> Float[Array, ""]:
        """Log density of the hyperparameters' coordinates."""
        values, density = hyperparameters_at(self.model, y)
        correlation = values.get("residual_correlation", jnp.zeros(()))
        sd = jnp.stack([value for name, value in values.items() if name != "residual_correlation"])
        allowed = (sd > LEAST).all() & (jnp.abs(correlation) < _MOST_CORRELATION)
        return jnp.where(allowed, density, -jnp.inf)

    def log_likelihood(self, u: Float[Array, "parameter impact"]) -> Float[Array, " impact"]:
        """Of each trace, 0 of those that are not present."""
        # Without the barrier the algebra that made u is done again at every sample of a trace.
        of_impacts, traces = list(jax.lax.optimization_barrier(u)), self.compressed
        value = self._at_nodes(traces, of_impacts) if traces else self._of_all_samples(of_impacts)
        return jnp.where(self.present, jnp.where(jnp.isfinite(value), value, -jnp.inf), 0.0)

    def _of_all_samples(self, u: list[Array]) -> Float[Array, " impact"]:
        return log_likelihood(self.model, self.data, u)

    def _at_nodes(self, traces: CompressedTraces, u: list[Array]) -> Float[Array, " impact"]:
        """From the compressed traces, or of all samples where one of them is not within its bound."""
        impacts = impact_likelihood(self.model, self.data, u)
        value = log_density(traces, impacts)
        known = within(traces, impacts) & jnp.isfinite(value) | ~self.present
        return jax.lax.cond(self.gathered(known).all(), lambda u: value, self._of_all_samples, u)

    def log_likelihoods(
        self, u: Float[np.ndarray, "point parameter impact"]
    ) -> Float[np.ndarray, "point impact"]:
        """The same at several points, of all that fill up as well."""
        return log_likelihoods(self.model, self.data, np.moveaxis(u, 1, 2))

    @property
    def added_mass(self) -> int | None:
        """Which of an impact's parameters is the log of a mass that moves along; None where none does."""
        return added_mass_of(self.model)

    @property
    def common(self) -> int | None:
        """Which of an impact's parameters is nearly the same of all: such a mass, or an error of the gain."""
        return 2 + self.model.nuisance.index(GAIN) if self.model.gain else self.added_mass

    @property
    def common_spread(self) -> int | None:
        """Which hyperparameter is its standard deviation between impacts; None where that is known."""
        name = f"sd_{self.model.nuisance[self.common - 2]}" if self.common is not None else ""
        names = self.model.hyperparameters
        return names.index(name) if name in names else None

    def per_inertia(
        self, u: Float[Any, "*draw parameter impact"], sign: float = 1.0
    ) -> Float[Any, "*draw parameter impact"]:
        """K and C over (M + m) / M, the mass m moving along: what a deceleration shows of them.

        log K - log(1 + m / M) keeps every volume, as log m stays. As they are where no tissue moves along.

        Args:
            u: every impact's parameters.
            sign: -1 for the way back.
        """
        which = self.added_mass
        if which is None:
            return u
        numpy = u.__array_namespace__()
        heavier = numpy.log1p(numpy.exp(u[..., which, :] - numpy.asarray(self.data.log_mass)))
        shift = sign * heavier[..., None, :]
        return numpy.concatenate([u[..., :2, :] - shift, u[..., 2:, :]], axis=-2)

    def log_ratios(self, log_ratio: Float[Array, " impact"]) -> LogRatios:
        """What is kept of every trace's likelihood over its site."""
        there = self.gathered(jnp.where(self.present, log_ratio, 0.0))
        pairs = zip(self.groups, self.levels, strict=True)
        return LogRatios(
            there[self.shown], tuple(jax.ops.segment_sum(there, code, levels) for code, levels in pairs)
        )

    def prior_mean(self, b: Float[Array, " location"]) -> Float[Array, "parameter impact"]:
        """X b of every impact."""
        return expected(self.data.design, b)

    def cell_sums(self, u: Float[Array, "parameter impact"]) -> CellSums:
        """What the population's density asks of the impacts where these are known."""
        design = self.data.design
        mean = expected_by_cell(design, self.data.location_mean)
        deviation = self.gathered(jnp.where(self.present, u - mean[:, design.cell], 0.0))
        squares = deviation[:, None] * deviation[None]
        number = self.gathered(jnp.where(self.present, 1.0, 0.0))
        return CellSums(*(design.to_cells(values) for values in (number, deviation, squares)))

    def given_impacts(self, y: Float[Array, " hyperparameter"], sums: CellSums) -> ConditionalEffects:
        """B given ψ and u, and log p(y, u) with b integrated out, up to a constant."""
        covariances, mean = self.covariances(y), expected_by_cell(self.data.design, self.data.location_mean)
        D = covariances.of_impact()
        log_scale = (
            sums.number * jnp.linalg.slogdet(D)[1] - jnp.einsum("ab,ab...->...", D, sums.squares)
        ) / 2
        shift = jnp.einsum("ab,b...->a...", D, sums.deviation)
        cells = GaussianFactor(mean, shift, D[:, :, None] * sums.number, log_scale)
        return self._integrated(y, covariances, cells)

    def given_sites(self, y: Float[Array, " hyperparameter"], blocked: GaussianFactor) -> ConditionalEffects:
        """The same where a site stands for every trace, and u is integrated out too; see `blocked`."""
        covariances = self.covariances(y)
        by_cell = SitesByCell(self.data.design, self.data.location_mean, blocked)
        return self._integrated(y, covariances, by_cell.sums(covariances))

    def blocked(self, sites: GaussianFactor) -> GaussianFactor:
        """Impacts' sites as the design arranges them."""

        def telling(leaf: Array) -> Array:
            present = self.present.reshape(-1, *[1] * (leaf.ndim - 1))
            return self.gathered(jnp.where(present, leaf, 0.0), axis=0)

        return self.data.design.blocked(jax.tree.map(telling, sites))

    def _integrated(self, y: Array, covariances: Covariances, sums: GaussianFactor) -> ConditionalEffects:
        conditional, log_density = integrate_effects(self.data.design, covariances, sums)
        log_density = self.log_prior(y) + log_density
        return ConditionalEffects(conditional, jnp.where(jnp.isfinite(log_density), log_density, -jnp.inf))

    def effects_at(
        self, effects: ConditionalEffects, standard: Float[Array, " location"]
    ) -> Float[Array, " location"]:
        """B from standard normals."""
        return effects_from_standard(self.data.design, effects.conditional, self.data.location_mean, standard)

    def standard_effects(
        self, effects: ConditionalEffects, b: Float[Array, " location"]
    ) -> Float[Array, " location"]:
        """The standard normals from which `effects_at` makes ``b``."""
        return standard_effects(self.data.design, effects.conditional, self.data.location_mean, b)

    def impact_given(self, y: Float[Array, " hyperparameter"], sites: GaussianFactor) -> Conditional:
        """Every impact's u given ψ, its expectation and its site."""
        return Conditional(self.covariances(y).of_impact()[:, :, None], sites.batch_last())
