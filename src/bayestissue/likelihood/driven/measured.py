"""Displacement and force of tissue that something pushes: K and C from the law alone, without a mass.

x(t) is a smooth motion of unknown shape (`bayestissue.likelihood.driven.motion`), measured by

    y_k = x(t_k) + level + e_k,                 e_k ~ N(0, s_x^2),
    F_k = K x(t_k) + C x'(t_k) + delta(t_k) + zero + n_k,    n_k ~ N(0, s_F^2).

x is counted from contact: x(0) is as small as contact is sure, and what the sensor reads there, the level, is
not known. delta is a smooth force beside spring and damper, where the model has one. All but K, C and the
standard deviations is linear and normal, and is integrated out in closed form: noise of the displacement
is carried into the force by the law itself (regression with errors in both variables; Fuller, Measurement
Error Models, chapter 1, where what varies is known to be smooth).

With z all that is normal in units of its standard deviation, the rows have A z in them besides noise: with
M = 1 + A'A and h = A'r, A and r over the noise,

    log p = -(r'r - h' M^-1 h + log det M) / 2 - n_x log s_x - n_F log s_F + constant .

Rows are taken less a motion at hand, so that r is small where K and C are right and no digits are lost.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.scipy.linalg import cho_solve, solve_triangular
from jaxtyping import Bool, Float, Int

from bayestissue.likelihood.driven import motion
from bayestissue.likelihood.element.noise import discrepancy_modes
from bayestissue.likelihood.linear_errors import LOG_2PI
from bayestissue.padding import padded_zeros

# Of a_1 and a_2 and of the level, over the greatest displacement: next to nothing is known of them.
_WIDE = 30.0
# Of a motion at hand: how rough, and how exact its samples are taken to be, over the greatest displacement.
_ROUGH, _EXACT = 30.0, 1e-3


class DrivenRecord(NamedTuple):
    """What the likelihood reads of displacements and forces.

    Attributes:
        y: forces, 0 past a row's end [N].
        n_samples: length of each.
        first_time: from contact to the first sample of the force [s].
        dt: its sampling interval [s].
        x: displacements, 0 past a row's end [m].
        n_displacements: length of each.
        first_displacement: from contact to its first sample [s].
        dt_displacement: its sampling interval [s].
        error_sd: standard deviations of the depth at contact [m] and of the force's zero [N].
        unit: greatest displacement and greatest force: [m] and [N].
        at_x: of the displacement's samples the motion's functions, times the greatest displacement [m].
        at_y: of the force's samples the same.
        rate: of the force's samples their slopes [m/s].
        modes: of a force beside the element's, over the greatest force; none without.
        reference: weights of a motion that the displacements show, and the level.
        squares: sums of at_x' at_x, of at_y' at_y, at_y' rate + rate' at_y and rate' rate.
    """

    y: Float[Array, "impact row"]
    n_samples: Int[Array, " impact"]
    first_time: Float[Array, " impact"]
    dt: Float[Array, " impact"]
    x: Float[Array, "impact sample"]
    n_displacements: Int[Array, " impact"]
    first_displacement: Float[Array, " impact"]
    dt_displacement: Float[Array, " impact"]
    error_sd: Float[Array, "impact 2"]
    unit: Float[Array, "impact 2"]
    at_x: Float[Array, "impact sample function"]
    at_y: Float[Array, "impact row function"]
    rate: Float[Array, "impact row function"]
    modes: Float[Array, "impact row mode"]
    reference: Float[Array, "impact weight"]
    squares: tuple[Float[Array, "impact function function"], ...]

    @property
    def traces(self) -> Float[Array, "impact row"]:
        """The recorded forces."""
        return self.y

    @property
    def side_by_side(self) -> bool:
        """Whether it is of a spring and damper side by side alone."""
        return True

    @property
    def surroundings(self) -> dict[str, Float[Array, " impact"]]:
        """What an element's functions take beside its parameters: nothing."""
        return {}

    @property
    def velocity(self) -> None:
        """Of no mass that arrives with one."""
        return

    @property
    def errors(self) -> dict[str, str]:
        """What each column of ``error_sd`` is called in the posterior, and which link of the chain errs."""
        return {"contact_depth_error": "contact moment", "force_zero_error": "force's zero"}

    def inside(self) -> Bool[Array, "impact row"]:
        """True where there is a sample of the force."""
        return jnp.arange(self.y.shape[1]) < self.n_samples[:, None]

    def velocity_error(self, errors: Float[Array, "impact 2"], key: Array) -> None:
        """No velocity is recorded."""
        del errors, key

    def with_traces(
        self, traces: Float[np.ndarray, "impact row"], n_samples: Int[np.ndarray, " impact"]
    ) -> DrivenRecord:
        """The record of other forces, or of fewer of their samples, displacements until their end."""
        record = jax.tree.map(np.asarray, self)
        end = record.first_time + (n_samples - 1) * record.dt
        most = np.floor((end - record.first_displacement) / record.dt_displacement + 1.01).astype(int)
        n_displacements = np.clip(most, 1, record.n_displacements)
        return driven_record(
            (traces, n_samples, record.first_time, record.dt),
            (record.x, n_displacements, record.first_displacement, record.dt_displacement),
            record.error_sd,
            discrepancy=bool(record.modes.shape[-1]),
        )

    def with_channels(
        self, x: Float[np.ndarray, "impact sample"], y: Float[np.ndarray, "impact row"]
    ) -> DrivenRecord:
        """The record of other displacements and forces at the same times."""
        record = jax.tree.map(np.asarray, self)
        return driven_record(
            (y[:, : record.y.shape[1]], record.n_samples, record.first_time, record.dt),
            (
                x[:, : record.x.shape[1]],
                record.n_displacements,
                record.first_displacement,
                record.dt_displacement,
            ),
            record.error_sd,
            discrepancy=bool(record.modes.shape[-1]),
        )._replace(unit=self.unit)

    def impacts(self, rows: Int[np.ndarray, " row"]) -> DrivenRecord:
        """The record of some impacts."""
        chosen: DrivenRecord = jax.tree.map(lambda leaf: np.asarray(leaf)[rows], self)
        return chosen

    def padded(self) -> DrivenRecord:
        """With as many samples, 0 past a row's end, as a `bucket` holds."""
        names = ("y", "x", "at_x", "at_y", "rate", "modes")
        return self._replace(**{name: padded_zeros(getattr(self, name), 1) for name in names})

    def with_normal_errors(self) -> DrivenRecord:
        """The record itself, whose errors are normal."""
        return self


