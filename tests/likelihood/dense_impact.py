"""The likelihood of recorded impacts written a second time: dense normals of all samples.

Motions are solved by scipy, filtered on a fine grid, and differentiated by differences. Nothing is read but
what was declared and recorded.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import block_diag, eigh, toeplitz
from scipy.special import logsumexp
from scipy.stats import multivariate_normal, norm

from bayestissue.mechanics.elements.element import GRAVITY
from bayestissue.model.likelihood.impact import MeasuredImpact
from bayestissue.model.likelihood.record import Contact, DecelerationRecord
from bayestissue.recordings.dataset.dataset_file import LowPassFilter
from bayestissue.recordings.signal.filters import autocorrelation, on_even_grid
from tissues import Path, path

# A filter's grid has so many steps in a sampling interval, and so many intervals on either side of contact.
FINER, LONG = 200, 160


def record_of(
    d: np.ndarray,
    first: Any,
    dt: Any,
    velocity: Any,
    *,
    error_sd: Any = (0.0, 0.0, 0.0, 0.0),
    mass: Any = 1.0,
    count: Any = None,
    contact: Contact | None = None,
    gravity: Any = None,
    **further: Any,
) -> DecelerationRecord:
    """A record in which a number is every impact's, all samples count and contact is known."""
    every = np.ones(len(d))
    record = DecelerationRecord.from_arrays(
        d,
        np.broadcast_to(d.shape[1] if count is None else count, len(d)),
        first * every,
        dt * every,
        velocity * every,
        np.broadcast_to(error_sd, (len(d), np.shape(error_sd)[-1])),
        mass * every,
        {"diameter_m": 0.0318 * every} | ({} if gravity is None else {GRAVITY: gravity * every}),
        Contact.known(every < 0) if contact is None else contact,
    )
    return record._replace(**further)


@dataclass(frozen=True)
class Recorded:
    """Recorded impacts and what was declared of their recorder, for the deceleration and a force beside it.

    Attributes:
        measured: the impacts at the parameters that are asked about.
        recorders: the filters that the channels went through.
        white: the part of each channel's noise that went through none.
        quiet_sd: of the noise in a quiet part that the samples before the first are relative to.
    """

    measured: MeasuredImpact
    recorders: tuple[LowPassFilter | None, LowPassFilter | None] = (None, None)
    white: tuple[float, float] = (1.0, 1.0)
    quiet_sd: float | None = None

    def tissue(self, row: int) -> dict[str, float]:
        """Its parameters by name."""
        given = np.asarray(self.measured.parameters)[:, row]
        names = (each.name for each in self.measured.element.parameters)
        return dict(zip(names, map(float, given), strict=True))


class Normal(NamedTuple):
    """All samples of an impact for one moment of contact: mean, errors' columns, discrepancy and noise.

    Attributes:
        columns: what an error of one unit adds, of all errors of the chain; contact later is the last.
        discrepancy, noise: covariances.
    """

    seen: np.ndarray
    mean: np.ndarray
    columns: np.ndarray
    discrepancy: np.ndarray
    noise: np.ndarray


Reading = Callable[[np.ndarray], np.ndarray]


def reading(of: Path, recorder: LowPassFilter | None, dt: float) -> Reading:
    """At even times since contact; 0 before it and, behind a filter, once nothing pushes any more."""
    if recorder is None:
        return lambda time: np.where(time < 0, 0.0, of.deceleration(np.maximum(time, 0.0)))

    def pushing(time: np.ndarray) -> np.ndarray:
        d = np.where(time < 0, 0.0, of.deceleration(np.maximum(time, 0.0)))
        return np.where(np.logical_and.accumulate((d > 0) | (time <= 0)), d, 0.0)

    def of_samples(time: np.ndarray) -> np.ndarray:
        grid = time[0] + dt * np.arange(-LONG, LONG)
        return on_even_grid(pushing(grid)[None], 1 / dt, recorder)[0, LONG : LONG + len(time)]

    if recorder.digital:
        return of_samples
    grid = dt / FINER * (np.arange(-LONG * FINER, LONG * FINER) + 0.5)
    values = on_even_grid(pushing(grid)[None], FINER / dt, recorder)[0]
    return lambda time: np.interp(time, grid, values)


