"""Displacement and force of tissue that something pushes: its law from force over depth, without a mass.

x(t) is a smooth motion of unknown shape (`bayestissue.likelihood.driven.motion`), measured by

    y_k = x(t_k) + level + e_k,                 e_k ~ N(0, s_x^2),
    F_k = law(x, x')(t_k) + delta(t_k) + zero + n_k,         n_k ~ N(0, s_F^2),

the law being an element's: K x + C x' of a spring and damper. x is counted from contact: x(0) is as small as
contact is sure, and what the sensor reads there, the level, is not known. delta is a smooth force beside the
element, where the model has one. All but the law's parameters and the standard deviations is normal, and is
integrated out: noise of the displacement is carried into the force by the law itself (regression with errors
in both variables; Fuller, Measurement Error Models, chapter 1, where what varies is known to be smooth).

Contact is where the force begins. Where the force's clock is late by l, the displacement's samples are of
x(t_k + l).

A linear law keeps all of it normal, and the integral is exact. Another law is taken as straight about the
motion that is likeliest given both recordings, found by `_STEPS` of Gauss and Newton from the one that the
displacements show: Laplace's approximation. The bend of a law over what is not known of the motion is left
out: of stiffening tissue at most 0.02 of a log density, of Hunt and Crossley's, bent most at contact, 0.05.

With z all that is normal in units of its standard deviation, the rows have A z in them besides noise: with
M = 1 + A'A and h = A'r, A and r over the noise,

    log p(y, F) = -(r'r - h' M^-1 h + log det M) / 2 - n_x log s_x - n_F log s_F + constant .

That is not yet the density. A force alone can say nothing of the law: any force is that of some motion. But
p(F) says that the motion which the law makes of F is smooth, and where a displacement is noisy that would
count for more than the displacement does: of 24 intervals of K as few as 5 held. So only p(y | F) is the
law's, and the force by itself is that of a spring and damper which are fixed beforehand:

    log p = log p(y, F) - log p(F) + log p_0(F) .

Rows are taken less a motion at hand, so that r is small where the law is right and no digits are lost.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.scipy.linalg import cho_solve, solve_triangular
from jaxtyping import Bool, Float, Int

from bayestissue.elements import Element
from bayestissue.elements.outcomes import greatest, tangent_stiffness
from bayestissue.elements.path import internal_lengths
from bayestissue.likelihood.driven import motion
from bayestissue.likelihood.element.noise import discrepancy_modes
from bayestissue.likelihood.linear_errors import LOG_2PI
from bayestissue.padding import padded_zeros

# Of a_1 and a_2 and of the level, over the greatest displacement: next to nothing is known of them.
_WIDE = 30.0
# Of a motion at hand: how rough, and how exact its samples are taken to be, over the greatest displacement.
_ROUGH, _EXACT = 30.0, 1e-3
# The softer the presumed law, the larger and the rougher the motion that it makes of the force. With 1 a
# motion was taken for smoother than it is, and greatest forces missed by several standard errors.
_SOFT = 16.0
# Of the greatest over the smallest diagonal entry of a factor, beyond which its matrix has no digits left:
# where K is a million times too great.
_RESOLVED = 1e10
# To the likeliest motion under a law that is not linear.
_STEPS = 1


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
        at_x: of the displacement's samples the motion's functions and the level's 1, times the greatest
            displacement, where both clocks are one [m].
        clock_sd: standard deviation of what the force's clock is late [s]; 0 where both clocks are one.
        window: from contact to the last sample of both [s], the motion's unit of time.
        at_y: of the force's samples the functions likewise.
        rate: of the force's samples their slopes [m/s].
        beside: of the force's samples its zero's 1 and, where there is a force beside the element's, its
            modes, times the greatest force [N].
        reference: weights of a motion that the displacements show, and the level.
        presumed: K [N/m] and C [N s/m] of the spring and damper that the force by itself is taken to be of:
            greatest force over greatest displacement, by `_SOFT`, and that times the window.
        surroundings: what an element's functions take beside its parameters, by name.
        common_depth: one depth that every impact reaches [m]; no part of the likelihood.
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
    clock_sd: Float[Array, " impact"]
    window: Float[Array, " impact"]
    at_x: Float[Array, "impact sample function_and_level"]
    at_y: Float[Array, "impact row function"]
    rate: Float[Array, "impact row function"]
    beside: Float[Array, "impact row zero_and_mode"]
    reference: Float[Array, "impact weight"]
    presumed: Float[Array, "impact 2"]
    surroundings: dict[str, Float[Array, " impact"]]
    common_depth: Float[Array, " impact"]

    @property
    def traces(self) -> Float[Array, "impact row"]:
        """The recorded forces."""
        return self.y

    @property
    def side_by_side(self) -> bool:
        """Whether nothing in it speaks against a spring and damper side by side alone."""
        return True

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
        return record.made_of(traces, n_samples, record.x, np.clip(most, 1, record.n_displacements))

    def with_channels(
        self, x: Float[np.ndarray, "impact sample"], y: Float[np.ndarray, "impact row"]
    ) -> DrivenRecord:
        """The record of other displacements and forces at the same times."""
        record = jax.tree.map(np.asarray, self)
        of_both = y[:, : record.y.shape[1]], record.n_samples, x[:, : record.x.shape[1]]
        return record.made_of(*of_both, record.n_displacements, unit=record.unit)

    def made_of(
        self, y: np.ndarray, n_y: np.ndarray, x: np.ndarray, n_x: np.ndarray, unit: np.ndarray | None = None
    ) -> DrivenRecord:
        """The record of these forces and displacements, all else being the same."""
        same: Any = jax.tree.map(np.asarray, self)
        made = driven_record(
            (y, n_y, same.first_time, same.dt),
            (x, n_x, same.first_displacement, same.dt_displacement),
            same.error_sd,
            clock_sd=same.clock_sd,
            discrepancy=self.beside.shape[-1] > 1,
            surroundings=same.surroundings,
            common_depth=same.common_depth,
            unit=unit,
        )
        return made._replace(presumed=self.presumed)

    def of_forces_alone(self) -> DrivenRecord:
        """The record without its displacements."""
        none = jnp.zeros_like(self.n_displacements)
        return self._replace(x=self.x[:, :0], at_x=self.at_x[:, :0], n_displacements=none)

    def impacts(self, rows: Int[np.ndarray, " row"]) -> DrivenRecord:
        """The record of some impacts."""
        chosen: DrivenRecord = jax.tree.map(lambda leaf: np.asarray(leaf)[rows], self)
        return chosen

    def padded(self) -> DrivenRecord:
        """With as many samples, 0 past a row's end, as a `bucket` holds."""
        names = ("y", "x", "at_x", "at_y", "rate", "beside")
        return self._replace(**{name: padded_zeros(getattr(self, name), 1) for name in names})

    def with_normal_errors(self) -> DrivenRecord:
        """The record itself, whose errors are normal."""
        return self


