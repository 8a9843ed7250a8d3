"""How far the likelihoods and the elements' motions are from oracles that share no code with them.

    .venv/bin/python benchmarks/exactness.py

Log densities of the ARMA(2,1) with a free and with a stationary start beside the dense normal distribution
and a Kalman filter sample by sample; of recorded displacements and decelerations, with the errors of their
measuring chain, beside the dense normal distribution of the whole trace. Decelerations of impacts on each
element beside scipy's eighth-order integration of the equations of motion, which tests/elements writes a
second time. A row has the largest difference.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from itertools import product
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from evidence import recorded
from scipy.linalg import cholesky, solve_triangular, toeplitz
from statsmodels.tsa.arima.model import ARIMA
from statsmodels.tsa.arima_process import arma_acovf

from bayestissue.base.runtime import configure
from bayestissue.mechanics.elements import element, element_names, impact
from bayestissue.mechanics.oscillator import to_discrete
from bayestissue.model.likelihood.arma21 import arma21_log_likelihood
from bayestissue.model.likelihood.displacements import MeasuredDisplacement, displacement_record
from bayestissue.model.likelihood.impact import MeasuredImpact, NoiseParameters
from bayestissue.model.likelihood.record import Contact, DecelerationRecord

ROOT = Path(__file__).resolve().parents[1]
sys.path += [str(ROOT / "tests"), str(ROOT / "tests" / "elements")]
from element_values import MASS, VALUES, VELOCITY  # noqa: E402

from tissues import path  # noqa: E402

SAMPLES, SIGMA = 60, 0.3
# From five samples an oscillation to a hundred, damped little and beyond the critical.
OSCILLATORS = [(1.2, 0.05), (0.5, 0.3), (0.5, 1.0), (0.06, 0.3), (0.3, 2.0)]
# The oracles of a stationary start lose their digits when samples follow each other closer.
FINE = 0.1
THETAS = (-1.0, -0.97, -0.27, 0.0, 0.5)
# Mass and velocity, gain, offset and time of contact.
CHAIN_SD = np.array([0.01, 0.02, 0.5, 1e-4])
DT, FIRST, NOISE = 4e-4, 2e-4, 0.4
Row = tuple[str, str, float, str]


def walk(seed: int) -> np.ndarray:
    """A trace that no model made."""
    return 0.1 * np.random.default_rng(seed).normal(size=SAMPLES).cumsum()


def arma21() -> Iterator[Row]:
    """Log densities, relative."""
    cases = list(product(OSCILLATORS, THETAS))
    found: dict[tuple[str, str], list[float]] = {}
    for seed, ((omega_dt, zeta), theta1) in enumerate(cases):
        phi1, phi2, _ = (float(c) for c in to_discrete(omega_dt, zeta, 1.0))
        x = walk(seed)
        w = x[2:] - phi1 * x[1:-1] - phi2 * x[:-2]
        band = np.zeros(len(w))
        band[:2] = 1 + theta1**2, -theta1
        free = float(arma21_log_likelihood(x, phi1, phi2, theta1, SIGMA))
        oracles = {
            ("a free start", "dense normal"): (free, normal(SIGMA**2 * toeplitz(band), w)),
            ("a free start", "Kalman filter"): (free, filtered(w, theta1)),
        }
        if omega_dt > FINE:
            gamma = arma_acovf([1, -phi1, -phi2], [1, -theta1], SAMPLES, SIGMA**2)
            still = float(arma21_log_likelihood(x, phi1, phi2, theta1, SIGMA, start="stationary"))
            model = ARIMA(x, order=(2, 0, 1), trend="n", enforce_invertibility=False)
            by_filter = float(model.loglike([phi1, phi2, -theta1, SIGMA**2]))
            oracles |= {
                ("a stationary start", "dense normal"): (still, normal(toeplitz(gamma), x)),
                ("a stationary start", "Kalman filter of statsmodels"): (still, by_filter),
            }
        for key, (ours, theirs) in oracles.items():
            found.setdefault(key, []).append(abs(ours / theirs - 1))
    for (start, oracle), differences in found.items():
        yield f"ARMA(2,1), {start}", oracle, max(differences), "of the log density"


def normal(covariance: np.ndarray, value: np.ndarray, mean: np.ndarray | float = 0.0) -> float:
    """Log density of the dense normal distribution."""
    factor = cholesky(covariance, lower=True)
    standard = solve_triangular(factor, value - mean, lower=True)
    return float(-np.log(np.diag(factor)).sum() - (standard @ standard + len(value) * np.log(2 * np.pi)) / 2)


def filtered(w: np.ndarray, theta1: float) -> float:
    """Of a moving average w = a - theta1 a(-1) by its innovations."""
    total, error, r = 0.0, 0.0, 1 + theta1**2
    for t, each in enumerate(w):
        if t:
            error, r = each + theta1 * error / r, 1 + theta1**2 - theta1**2 / r
        else:
            error = each
        total -= (np.log(2 * np.pi * SIGMA**2 * r) + error**2 / (SIGMA**2 * r)) / 2
    return total


def displacements() -> Row:
    """Recorded displacements with errors of level, ramp and parabola, relative."""
    sd, log_sigma = np.array([1e-4, 0.02, 0.5]), np.log(2e-5)
    time, differences = FIRST + DT * np.arange(SAMPLES), []
    for seed, ((omega_dt, zeta), theta1) in enumerate(product(OSCILLATORS, THETAS)):
        x = 1e-3 * np.sin(np.arange(SAMPLES) / 20) + 1e-5 * walk(seed)
        phi1, phi2, _ = (float(c) for c in to_discrete(omega_dt, zeta, 1.0))
        chain = np.stack([np.ones(SAMPLES), time, time**2 / 2])
        w, columns = (y[..., 2:] - phi1 * y[..., 1:-1] - phi2 * y[..., :-2] for y in (x, chain))
        band = np.zeros(len(w))
        band[:2] = 1 + theta1**2, -theta1
        covariance = np.exp(2 * log_sigma) * toeplitz(band) + (columns.T * sd**2) @ columns
        one = (np.array([value]) for value in (SAMPLES, FIRST, DT))
        made = displacement_record(x[None], *one, sd[None])  # type: ignore[call-arg]
        given = (jnp.array([value]) for value in (omega_dt / DT, zeta, theta1, log_sigma))
        ours = float(MeasuredDisplacement(*given, made).log_density()[0])  # type: ignore[call-arg]
        differences.append(abs(ours / normal(covariance, w) - 1))
    return "recorded displacements, ARMA(2,1)", "dense normal", max(differences), "of the log density"


def solved(name: str, row: int, time: np.ndarray, velocity: float) -> np.ndarray:
    """Decelerations by scipy's eighth-order method. A mass that moves along is taken along at contact."""
    return path(name, VALUES[name], MASS[row], velocity, time[-1]).deceleration(time)