class Channel:
    """What a channel reads of an impact at times since contact, and how that follows velocity and time."""

    def __init__(self, case: Recorded, row: int, recorder: LowPassFilter | None, dt: float) -> None:
        record, tissue = case.measured.record, case.tissue(row)
        velocity, mass, gravity = (
            float(part[row]) for part in (record.velocity, record.mass, record.gravity)
        )
        self._step = 1e-3 * velocity
        self._middle, slower, faster = (
            path(case.measured.element.name, tissue, mass, velocity + by, LONG * dt, gravity)
            for by in (0.0, -self._step, self._step)
        )
        self._filtered, self._h = recorder is not None, dt / FINER
        self._readings = [reading(each, recorder, dt) for each in (self._middle, slower, faster)]

    def at(self, time: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Values, their derivative by the velocity, and what contact later by one second adds."""
        middle, slower, faster = self._readings
        by_velocity = (faster(time) - slower(time)) / (2 * self._step)
        if self._filtered:
            late = (middle(time - self._h) - middle(time + self._h)) / (2 * self._h)
        else:
            late = -np.where(time < 0, 0.0, self._middle.jerk(np.maximum(time, 0.0)))
        return middle(time), by_velocity, late


def kernel(count: int) -> np.ndarray:
    """The covariance of delta / s on so many samples, by its six greatest eigenvalues."""
    time = np.arange(count) / (count - 1)
    whole = np.exp(-((time[:, None] - time) ** 2) / (2 * 0.3**2))
    values, vectors = eigh(whole)
    values, vectors = values[-6:], vectors[:, -6:]
    return (vectors * values * count / values.sum()) @ vectors.T


def correlation(recorder: LowPassFilter | None, white: float, rows: int, dt: float) -> np.ndarray:
    """T = f 1 + (1 - f) R of noise of which the part f went through no filter."""
    if recorder is None or white == 1:
        return np.eye(rows)
    return white * np.eye(rows) + (1 - white) * toeplitz(autocorrelation(recorder, np.arange(rows), dt))


class Rows:
    """Both channels of an impact, for contact at any moment."""

    def __init__(self, case: Recorded, row: int) -> None:
        self._case, self._row = case, row
        record = case.measured.record
        self._dt = float(record.dt[row])
        self._deceleration = Channel(case, row, case.recorders[0], self._dt)
        if record.force is not None:
            self._force = Channel(case, row, case.recorders[1], float(record.force.dt[row]))

    def at(self, lead: float) -> Normal:
        """For contact so long before the first sample [s]."""
        made = self._of_deceleration(lead)
        return made if self._case.measured.record.force is None else self._beside(made, lead)

    def _of_deceleration(self, lead: float) -> Normal:
        given, row, dt = self._case.measured, self._row, self._dt
        record, contact = given.record, given.record.contact
        n, before, reach = int(record.n_samples[row]), int(contact.n_before[row]), contact.reach
        later = dt * np.arange(n) if record.uneven is None else np.asarray(record.uneven.later)[row, :n]
        times = lead + np.append(dt * np.arange(-before, 0), later)
        log_gain = given.noise_parameters.log_gain
        shown = 1.0 if log_gain is None else np.exp(float(log_gain[row]))
        d, by_velocity, late = (shown * part for part in self._deceleration.at(times))
        gain = [] if record.side_by_side else [d]
        offset = (np.arange(before + n) >= contact.n_quiet[row]).astype(float)
        seen = np.append(np.asarray(contact.before)[row, reach - before :], np.asarray(record.d)[row, :n])
        noise = correlation(self._case.recorders[0], self._case.white[0], before + n, dt)
        discrepancy = np.zeros_like(noise)
        if given.noise_parameters.log_discrepancy is not None:
            size = np.exp(2 * float(given.noise_parameters.log_discrepancy[row]))
            discrepancy[before:, before:] = size * kernel(n)
        counts = np.arange(reach - before, reach + n) % record.colour.stride == 0
        return Normal(
            seen[counts],
            d[counts],
            np.stack([by_velocity, *gain, offset, late])[:, counts],
            discrepancy[np.ix_(counts, counts)],
            float(given.sigma[row]) ** 2 * noise[np.ix_(counts, counts)],
        )

    def _beside(self, of_d: Normal, lead: float) -> Normal:
        given, row = self._case.measured, self._row
        record, force = given.record, given.record.force
        n, dt = int(force.n_samples[row]), float(force.dt[row])
        lead = lead - float(record.first_time[row]) + float(force.first_time[row])
        ratio = float(np.exp(given.noise_parameters.log_force_ratio[row]))
        # Below the tissue the force is the tissue's own, on what moves along too.
        moves = 1 + self._case.tissue(row).get("moving_mass_kg", 0.0) / float(record.mass[row])
        share = ratio * moves if force.tip is None else ratio - float(force.tip[row])
        f, by_velocity, late = (share * part for part in self._force.at(lead + dt * np.arange(n)))
        colour_stride = 1 if force.colour is None else force.colour.stride
        counts = np.asarray(force.inside())[row, :n] & (np.arange(n) % colour_stride == 0)
        d_velocity, d_gain, d_offset, d_late = of_d.columns
        none_d, none_f = np.zeros_like(of_d.mean), np.zeros(counts.sum())
        columns = [
            [d_velocity, by_velocity[counts]],
            [d_gain, none_f],
            [none_d, none_f + 1],
            [none_d, late[counts]],
            [d_offset, none_f],
            [d_late, late[counts]],
        ]
        noise = correlation(self._case.recorders[1], self._case.white[1], n, dt)[np.ix_(counts, counts)]
        noise = np.exp(2 * float(given.noise_parameters.log_force_sigma[row])) * noise
        return Normal(
            np.append(of_d.seen, np.asarray(force.y)[row, :n][counts]),
            np.append(of_d.mean, f[counts]),
            np.stack([np.concatenate(column) for column in columns]),
            block_diag(of_d.discrepancy, np.zeros_like(noise)),
            block_diag(of_d.noise, noise),
        )


def scatter(rows: Normal, error_sd: np.ndarray) -> np.ndarray:
    """The covariance of all samples, of the first errors of the chain alone where no more are given."""
    columns = rows.columns[: len(error_sd)]
    return rows.discrepancy + rows.noise + (columns.T * error_sd**2) @ columns


def normal(case: Recorded, row: int) -> Normal:
    """For contact where it is known to be, but for its error."""
    return Rows(case, row).at(float(case.measured.record.first_time[row]))


def log_density(case: Recorded, row: int) -> float:
    """Of an impact, all errors integrated out."""
    record = case.measured.record
    sd = np.asarray(record.error_sd)[row]
    if record.contact.reach:
        return _of_any_moment(case, row, sd[:-1])
    rows = normal(case, row)
    if record.clipped is not None:
        return _of_clipped(rows, scatter(rows, sd), np.asarray(record.clipped)[row, : len(rows.seen)])
    if not record.contact.uniform[row]:
        return float(multivariate_normal(rows.mean, scatter(rows, sd)).logpdf(rows.seen))
    places, weights = np.polynomial.legendre.leggauss(60)
    late = np.sqrt(3) * sd[-1] * places[:, None] * rows.columns[-1]
    density = multivariate_normal(rows.mean, scatter(rows, sd[:-1])).logpdf(rows.seen - late)
    return float(logsumexp(density, b=weights / 2))


def _of_any_moment(case: Recorded, row: int, sd: np.ndarray) -> float:
    """Every moment as likely, one in a sampling interval; samples follow it linearly within a cell.

    Where a parameter says where in its cell contact is, one moment in each.
    """
    record, channels = case.measured.record, Rows(case, row)
    dt, contact, low_pass = float(record.dt[row]), record.contact, record.low_pass
    finer, lead = (1, 0) if low_pass is None else (len(low_pass.phase), low_pass.lead)
    middles = ((np.arange(finer * contact.reach) + 0.5) / finer - lead) * dt
    within = ((np.arange(400) + 0.5) / 400 - 0.5) * dt / finer
    if not contact.uniform[row]:
        middles, within = middles + float(record.earlier[row]) * dt, np.zeros(1)
    logs = []
    for rows in map(channels.at, middles):
        left = rows.seen - rows.mean + within[:, None] * rows.columns[-1]
        logs.append(multivariate_normal(cov=scatter(rows, sd)).logpdf(left))
    density = logsumexp(logs) - np.log(len(within) * finer)
    if case.quiet_sd is None:
        return float(density)
    early = np.asarray(contact.before)[row, contact.reach - int(contact.n_before[row]) :]
    return float(density - norm.logpdf(early, scale=case.quiet_sd).sum())


def _of_clipped(rows: Normal, covariance: np.ndarray, clipped: np.ndarray) -> float:
    """That of the samples within the limit, by the distribution function of those beyond given these."""
    cut, sign = clipped != 0, clipped[clipped != 0]
    left = rows.seen - rows.mean
    density = multivariate_normal(cov=covariance[np.ix_(~cut, ~cut)]).logpdf(left[~cut])
    back = np.linalg.solve(covariance[np.ix_(~cut, ~cut)], covariance[np.ix_(~cut, cut)]).T
    given = covariance[np.ix_(cut, cut)] - back @ covariance[np.ix_(~cut, cut)]
    beyond = multivariate_normal(sign * (back @ left[~cut] - left[cut]), given * np.outer(sign, sign))
    none = np.zeros(cut.sum())
    share = beyond.cdf(none + np.inf, lower_limit=none, rng=np.random.default_rng(1))
    return float(density + np.log(share))


def errors_given(case: Recorded, row: int) -> tuple[np.ndarray, np.ndarray]:
    """Mean and covariance, given the samples, of the chain's errors and the discrepancy if there is any."""
    rows, sd = normal(case, row), np.asarray(case.measured.record.error_sd)[row]
    prior, across = np.diag(sd**2), sd[:, None] ** 2 * rows.columns
    if rows.discrepancy.any():
        prior, across = block_diag(prior, rows.discrepancy), np.concatenate([across, rows.discrepancy])
    weights = np.linalg.solve(scatter(rows, sd), across.T).T
    return weights @ (rows.seen - rows.mean), prior - weights @ across.T