Channel = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


def driven_record(
    force: Channel,
    displacement: Channel,
    error_sd: Float[np.ndarray, "impact 2"],
    *,
    clock_sd: Float[np.ndarray, " impact"],
    discrepancy: bool,
    surroundings: dict[str, Float[np.ndarray, " impact"]],
    common_depth: Float[np.ndarray, " impact"],
    unit: Float[np.ndarray, "impact 2"] | None = None,
) -> DrivenRecord:
    """The record of forces and displacements, with all that does not depend on a parameter.

    Args:
        force: values [impact, row] in N, their number, the time from contact to the first, and the interval.
        displacement: the same of displacements, in m.
        error_sd: see `DrivenRecord`.
        clock_sd: likewise.
        discrepancy: whether there is a force beside the element's.
        surroundings: see `DrivenRecord`.
        common_depth: likewise.
        unit: likewise, if not of these channels.
    """
    rows, samples = _grid(*force), _grid(*displacement)
    last = np.maximum(*((time * inside).max(axis=1) for time, inside in (rows, samples)))[:, None]
    (y, n_y, *_), (x, n_x, *_) = force, displacement
    y, x = np.where(rows[1], y, 0.0), np.where(samples[1], x, 0.0)
    if unit is None:
        unit = np.stack([np.abs(x).max(axis=1), np.abs(y).max(axis=1)], axis=1)
    depth = unit[:, :1, None]
    at_y, rate = (
        np.where(rows[1][..., None], depth * part, 0.0) for part in motion.functions(rows[0] / last)
    )
    rate = rate / last[..., None]
    of_motion = motion.functions(samples[0] / last)[0]
    at_x = np.concatenate([of_motion, np.ones((*x.shape, 1))], axis=-1)
    at_x = np.where(samples[1][..., None], depth * at_x, 0.0)
    beside = rows[1][..., None] + 0.0
    if discrepancy:
        smooth = discrepancy_modes(n_y, np.broadcast_to(np.arange(y.shape[1]) + 0.0, y.shape))
        basis, share = map(np.asarray, smooth)
        modes = unit[:, 1:, None] * np.swapaxes(basis * np.sqrt(share)[..., None], 1, 2)
        beside = np.concatenate([beside, modes], axis=-1)
    channels = y, n_y, *force[2:], x, n_x, *displacement[2:]
    reference = _reference(at_x, x, unit[:, 0])
    stiffness = unit[:, 1] / unit[:, 0] / _SOFT
    presumed = np.stack([stiffness, stiffness * last[:, 0]], axis=1)
    parts: Any = (*channels, error_sd, unit, clock_sd, last[:, 0], at_x, at_y, rate, beside)
    parts += (reference, presumed, surroundings, common_depth)
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
    at_x: Float[np.ndarray, "impact sample function_and_level"],
    x: Float[np.ndarray, "impact sample"],
    depth: Float[np.ndarray, " impact"],
) -> Float[np.ndarray, "impact weight"]:
    """Weights of the functions and the level, by ridge regression: 0 at contact."""
    columns = at_x[..., 1:]
    sd = np.full(columns.shape[-1], _ROUGH)
    matrix = np.einsum("iaf,iag->ifg", columns, columns) / (_EXACT * depth[:, None, None]) ** 2
    right = np.einsum("iaf,ia->if", columns, x) / (_EXACT * depth[:, None]) ** 2
    weights = np.linalg.solve(matrix + np.diag(sd**-2.0), right[..., None])[..., 0]
    return np.concatenate([np.zeros((len(x), 1)), weights], axis=1)


