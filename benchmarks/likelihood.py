"""Time the exact ARMA(2,1) likelihood and its gradient beside its peers, all in one run.

    python benchmarks/likelihood.py

Every contender computes the log likelihood of 90 impacts and its gradient by each impact's parameters; ours
is what a fit by `arma` evaluates, errors of the measuring chain integrated out, which are 0 here. The
contenders take turns, so that a busy moment of the machine hits all of them; the table shows the least time
of each, which other work on the machine disturbs least.
"""

from __future__ import annotations

from collections.abc import Callable
from time import perf_counter
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from evidence import measure

from bayestissue.mechanics.oscillator import impact_motion, to_differences
from bayestissue.model.likelihood.displacements import MeasuredDisplacement, displacement_record

IMPACTS, SIZES, ROUNDS = 90, (256, 1024, 4096), 10
# A contender slower than this a call is timed fewer times.
SLOW = 0.5
# The seconds that a contender's turn takes, so that the short calls are repeated often enough.
BURST = 0.01
Call = Callable[[], Any]


def traces(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Noisy impacts of n samples up to the peak, and their omega_n dt."""
    omega_dt = np.linspace(1.2, 1.4, IMPACTS) / n
    clean = impact_motion(np.arange(n), omega_dt[:, None], 0.3, 1.0).displacement
    shocks = np.random.default_rng(0).normal(size=(IMPACTS, n))
    return np.asarray(clean) + 1e-6 * np.cumsum(np.cumsum(shocks, axis=1), axis=1) / n, omega_dt


def stacked(omega_dt: np.ndarray, n: int) -> jax.Array:
    """omega_n, zeta, theta1 and the log of sigma of every impact in one array, as a sampler holds them."""
    zeta, theta1 = np.full(IMPACTS, 0.3), to_differences(omega_dt, 0.3, 1.0)[2]
    return jnp.stack([omega_dt, zeta, theta1, np.full(IMPACTS, np.log(1e-6 / n))])


def differences(p: jax.Array) -> tuple[jax.Array, ...]:
    """c1, c2, theta1 and sigma of such an array."""
    return *to_differences(p[0], p[1], 1.0)[:2], p[2], jnp.exp(p[3])


def sine(n: int) -> tuple[Call, Call]:
    """The sine-transform likelihood of a fit, and reading its arrays once."""
    x, omega_dt = traces(n)
    one = np.ones(IMPACTS)
    data = displacement_record(x, np.full(IMPACTS, n), 0 * one, one, np.zeros((IMPACTS, 3)))
    both = jax.jit(jax.value_and_grad(lambda p, data: MeasuredDisplacement(*p, data).log_density().sum()))  # type: ignore[call-arg]
    parameters = stacked(omega_dt, n)
    read = jax.jit(lambda columns: [column.sum((0, 2)) for column in columns])
    return lambda: both(parameters, data), lambda: read(data.columns)


def kalman(n: int, *, tuned: bool) -> Call:
    """The same density by a scalar Kalman filter, a scan over the samples of all impacts together.

    The plain one does each sample's whole work in its step. The tuned one keeps only what depends on the last
    sample there, which was the fastest of the forms tried; unrolling the scan makes it slower.
    """
    x, omega_dt = traces(n)
    slope = np.diff(x, axis=1)
    columns = tuple(jnp.asarray(c.T) for c in (np.diff(slope, axis=1), slope[:, :-1], x[:, :-2]))
    both = jax.jit(jax.value_and_grad(_tuned_scan if tuned else _plain_scan))
    parameters = stacked(omega_dt, n)
    return lambda: both(parameters, columns)


def _plain_scan(p: jax.Array, columns: tuple[jax.Array, ...]) -> jax.Array:
    c1, c2, theta1, sigma_a = differences(p)

    def step(carry: tuple[jax.Array, ...], part: tuple[jax.Array, ...]) -> tuple:
        error, r, total = carry
        v = part[0] + c1 * part[1] + c2 * part[2] + theta1 * error / r
        r = 1 + theta1**2 - theta1**2 / r
        total = total - (jnp.log(2 * jnp.pi * sigma_a**2 * r) + v**2 / (sigma_a**2 * r)) / 2
        return (v, r, total), None

    # an infinite variance before the first sample gives it the unconditional one
    start = (jnp.zeros(IMPACTS), jnp.full(IMPACTS, 1e300), jnp.zeros(IMPACTS))
    return jax.lax.scan(step, start, columns)[0][2].sum()


def _tuned_scan(p: jax.Array, columns: tuple[jax.Array, ...]) -> jax.Array:
    c1, c2, theta1, sigma_a = differences(p)

    def step(carry: tuple[jax.Array, ...], w: jax.Array) -> tuple:
        error_over, one_over = carry
        r = 1 + theta1**2 * (1 - one_over)
        v = w + theta1 * error_over
        return (v / r, 1 / r), (v, r)

    zero = jnp.zeros(IMPACTS)
    w = columns[0] + c1 * columns[1] + c2 * columns[2]
    _, (v, r) = jax.lax.scan(step, (zero, zero), w)
    return -(jnp.log(2 * jnp.pi * sigma_a**2 * r) + v**2 / (sigma_a**2 * r)).sum() / 2


def tinygp(n: int) -> Call:
    """Tinygp's quasiseparable solver with the SHO kernel, the same A(2), mapped over the impacts."""
    import tinygp as gp

    x, omega_dt = traces(n)
    time = jnp.arange(n) * 1.0

    def density(p: jax.Array, x: jax.Array) -> jax.Array:
        kernel = gp.kernels.quasisep.SHO(omega=p[0], quality=1 / (2 * p[1]), sigma=p[2])
        return gp.GaussianProcess(kernel, time, diag=1e-12).log_probability(x)

    both = jax.jit(jax.vmap(jax.value_and_grad(density)))
    p, x = jnp.stack([omega_dt, np.full(IMPACTS, 0.3), np.full(IMPACTS, 0.5)], axis=1), jnp.asarray(x)
    return lambda: both(p, x)


def celerite2(n: int) -> Call:
    """celerite2's own solver with the SHO term; the numpy interface has no gradient, so value only."""
    from celerite2 import GaussianProcess, terms

    x, omega_dt = traces(n)
    time = np.arange(n) * 1.0

    def values() -> list[float]:
        found = []
        for row, w in zip(x, omega_dt, strict=True):
            process = GaussianProcess(terms.SHOTerm(w0=w, Q=1 / 0.6, sigma=0.5))
            process.compute(time, diag=np.full(n, 1e-12))
            found.append(process.log_likelihood(row))
        return found

    return values


def statsmodels(n: int) -> Call:
    """The exact Kalman filter of ARIMA in compiled code, one impact after the other, score included."""
    from statsmodels.tsa.arima.model import ARIMA

    x, _ = traces(n)
    models = [ARIMA(row, order=(2, 0, 1), trend="n") for row in x]
    # coefficients well inside the stationary region, as the filter's start needs them
    p = np.array([1.9, -0.92, 0.27, 1e-6])
    return lambda: [(model.loglike(p), model.score(p)) for model in models]


def timed(calls: dict[str, Call]) -> dict[str, float]:
    """Least seconds a call, the contenders taking turns in short bursts."""
    least = {name: _seconds(call) for name, call in calls.items()}
    for turn in range(ROUNDS):
        for name, call in calls.items():
            if least[name] < SLOW or turn < 2:
                burst = int(np.clip(BURST / least[name], 1, 100))
                least[name] = min([least[name], *(_seconds(call) for _ in range(burst))])
    return least


def _seconds(call: Call) -> float:
    begin = perf_counter()
    jax.block_until_ready(call())
    return perf_counter() - begin


PEERS = {"statsmodels": statsmodels, "tinygp": tinygp, "celerite2 (value only)": celerite2}


def contenders(n: int) -> dict[str, Call]:
    ours, read = sine(n)
    scans = {
        "Kalman scan in JAX, plain": kalman(n, tuned=False),
        "Kalman scan in JAX, tuned": kalman(n, tuned=True),
    }
    value, slopes = (np.asarray(part) for part in ours())
    largest = np.abs(slopes).max(axis=1, keepdims=True)
    for scan in scans.values():
        other, other_slopes = scan()
        np.testing.assert_allclose(value, other, rtol=1e-9, err_msg="not the same density")
        np.testing.assert_allclose(
            slopes / largest, other_slopes / largest, atol=1e-6, err_msg="nor gradient"
        )
    calls = {"bayestissue": ours, "reading the arrays once": read, **scans}
    for name, make in PEERS.items():
        try:
            calls[name] = make(n)
        except ImportError as error:
            print(f"{name} is left out: {error}")
    return calls


def rows_of(n: int) -> list[dict[str, Any]]:
    """The least milliseconds of each contender with so many samples."""
    return [{"contender": name, "ms": 1e3 * s} for name, s in timed(contenders(n)).items()]


def main() -> None:
    measure("likelihood", SIZES, rows_of)


if __name__ == "__main__":
    main()