def impacts(name: str) -> Iterator[Row]:
    """Decelerations relative to the peak, and log densities, absolute, of one element."""
    time, step = FIRST + DT * np.arange(SAMPLES), 1e-6
    values, rows = VALUES[name], range(len(MASS))
    middle = np.stack([solved(name, row, time, VELOCITY[row]) for row in rows])
    pushes = middle > 0
    ours = np.asarray(impact(name, values, MASS, VELOCITY, np.tile(time, (len(MASS), 1))).deceleration)
    off = np.abs(np.where(pushes, ours - middle, 0.0)).max(1) / middle.max(1)
    yield f"motion, {name}", "integration by scipy (DOP853)", float(off.max()), "of the peak"
    # Until the force falls again, where no contact ends.
    count = np.minimum(middle.argmax(1) + 3, SAMPLES)
    d = middle + 0.3 + NOISE * np.random.default_rng(4).standard_normal(middle.shape)
    ones = np.ones(len(MASS))
    chain, ball = np.outer(ones, CHAIN_SD), {"diameter_m": 0.0318 * ones}
    record = DecelerationRecord.from_arrays(
        d, count, FIRST * ones, DT * ones, VELOCITY, chain, MASS, ball, Contact.known(ones < 0)
    )
    found = density(name)(jnp.array([value * ones for value in values.values()]), record)
    differences = []
    for row in rows:
        n = count[row]
        faster, slower = (solved(name, row, time, VELOCITY[row] + sign * step) for sign in (1, -1))
        later, sooner = (solved(name, row, time - sign * step, VELOCITY[row]) for sign in (1, -1))
        by_velocity, by_contact = (faster - slower) / (2 * step), (later - sooner) / (2 * step)
        columns = np.stack([by_velocity, middle[row], np.ones(SAMPLES), by_contact])[:, :n]
        covariance = NOISE**2 * np.eye(n) + (columns.T * CHAIN_SD**2) @ columns
        differences.append(abs(float(found[row]) - normal(covariance, d[row, :n], middle[row, :n])))
    yield f"recorded decelerations, {name}", "dense normal", max(differences), "nats"


def density(name: str) -> Callable[[jax.Array, DecelerationRecord], jax.Array]:
    """Log densities of a record's own traces."""

    @jax.jit
    def log_prob(parameters: jax.Array, record: DecelerationRecord) -> jax.Array:
        noise = NoiseParameters(jnp.log(jnp.full(len(MASS), NOISE)))
        return MeasuredImpact(element(name), parameters, noise, record).log_density()

    return log_prob


def main() -> None:
    configure()
    with recorded("exactness") as record:
        rows: list[Row] = [*arma21(), displacements()]
        for name in element_names():
            rows += impacts(name)
        record.write(pd.DataFrame(rows, columns=["what", "oracle", "largest_difference", "relative_to"]))


if __name__ == "__main__":
    main()