def _integral(
    at_contact: Float[Array, "impact 1"],
    values: Float[Array, "impact row"],
    since: Float[Array, "impact 1"],
    dt: Float[Array, "impact 1"],
) -> Float[Array, "impact row"]:
    """From contact to each sample: a parabola to the first, then trapezia with Euler and Maclaurin's term.

    A damper takes most of its energy just after contact. Of v^2 that falls to a third within three samples
    trapezia alone make one part in a hundred too much, these a few in ten thousand.

    Args:
        at_contact: of what is integrated.
        values: the same at the samples.
        since: from contact to the first of them [s].
        dt: between them [s].
    """
    backwards = 3 * values[:, 2:] - 4 * values[:, 1:-1] + values[:, :-2]
    rise = (4 * values[:, 1:2] - 3 * values[:, :1] - values[:, 2:3]) / (2 * dt)
    slope = jnp.concatenate([rise, rise, backwards / (2 * dt)], axis=1)
    to_first = since * (at_contact + 2 * values[:, :1]) / 3 - since**2 * rise / 6
    steps = jnp.cumsum((values[:, 1:] + values[:, :-1]) / 2 * dt, axis=1)
    trapezia = jnp.concatenate([jnp.zeros_like(dt), steps], axis=1)
    return to_first + trapezia - dt**2 / 12 * (slope - rise)


class Expansion(NamedTuple):
    """A law taken as straight about one motion.

    Attributes:
        at: all that is normal there: the functions' weights, the level's, the zero's and the modes'.
        force: the law's force of that motion [N].
        law: what a unit of each function's weight adds to it [N].
    """

    at: Float[Array, "impact weight"]
    force: Float[Array, "impact row"]
    law: Float[Array, "impact row function"]