Channel = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


def driven_record(
    force: Channel, displacement: Channel, error_sd: Float[np.ndarray, "impact 2"], *, discrepancy: bool
) -> DrivenRecord:
    """The record of forces and displacements, with all that does not depend on a parameter.

    Args:
        force: values [impact, row] in N, their number, the time from contact to the first, and the interval.
        displacement: the same of displacements, in m.
        error_sd: see `DrivenRecord`.
        discrepancy: whether there is a force beside the element's.
    """
    rows, samples = _grid(*force), _grid(*displacement)
    last = np.maximum(*((time * inside).max(axis=1) for time, inside in (rows, samples)))[:, None]
    (y, n_y, *_), (x, n_x, *_) = force, displacement
    y, x = np.where(rows[1], y, 0.0), np.where(samples[1], x, 0.0)
    unit = np.stack([np.abs(x).max(axis=1), np.abs(y).max(axis=1)], axis=1)
    depth = unit[:, :1, None]
    at_y, rate = (
        np.where(rows[1][..., None], depth * part, 0.0) for part in motion.functions(rows[0] / last)
    )
    rate = rate / last[..., None]
    at_x = np.where(samples[1][..., None], depth * motion.functions(samples[0] / last)[0], 0.0)
    modes = np.zeros((*y.shape, 0))
    if discrepancy:
        smooth = discrepancy_modes(n_y, np.broadcast_to(np.arange(y.shape[1]) + 0.0, y.shape))
        basis, share = map(np.asarray, smooth)
        modes = unit[:, 1:, None] * np.swapaxes(basis * np.sqrt(share)[..., None], 1, 2)
    cross = np.einsum("iaf,iag->ifg", at_y, rate)
    squares = (
        np.einsum("iaf,iag->ifg", at_x, at_x),
        np.einsum("iaf,iag->ifg", at_y, at_y),
        cross + np.swapaxes(cross, 1, 2),
        np.einsum("iaf,iag->ifg", rate, rate),
    )
    channels = y, n_y, *force[2:], x, n_x, *displacement[2:]
    reference = _reference(at_x, samples[1], x, unit[:, 0])
    parts: Any = (*channels, error_sd, unit, at_x, at_y, rate, modes, reference, squares)
    on_device: DrivenRecord = jax.tree.map(jnp.asarray, DrivenRecord(*parts))
    return on_device