class DrivenOutcomes(NamedTuple):
    """What an impact comes to by its motion and its law, as `bayestissue.elements.Outcomes` names it.

    There is neither a mass nor an end of contact. All is of the recorded window, which ends at the greatest
    depth unless the model file has another.

    Attributes:
        K_tangent: slope of the force with penetration at contact, a damper's own left out [N/m].
        K_secant: force over penetration at the greatest penetration [N/m].
        C_equivalent: of the damper that would have taken as much energy up to there [N s/m].
        peak_force: force at the moment when that of the likeliest motion is greatest, or at contact, where a
            strong damper's is greater [N]. A drawn motion is rougher than tissue, and its own greatest force
            too great.
        peak_depth: greatest penetration [m].
        time_to_peak: from contact to it [s].
        energy_absorbed: taken up by the tissue within the window and not stored at its end [J].
    """

    K_tangent: Float[Array, " impact"]
    K_secant: Float[Array, " impact"]
    C_equivalent: Float[Array, " impact"]
    peak_force: Float[Array, " impact"]
    peak_depth: Float[Array, " impact"]
    time_to_peak: Float[Array, " impact"]
    energy_absorbed: Float[Array, " impact"]

    def scaled(self, log_depth: Array, log_force: Array) -> DrivenOutcomes:
        """Of depths and forces that are so many times larger, given as logs."""
        depth, force = jnp.exp(log_depth), jnp.exp(log_force)
        stiffness = {name: getattr(self, name) * force / depth for name in self._fields[:3]}
        return self._replace(
            **stiffness,
            peak_force=self.peak_force * force,
            peak_depth=self.peak_depth * depth,
            energy_absorbed=self.energy_absorbed * force * depth,
        )


@partial(
    jax.tree_util.register_dataclass,
    data_fields=[
        *("parameters", "log_sigma", "log_force_sigma", "log_roughness", "clock", "log_discrepancy", "record")
    ],
    meta_fields=["element"],
)
@dataclass(frozen=True)
class MeasuredDriven:
    """The likelihood of displacements and forces, the motion and the chain's errors integrated out.

    Attributes:
        element: what is pressed; linear, or one that remembers nothing.
        parameters: its own, in its order.
        log_sigma: log of the standard deviation of a displacement's noise [m].
        log_force_sigma: of a force's [N].
        log_roughness: log of s over the greatest displacement.
        clock: what the force is late, over its standard deviation; None where both clocks are one.
        log_discrepancy: of the rms of the force beside the element's, over the greatest force; None without.
        record: see `driven_record`.
    """

    element: Element
    parameters: Float[Array, "parameter impact"]
    log_sigma: Float[Array, " impact"]
    log_force_sigma: Float[Array, " impact"]
    log_roughness: Float[Array, " impact"]
    clock: Float[Array, " impact"] | None
    log_discrepancy: Float[Array, " impact"] | None
    record: DrivenRecord

    def _arguments(self, parameters: Float[Array, "parameter impact"]) -> dict[str, Float[Array, "impact 1"]]:
        """What the element's functions take besides the motion."""
        names = (one.name for one in self.element.parameters)
        by_name = dict(zip(names, parameters, strict=True)) | self.record.surroundings
        return {name: value[:, None] for name, value in by_name.items()}

    def _at_x(self) -> Float[Array, "impact sample function_and_level"]:
        """What a unit of each function's weight and of the level adds to the displacement's samples [m]."""
        record, index = self.record, jnp.arange(self.record.x.shape[1])
        if self.clock is None:
            return record.at_x
        begin = record.first_displacement + self.clock * record.clock_sd
        t = (begin[:, None] + index * record.dt_displacement[:, None]) / record.window[:, None]
        inside = (index < record.n_displacements[:, None])[..., None]
        level = jnp.ones((*t.shape, 1))
        columns = jnp.concatenate([motion.interpolated(t), level], axis=-1)
        return jnp.where(inside, record.unit[:, :1, None] * columns, 0.0)

    def _path(self, functions: Float[Array, "impact function"]) -> tuple[Array, Array]:
        """Depth and rate at the force's samples."""
        record = self.record
        x, v = (jnp.einsum("iaf,if->ia", part, functions) for part in (record.at_y, record.rate))
        return x, v

    def _lengths(self, p: dict[str, Array], x: Array, v: Array) -> tuple[Array, ...]:
        return internal_lengths(self.element, p, x, v, self.record.first_time, self.record.dt)

    def _law(
        self, x: Array, v: Array, parameters: Float[Array, "parameter impact"] | None = None
    ) -> Float[Array, "impact row"]:
        """The element's force along a motion [N]."""
        p = self._arguments(self.parameters if parameters is None else parameters)
        force = self.element.force(x, v, self._lengths(p, x, v), p)
        return jnp.where(self.record.inside(), force, 0.0)

    def _expanded(self, weights: Float[Array, "impact weight"]) -> Expansion:
        """The law about a motion."""
        record = self.record
        path = self._path(weights[:, : record.at_y.shape[-1]])
        force, along = jax.linearize(self._law, *path)
        return Expansion(weights, force, jax.vmap(along, -1, -1)(record.at_y, record.rate))

    @property
    def shown(self) -> Float[Array, "impact weight"]:
        """Of the motion that the displacements show, whatever the force is."""
        return jnp.pad(self.record.reference, ((0, 0), (0, self.record.beside.shape[-1])))

    def _expansion(self) -> Expansion:
        """The law about the likeliest motion; a linear one is the same about any."""
        weights = self.shown
        for _ in range(0 if self.element.linear else _STEPS):
            weights = self._weights(self._expanded(weights))
        return self._expanded(weights)

    def _scales(self) -> Float[Array, "impact weight"]:
        """Standard deviations of the weights: of the functions, the level, the zero and the modes."""
        record = self.record
        size, number = record.at_y.shape[-1], record.beside.shape[-1] - 1
        one = jnp.ones_like(self.log_sigma)[:, None]
        depth = record.unit[:, :1]
        rough = jnp.exp(self.log_roughness)[:, None] * jnp.ones(size - motion.POWERS)
        parts = [record.error_sd[:, :1] / depth, _WIDE * one, _WIDE * one, rough, _WIDE * one]
        parts.append(record.error_sd[:, 1:])
        if self.log_discrepancy is not None:
            parts.append(jnp.exp(self.log_discrepancy)[:, None] * jnp.ones(number))
        return jnp.concatenate(parts, axis=1)

    def _columns(self, law: Expansion) -> Float[Array, "impact row weight"]:
        """What a unit of each weight adds to the force's samples [N]; of the level nothing."""
        record = self.record
        return jnp.concatenate([law.law, jnp.zeros_like(record.beside[..., :1]), record.beside], axis=-1)

    def _system(self, law: Expansion) -> tuple[Array, Array, Array]:
        """M's factor, how far the likeliest weights are from the expansion's, over the scales, and these."""
        record, scale, columns = self.record, self._scales(), self._columns(law)
        over_x, over_F = jnp.exp(-2 * self.log_sigma), jnp.exp(-2 * self.log_force_sigma)
        x = record.x - self.displacement(law.at)
        F = record.y - law.force - self._beside(law.at)
        n_force_columns = columns.shape[-1] - record.at_x.shape[-1]
        at_x = self._at_x()
        squares = jnp.einsum("iaf,iag->ifg", at_x, at_x)
        of_x = jnp.pad(squares, ((0, 0), (0, n_force_columns), (0, n_force_columns)))
        right_x = jnp.pad(jnp.einsum("iaw,ia->iw", at_x, x), ((0, 0), (0, n_force_columns)))
        of_F = jnp.einsum("iaw,iaz->iwz", columns, columns)
        gram = over_x[:, None, None] * of_x + over_F[:, None, None] * of_F
        right = over_x[:, None] * right_x + over_F[:, None] * jnp.einsum("iaw,ia->iw", columns, F)
        # A scale of 0 fixes its weight at 0, where the expansion has it too.
        at = jnp.where(scale > 0, law.at / jnp.where(scale > 0, scale, 1.0), 0.0)
        matrix = jnp.eye(columns.shape[-1]) + scale[:, :, None] * gram * scale[:, None]
        factor = jnp.linalg.cholesky(matrix)
        moved = cho_solve((factor, True), (scale * right - at)[..., None])[..., 0]
        return factor, moved, scale

    def _squares(
        self, law: Expansion, moved: Float[Array, "impact weight"], scale: Float[Array, "impact weight"]
    ) -> Float[Array, " impact"]:
        """What the likeliest weights leave over, squared, and these weights squared: r'r - h'M^-1 h.

        Where K is far too great that difference is lost among the digits, and a density made of it may be
        anything; weights that are rounded only leave over more.
        """
        record, weights = self.record, scale * moved
        x = record.x - self.displacement(law.at + weights)
        F = (
            record.y
            - law.force
            - self._beside(law.at)
            - jnp.einsum("iaw,iw->ia", self._columns(law), weights)
        )
        standard = jnp.where(scale > 0, law.at / jnp.where(scale > 0, scale, 1.0), 0.0) + moved
        of_x, of_F = jnp.exp(-2 * self.log_sigma), jnp.exp(-2 * self.log_force_sigma)
        return of_x * (x**2).sum(1) + of_F * (F**2).sum(1) + (standard**2).sum(1)

    def _beside(self, weights: Float[Array, "impact weight"]) -> Float[Array, "impact row"]:
        """The force's zero and the force beside the element's [N]."""
        return jnp.einsum("iab,ib->ia", self.record.beside, weights[:, self.record.at_x.shape[-1] :])

    def standardised(
        self,
    ) -> tuple[Float[Array, "impact value"], Float[Array, "impact value weight"]]:
        """All samples, the force's first, and what a unit of each weight adds to them, over the noise.

        Of a law that is taken as straight the force's samples are less what the straight law is at no depth.
        """
        record, scale, law = self.record, self._scales(), self._expansion()
        one_x, one_F = (jnp.exp(-log)[:, None] for log in (self.log_sigma, self.log_force_sigma))
        of_F = self._columns(law) * one_F[..., None]
        n_force_columns = of_F.shape[-1] - record.at_x.shape[-1]
        of_x = jnp.pad(self._at_x() * one_x[..., None], ((0, 0), (0, 0), (0, n_force_columns)))
        bent = law.force - jnp.einsum("iaf,if->ia", law.law, law.at[:, : law.law.shape[-1]])
        values = jnp.concatenate([one_F * (record.y - bent), one_x * record.x], axis=1)
        return values, jnp.concatenate([of_F, of_x], axis=1) * scale[:, None]

    def slopes(self) -> Float[Array, "impact value parameter"]:
        """What a unit of each parameter's log adds to all samples over the noise, of the likeliest motion.

        A standard deviation of the clock comes last, if that is not known.
        """
        record, logs = self.record, jnp.log(self.parameters)
        weights = self.weights()
        path = self._path(weights[:, : record.at_y.shape[-1]])
        _, along = jax.linearize(lambda logs: self._law(*path, jnp.exp(logs)), logs)
        units = jnp.broadcast_to(jnp.eye(len(logs))[..., None], (len(logs), *logs.shape))
        of_F = jax.vmap(along, out_axes=-1)(units) * jnp.exp(-self.log_force_sigma)[:, None, None]
        slopes = jnp.pad(of_F, ((0, 0), (0, record.x.shape[1]), (0, 0)))
        if self.clock is None:
            return slopes

        def displacement(clock: Array) -> Array:
            return replace(self, clock=clock).displacement(weights)

        _, moved = jax.jvp(displacement, (self.clock,), (jnp.ones_like(self.clock),))
        of_x = jnp.pad(moved * jnp.exp(-self.log_sigma)[:, None], ((0, 0), (record.y.shape[1], 0)))
        return jnp.concatenate([slopes, of_x[..., None]], axis=-1)

    def log_density(self) -> Float[Array, " impact"]:
        """Log density of each pair of recordings, the motion and all errors integrated out.

        Of the displacement given the force by the element's law, and of the force by a presumed one.
        """
        law, of_forces = self._expansion(), replace(self, record=self.record.of_forces_alone())
        density = self._density(law) - of_forces._density(law) + of_forces._density(self._presumed())
        return jnp.where(jnp.isfinite(density), density, -jnp.inf)

    def joint_log_density(self) -> Float[Array, " impact"]:
        """Log p(y, F): of each pair of recordings, the force too being the element's."""
        return self._density(self._expansion())

    def _presumed(self) -> Expansion:
        """The law that the force by itself is taken to be of."""
        record, (K, C) = self.record, self.record.presumed.T
        law = K[:, None, None] * record.at_y + C[:, None, None] * record.rate
        force = jnp.einsum("iaf,if->ia", law, self.shown[:, : law.shape[-1]])
        return Expansion(self.shown, force, law)

    def _density(self, law: Expansion) -> Float[Array, " impact"]:
        """Log density of all rows of the record under a law; minus infinity where rounding hides it."""
        factor, moved, scale = self._system(law)
        n_x, n_F = self.record.n_displacements, self.record.n_samples
        constant = n_x * (LOG_2PI + 2 * self.log_sigma) + n_F * (LOG_2PI + 2 * self.log_force_sigma)
        diagonal = jnp.diagonal(factor, axis1=1, axis2=2)
        log_determinant = 2 * jnp.log(diagonal).sum(1)
        density = -(constant + self._squares(law, moved, scale) + log_determinant) / 2
        return jnp.where(diagonal.max(1) < _RESOLVED * diagonal.min(1), density, -jnp.inf)

    def weights(self, key: Array | None = None) -> Float[Array, "impact weight"]:
        """All that is normal given both recordings: a draw, or the mean without a key."""
        return self._weights(self._expansion(), key)

    def _weights(self, law: Expansion, key: Array | None = None) -> Float[Array, "impact weight"]:
        factor, moved, scale = self._system(law)
        if key is not None:
            standard = jax.random.normal(key, moved.shape)
            moved += solve_triangular(factor, standard[..., None], lower=True, trans=1)[..., 0]
        return law.at + scale * moved

    def depth(self, weights: Float[Array, "impact weight"]) -> Float[Array, "impact row"]:
        """The motion x at the force's samples [m]."""
        return self._path(weights[:, : self.record.at_y.shape[-1]])[0]

    def tissue_force(self, weights: Float[Array, "impact weight"]) -> Float[Array, "impact row"]:
        """The law's force and what is beside it, without the zero [N]."""
        size = self.record.at_y.shape[-1]
        return self._law(*self._path(weights[:, :size])) + self._beside_element(weights)

    def _beside_element(self, weights: Float[Array, "impact weight"]) -> Float[Array, "impact row"]:
        """The force beside the element's alone [N]."""
        return self._beside(weights.at[:, self.record.at_x.shape[-1]].set(0.0))

    def _contact(
        self, weights: Float[Array, "impact weight"]
    ) -> tuple[Float[Array, "impact 1"], Float[Array, "impact 1"], Float[Array, "impact 1"]]:
        """How long before time 0 x began [s], by the motion's parabola, its rate and the force then.

        A damper's force is there at once. What is beside the element's is that of the first sample.
        """
        record, window = self.record, self.record.window[:, None]
        x_0, v_0, bend = (
            record.unit[:, :1] * weights[:, k : k + 1] / window**k for k in range(motion.POWERS)
        )
        back = jnp.where(v_0 > 0, x_0 / jnp.where(v_0 > 0, v_0, 1.0), 0.0)
        speed, still = v_0 - 2 * bend * back, jnp.zeros_like(v_0)
        inner = (still,) * self.element.states
        force = self.element.force(still, speed, inner, self._arguments(self.parameters))
        return back, speed, force + self._beside_element(weights)[:, :1]

    def force(self, weights: Float[Array, "impact weight"]) -> Float[Array, "impact row"]:
        """What the force's samples would be without noise: the law's, the zero and what is beside [N]."""
        return self._law(*self._path(weights[:, : self.record.at_y.shape[-1]])) + self._beside(weights)

    def outcomes(self, weights: Float[Array, "impact weight"]) -> DrivenOutcomes:
        """What each impact comes to by this motion.

        Moments between samples are those of a straight rate: of a pulse of thirty samples they err by a few
        parts in ten thousand.
        """
        record, element = self.record, self.element
        inside, dt = record.inside(), record.dt[:, None]
        (x, v), force = self._path(weights[:, : record.at_y.shape[-1]]), self.tissue_force(weights)
        back, speed, at_contact = self._contact(weights)
        time = record.first_time[:, None] + jnp.arange(x.shape[1]) * dt
        deepest = jnp.where(inside, x, -jnp.inf).argmax(1)[:, None]
        last = record.n_samples[:, None] - 1

        def at(values: Array, index: Array = deepest) -> Array:
            return jnp.take_along_axis(values, index, axis=1)

        # Beyond the end as before it: no parabola through the last sample.
        likeliest = self.tissue_force(self.weights())
        likeliest = jnp.where(inside, likeliest, at(likeliest, jnp.maximum(last - 1, 0)))
        later_force = at(force, likeliest.argmax(1)[:, None])[:, 0] + greatest(likeliest) - likeliest.max(1)
        slows = at(v, jnp.maximum(deepest - 1, 0)) - at(v)
        later = jnp.where(slows > 0, at(v) * dt / jnp.where(slows > 0, slows, 1.0), 0.0)
        later = jnp.clip(later, -dt, dt)
        depth = at(x) + later * at(v) / 2
        p = self._arguments(self.parameters)
        lengths = self._lengths(p, x, v)
        since = record.first_time[:, None] + back
        work = _integral(at_contact * speed, force * v, since, dt)
        squares = _integral(speed**2, v**2, since, dt)
        lost = work - element.stored(x, v, lengths, p)
        if self.log_discrepancy is None:
            of_peak = element.force(depth, jnp.zeros_like(depth), tuple(at(part) for part in lengths), p)
        else:
            of_peak = at(force)
        return DrivenOutcomes(
            K_tangent=tangent_stiffness(element, {name: value[:, 0] for name, value in p.items()}),
            K_secant=(of_peak / depth)[:, 0],
            C_equivalent=(at(lost) / at(squares))[:, 0],
            peak_force=jnp.maximum(at_contact[:, 0], later_force),
            peak_depth=depth[:, 0],
            time_to_peak=(at(time) + later)[:, 0],
            energy_absorbed=at(lost, last)[:, 0],
        )

    def displacement(self, weights: Float[Array, "impact weight"]) -> Float[Array, "impact sample"]:
        """What the displacement's samples would be without noise: x and the level [m]."""
        return jnp.einsum("iaf,if->ia", self._at_x(), weights[:, : self.record.at_x.shape[-1]])

    def draw_errors(self, key: Array) -> Float[Array, "impact 2"]:
        """Depth at contact [m] and the force's zero [N] given the recordings."""
        return self.errors_of(self.weights(key))

    def errors_of(self, weights: Float[Array, "impact weight"]) -> Float[Array, "impact 2"]:
        """The same of one motion."""
        zero = weights[:, self.record.at_x.shape[-1]]
        return jnp.stack([weights[:, 0] * self.record.unit[:, 0], zero], axis=1)

    def prior_errors(self, key: Array) -> Float[Array, "impact 2"]:
        """The same before anything is recorded."""
        return self.record.error_sd * jax.random.normal(key, self.record.error_sd.shape)

    def noise_quantities(self) -> dict[str, Float[Array, " impact"]]:
        """What the noise of each channel is, by the names that posteriors have."""
        noise = {"sigma_x": jnp.exp(self.log_sigma), "sigma_F": jnp.exp(self.log_force_sigma)}
        if self.clock is None:
            return noise
        return noise | {"force_clock_error": self.clock * self.record.clock_sd}

    def sample(self, key: Array) -> Float[Array, "impact row"]:
        """Draw forces: of a motion that the recordings allow, with noise."""
        noise = jax.random.normal(jax.random.fold_in(key, 1), self.record.y.shape)
        drawn = self.force(self.weights(key)) + jnp.exp(self.log_force_sigma)[:, None] * noise
        return jnp.where(self.record.inside(), drawn, 0.0)

    def replicate(self, key: Array) -> dict[str, Float[Array, "impact row"]]:
        """A replicate of every force [N]; NaN past its end."""
        return {"force": jnp.where(self.record.inside(), self.sample(key), jnp.nan)}