def _grid(
    values: np.ndarray, count: np.ndarray, first: np.ndarray, dt: np.ndarray
) -> tuple[Float[np.ndarray, "impact sample"], Bool[np.ndarray, "impact sample"]]:
    """The time of each sample since contact, and which there are."""
    index = np.arange(values.shape[1])
    inside = index < np.asarray(count)[:, None]
    return np.where(inside, first[:, None] + index * dt[:, None], 0.0), inside


def _reference(
    at_x: Float[np.ndarray, "impact sample function"],
    inside: Bool[np.ndarray, "impact sample"],
    x: Float[np.ndarray, "impact sample"],
    depth: Float[np.ndarray, " impact"],
) -> Float[np.ndarray, "impact weight"]:
    """Weights of the functions and the level, by ridge regression: 0 at contact."""
    columns = np.concatenate([at_x[..., 1:], (inside * depth[:, None])[..., None]], axis=-1)
    sd = np.full(columns.shape[-1], _ROUGH)
    matrix = np.einsum("iaf,iag->ifg", columns, columns) / (_EXACT * depth[:, None, None]) ** 2
    right = np.einsum("iaf,ia->if", columns, x) / (_EXACT * depth[:, None]) ** 2
    weights = np.linalg.solve(matrix + np.diag(sd**-2.0), right[..., None])[..., 0]
    return np.concatenate([np.zeros((len(x), 1)), weights], axis=1)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class MeasuredDriven:
    """The likelihood of displacements and forces, the motion and the chain's errors integrated out.

    Attributes:
        K: [N/m].
        C: [N s/m].
        log_sigma: log of the standard deviation of a displacement's noise [m].
        log_force_sigma: of a force's [N].
        log_roughness: log of s over the greatest displacement.
        log_discrepancy: of the rms of the force beside the element's, over the greatest force; None without.
        record: see `driven_record`.
    """

    K: Float[Array, " impact"]
    C: Float[Array, " impact"]
    log_sigma: Float[Array, " impact"]
    log_force_sigma: Float[Array, " impact"]
    log_roughness: Float[Array, " impact"]
    log_discrepancy: Float[Array, " impact"] | None
    record: DrivenRecord

    def _scales(self) -> Float[Array, "impact weight"]:
        """Standard deviations of the weights: of the functions, the level, the zero and the modes."""
        record = self.record
        size, number = record.at_x.shape[-1], record.modes.shape[-1]
        one = jnp.ones_like(self.K)[:, None]
        depth = record.unit[:, :1]
        rough = jnp.exp(self.log_roughness)[:, None] * jnp.ones(size - motion.POWERS)
        parts = [record.error_sd[:, :1] / depth, _WIDE * one, _WIDE * one, rough, _WIDE * one]
        parts.append(record.error_sd[:, 1:])
        if self.log_discrepancy is not None:
            parts.append(jnp.exp(self.log_discrepancy)[:, None] * jnp.ones(number))
        return jnp.concatenate(parts, axis=1)

    def _rows(self) -> tuple[Array, Array]:
        """Rows of the displacement and of the force, less the reference motion [m], [N]."""
        record = self.record
        functions, level = record.reference[:, :-1], record.reference[:, -1:] * record.unit[:, :1]
        inside = jnp.arange(record.x.shape[1]) < record.n_displacements[:, None]
        x = record.x - jnp.where(inside, level, 0.0) - jnp.einsum("iaf,if->ia", record.at_x, functions)
        K, C = self.K[:, None], self.C[:, None]
        known = K * jnp.einsum("iaf,if->ia", record.at_y, functions)
        return x, record.y - known - C * jnp.einsum("iaf,if->ia", record.rate, functions)

    def _system(self) -> tuple[Array, Array, Array, Array]:
        """M's factor, h with the prior's pull, the squares r'r with the prior's, and the scales."""
        record, scale = self.record, self._scales()
        size, number = record.at_x.shape[-1], record.modes.shape[-1]
        over_x, over_F = jnp.exp(-2 * self.log_sigma), jnp.exp(-2 * self.log_force_sigma)
        K, C = self.K[:, None, None], self.C[:, None, None]
        inside_x = (jnp.arange(record.x.shape[1]) < record.n_displacements[:, None]) * record.unit[:, :1]
        law = K * record.at_y + C * record.rate
        # Level, zero and modes: what stands besides the functions in either channel.
        additive = jnp.concatenate([record.inside()[..., None] + 0.0, record.modes], axis=-1)
        x, F = self._rows()
        of_x, of_y, of_both, of_rate = record.squares
        motion_square = over_x[:, None, None] * of_x + over_F[:, None, None] * (
            K**2 * of_y + K * C * of_both + C**2 * of_rate
        )
        with_level = over_x[:, None] * jnp.einsum("iaf,ia->if", record.at_x, inside_x)
        with_additive = over_F[:, None, None] * jnp.einsum("iaf,iab->ifb", law, additive)
        level = over_x * (inside_x**2).sum(1)
        additive_square = over_F[:, None, None] * jnp.einsum("iab,iac->ibc", additive, additive)
        total = size + 2 + number
        gram = jnp.zeros((len(self.K), total, total))
        gram = gram.at[:, :size, :size].set(motion_square).at[:, size, size].set(level)
        gram = gram.at[:, :size, size].set(with_level).at[:, size, :size].set(with_level)
        gram = gram.at[:, :size, size + 1 :].set(with_additive)
        gram = gram.at[:, size + 1 :, :size].set(jnp.swapaxes(with_additive, 1, 2))
        gram = gram.at[:, size + 1 :, size + 1 :].set(additive_square)
        right = jnp.concatenate(
            [
                over_x[:, None] * jnp.einsum("iaf,ia->if", record.at_x, x)
                + over_F[:, None] * jnp.einsum("iaf,ia->if", law, F),
                (over_x * (inside_x * x).sum(1))[:, None],
                over_F[:, None] * jnp.einsum("iab,ia->ib", additive, F),
            ],
            axis=1,
        )
        reference = jnp.pad(record.reference, ((0, 0), (0, 1 + number)))
        # A scale of 0 fixes its weight at 0, where the reference has it too.
        reference = jnp.where(scale > 0, reference / jnp.where(scale > 0, scale, 1.0), 0.0)
        matrix = jnp.eye(total) + scale[:, :, None] * gram * scale[:, None]
        factor = jnp.linalg.cholesky(matrix)
        squares = over_x * (x**2).sum(1) + over_F * (F**2).sum(1) + (reference**2).sum(1)
        return factor, scale * right - reference, squares, scale

    def standardised(
        self,
    ) -> tuple[Float[Array, "impact value"], Float[Array, "impact value weight"]]:
        """All samples, the force's first, and what a unit of each weight adds to them, over the noise."""
        record, scale = self.record, self._scales()
        one_x, one_F = (jnp.exp(-log)[:, None] for log in (self.log_sigma, self.log_force_sigma))
        law = self.K[:, None, None] * record.at_y + self.C[:, None, None] * record.rate
        inside_x = (jnp.arange(record.x.shape[1]) < record.n_displacements[:, None]) * record.unit[:, :1]
        zero_F, zero_x = jnp.zeros_like(record.y)[..., None], jnp.zeros_like(record.x)[..., None]
        of_F = [law, zero_F, record.inside()[..., None] + 0.0, record.modes]
        of_x = [record.at_x, inside_x[..., None], zero_x, jnp.repeat(zero_x, record.modes.shape[-1], axis=-1)]
        columns = [
            jnp.concatenate(parts, axis=-1) * one[..., None] for parts, one in ((of_F, one_F), (of_x, one_x))
        ]
        values = jnp.concatenate([one_F * record.y, one_x * record.x], axis=1)
        return values, jnp.concatenate(columns, axis=1) * scale[:, None]

    def slopes(self) -> Float[Array, "impact value 2"]:
        """What a unit of log K and of log C adds to all samples over the noise, of the likeliest motion."""
        record, weights = self.record, self.weights()
        functions = weights[:, : record.at_y.shape[-1]]
        over = jnp.exp(-self.log_force_sigma)[:, None]
        of_F = [
            factor[:, None] * over * jnp.einsum("iaf,if->ia", part, functions)
            for factor, part in ((self.K, record.at_y), (self.C, record.rate))
        ]
        return jnp.pad(jnp.stack(of_F, axis=-1), ((0, 0), (0, record.x.shape[1]), (0, 0)))

    def log_density(self) -> Float[Array, " impact"]:
        """Log density of each pair of recordings, the motion and all errors integrated out."""
        factor, right, squares, _ = self._system()
        solved = solve_triangular(factor, right[..., None], lower=True)[..., 0]
        n_x, n_F = self.record.n_displacements, self.record.n_samples
        scale = n_x * (LOG_2PI + 2 * self.log_sigma) + n_F * (LOG_2PI + 2 * self.log_force_sigma)
        log_determinant = 2 * jnp.log(jnp.diagonal(factor, axis1=1, axis2=2)).sum(1)
        density = -(scale + squares - (solved**2).sum(1) + log_determinant) / 2
        return jnp.where(jnp.isfinite(density), density, -jnp.inf)

    def weights(self, key: Array | None = None) -> Float[Array, "impact weight"]:
        """All that is normal given both recordings: a draw, or the mean without a key."""
        factor, right, _, scale = self._system()
        moved = cho_solve((factor, True), right[..., None])[..., 0]
        if key is not None:
            standard = jax.random.normal(key, moved.shape)
            moved += solve_triangular(factor, standard[..., None], lower=True, trans=1)[..., 0]
        number = self.record.modes.shape[-1]
        return jnp.pad(self.record.reference, ((0, 0), (0, 1 + number))) + scale * moved

    def depth(self, weights: Float[Array, "impact weight"]) -> Float[Array, "impact row"]:
        """The motion x at the force's samples [m]."""
        size = self.record.at_y.shape[-1]
        return jnp.einsum("iaf,if->ia", self.record.at_y, weights[:, :size])

    def force(self, weights: Float[Array, "impact weight"]) -> Float[Array, "impact row"]:
        """What the force's samples would be without noise: the law's, the zero and what is beside [N]."""
        record = self.record
        size = record.at_y.shape[-1]
        law = self.K[:, None, None] * record.at_y + self.C[:, None, None] * record.rate
        law_force = jnp.einsum("iaf,if->ia", law, weights[:, :size])
        discrepancy = jnp.einsum("iab,ib->ia", record.modes, weights[:, size + 2 :])
        return law_force + jnp.where(record.inside(), weights[:, size + 1, None], 0.0) + discrepancy

    def secant(self, weights: Float[Array, "impact weight"]) -> Float[Array, " impact"]:
        """Force over depth, without noise and zero, at the sample where depth is greatest [N/m]."""
        depth = self.depth(weights)
        deepest = depth.argmax(1)[:, None]
        force = self.force(weights) - weights[:, self.record.at_y.shape[-1] + 1, None]
        at = [jnp.take_along_axis(values, deepest, axis=1)[:, 0] for values in (force, depth)]
        return at[0] / at[1]

    def displacement(self, weights: Float[Array, "impact weight"]) -> Float[Array, "impact sample"]:
        """The same of the displacement's samples: x and the level [m]."""
        record = self.record
        size = record.at_x.shape[-1]
        inside = jnp.arange(record.x.shape[1]) < record.n_displacements[:, None]
        level = jnp.where(inside, record.unit[:, :1] * weights[:, size, None], 0.0)
        return level + jnp.einsum("iaf,if->ia", record.at_x, weights[:, :size])

    def draw_errors(self, key: Array) -> Float[Array, "impact 2"]:
        """Depth at contact [m] and the force's zero [N] given the recordings."""
        weights, size = self.weights(key), self.record.at_x.shape[-1]
        return jnp.stack([weights[:, 0] * self.record.unit[:, 0], weights[:, size + 1]], axis=1)

    def prior_errors(self, key: Array) -> Float[Array, "impact 2"]:
        """The same before anything is recorded."""
        return self.record.error_sd * jax.random.normal(key, self.record.error_sd.shape)

    def noise_quantities(self) -> dict[str, Float[Array, " impact"]]:
        """What the noise of each channel is, by the names that posteriors have."""
        return {"sigma_x": jnp.exp(self.log_sigma), "sigma_F": jnp.exp(self.log_force_sigma)}

    def sample(self, key: Array) -> Float[Array, "impact row"]:
        """Draw forces: of a motion that the recordings allow, with noise."""
        noise = jax.random.normal(jax.random.fold_in(key, 1), self.record.y.shape)
        drawn = self.force(self.weights(key)) + jnp.exp(self.log_force_sigma)[:, None] * noise
        return jnp.where(self.record.inside(), drawn, 0.0)

    def replicate(self, key: Array) -> dict[str, Float[Array, "impact row"]]:
        """A replicate of every force [N]; NaN past its end."""
        return {"force": jnp.where(self.record.inside(), self.sample(key), jnp.nan)}
