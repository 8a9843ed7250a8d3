"""Impacts that something pushes on, such as heels under a leg: displacement and force, and what made them.

A mass m arrives at V and is pushed by P (1 - exp(-t / r)) while the tissue resists with K x (x / x_0)^(p - 1)
(1 + (x / x_s)^2) + C x' once x > 0: p = 1 is a spring and damper, with a finite x_s the element `stiffening`,
and another p a tissue that neither describes. Mass and push differ from impact to impact, and no estimate
knows them. What is recorded is the displacement, from a
zero of its own, and the force, each with its noise, at times that do not meet contact.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from jaxtyping import Float, Int

from bayestissue.dataset.chain import Uncertainty
from bayestissue.dataset.model import Channel, Dataset, Trace

# x_0, where a law of any exponent has the secant stiffness K [m].
DEPTH_M = 5e-3
# Times at which a true motion is looked at: trapezia over so many miss a part in a million.
_FINE = 2001


@dataclass(frozen=True)
class Driven:
    """A study of driven impacts.

    Attributes:
        seed: of all random numbers.
        subjects, repeats: how many people, and impacts of each in each condition.
        K, C: of the typical person [N/m, N s/m].
        of_trials: differences of log K and log C in each condition.
        sd_subject, sd_impact: standard deviations of log K and of log C.
        exponent: p.
        stiffening_depth_m: x_s [m].
        velocity: V, lowest and highest [m/s].
        mass: m [kg].
        push: P [N].
        rise: r [s].
        rate: samples a second, of both channels.
        noise_m, noise_N: standard deviations of the noise of both.
        zero_N: standard deviation of the force's zero.
        late_s: what the force's clock is late.
        late_sd_s: what is declared of that.
        before_s, after_s: how long is recorded before and after contact.
    """

    seed: int
    subjects: int = 4
    repeats: int = 3
    K: float = 40e3
    C: float = 300.0
    of_trials: tuple[tuple[float, float], ...] = ((0.0, 0.0), (-0.15, 0.1))
    sd_subject: float = 0.25
    sd_impact: float = 0.08
    exponent: float = 1.0
    stiffening_depth_m: float = np.inf
    velocity: tuple[float, float] = (0.35, 0.55)
    mass: tuple[float, float] = (2.4, 3.6)
    push: tuple[float, float] = (100.0, 250.0)
    rise: tuple[float, float] = (0.01, 0.03)
    rate: float = 1293.5
    noise_m: float = 5e-5
    noise_N: float = 1.0
    zero_N: float = 2.0
    late_s: float = 0.0
    late_sd_s: float = 0.0
    before_s: float = 0.05
    after_s: float = 0.1


class Pressed(NamedTuple):
    """The impacts of a study without noise.

    Attributes:
        subject, trial, repeat: whose each is.
        K, C: of each.
        time: of the samples since contact [s].
        x, force: displacement and force there.
        path: displacement, its rate and force at any times since contact.
    """

    subject: Int[np.ndarray, " impact"]
    trial: Int[np.ndarray, " impact"]
    repeat: Int[np.ndarray, " impact"]
    K: Float[np.ndarray, " impact"]
    C: Float[np.ndarray, " impact"]
    time: Float[np.ndarray, "impact sample"]
    x: Float[np.ndarray, "impact sample"]
    force: Float[np.ndarray, "impact sample"]
    path: Callable[[Float[np.ndarray, "impact sample"]], tuple[Float[np.ndarray, "impact sample"], ...]]


def driven(study: Driven) -> tuple[Dataset, pd.DataFrame]:
    """The recordings of a study, and its truth: ``impact``, ``K_N_per_m`` and ``C_N_s_per_m``."""
    random = np.random.default_rng(study.seed)
    simulated = _made(study, random)
    count, time = len(simulated.K), simulated.time
    x = (
        simulated.x
        + random.normal(0, 1e-3, (count, 1))
        + study.noise_m * random.standard_normal(simulated.x.shape)
    )
    force = simulated.force + study.zero_N * random.standard_normal((count, 1))
    force = force + study.noise_N * random.standard_normal(x.shape)
    labels = zip(simulated.subject, simulated.trial, simulated.repeat, strict=True)
    names = [f"s{s:02d}-t{t}-{r}" for s, t, r in labels]
    impacts = pd.DataFrame(
        {
            "impact": names,
            "subject": [f"s{s:02d}" for s in simulated.subject],
            "trial": [f"t{t}" for t in simulated.trial],
            "mass_kg": np.nan,
            "velocity_m_s": np.nan,
        }
    )
    # The recorder's own time: contact stands nowhere in it.
    traces, forces = (
        [Trace(row - row[0] + late, values) for row, values in zip(time, part, strict=True)]
        for part, late in ((x, 0.0), (force, study.late_s))
    )
    plate = Channel("plate", "force", "base", forces, time_offset_sd_s=study.late_sd_s)
    dataset = Dataset(
        name="driven", description="Simulated.", impacts=impacts, traces=traces, quantity="displacement",
        uncertainty=Uncertainty(), warnings=(), left_out=(), folder=None, input_hash=f"driven-{study}",
        free=False, channels=(plate,),
    )  # fmt: skip
    return dataset, pd.DataFrame({"impact": names, "K_N_per_m": simulated.K, "C_N_s_per_m": simulated.C})


def outcomes_within(study: Driven, end: Float[np.ndarray, " impact"]) -> pd.DataFrame:
    """What the impacts of a study truly come to from contact until ``end`` [s], as a window ends there.

    ``peak_force_N``, ``peak_depth_m`` and ``energy_absorbed_J``, the integral of C v^2, on a fine grid.
    """
    simulated = _made(study, np.random.default_rng(study.seed))
    time = np.linspace(0, end, _FINE, axis=1)
    x, v, force = simulated.path(time)
    return pd.DataFrame(
        {
            "peak_force_N": force.max(axis=1),
            "peak_depth_m": x.max(axis=1),
            "energy_absorbed_J": simulated.C * np.trapezoid(v**2, time, axis=1),
        }
    )


def _made(study: Driven, random: np.random.Generator) -> Pressed:
    """The impacts before anything is recorded of them."""
    trials = len(study.of_trials)
    subject, trial, repeat = (part.ravel() for part in np.indices((study.subjects, trials, study.repeats)))
    count = len(subject)
    of_subjects = study.sd_subject * random.standard_normal((study.subjects, 2))
    logs = np.log([study.K, study.C]) + of_subjects[subject] + np.array(study.of_trials)[trial]
    K, C = np.exp(logs + study.sd_impact * random.standard_normal((count, 2))).T
    V, mass, push, rise = (
        random.uniform(*ends, count) for ends in (study.velocity, study.mass, study.push, study.rise)
    )
    steps = np.arange(-round(study.before_s * study.rate), round(study.after_s * study.rate))
    time = (steps + random.uniform(0, 1, (count, 1))) / study.rate
    path = partial(_pushed, study, K, C, V, mass, push, rise)
    x, _, force = path(np.maximum(time, 0.0))
    x, force = np.where(time < 0, V[:, None] * time, x), np.where(time < 0, 0.0, force)
    return Pressed(subject, trial, repeat, K, C, time, x, force, path)


def _pushed(
    study: Driven,
    K: Float[np.ndarray, " impact"],
    C: Float[np.ndarray, " impact"],
    V: Float[np.ndarray, " impact"],
    mass: Float[np.ndarray, " impact"],
    push: Float[np.ndarray, " impact"],
    rise: Float[np.ndarray, " impact"],
    time: Float[np.ndarray, "impact sample"],
) -> tuple[Float[np.ndarray, "impact sample"], ...]:
    """Displacement, its rate and the force of every impact at these times since contact [s]."""
    from scipy.integrate import solve_ivp

    def force(x: np.ndarray, v: np.ndarray, K: np.ndarray, C: np.ndarray) -> np.ndarray:
        depth = np.maximum(x, 0.0)
        stiffness = K * (depth / DEPTH_M) ** (study.exponent - 1)
        stiffness = stiffness * (1 + (depth / study.stiffening_depth_m) ** 2)
        return np.where(x >= 0, stiffness * depth + C * v, 0.0)

    def rates(t: float, y: np.ndarray) -> np.ndarray:
        x, v = y.reshape(2, -1)
        return np.concatenate([v, (push * -np.expm1(-t / rise) - force(x, v, K, C)) / mass])

    initial_state = np.concatenate([np.zeros_like(V), V])
    end = float(time.max())
    solved = solve_ivp(rates, (0, end), initial_state, rtol=1e-9, atol=1e-12, dense_output=True)
    assert solved.sol is not None  # noqa: S101 - it was asked for
    y = solved.sol(time.ravel()).reshape(2, len(V), *time.shape)
    rows = np.arange(len(V))
    x, v = y[:, rows, rows]
    return x, v, force(x, v, K[:, None], C[:, None])


def write_driven(folder: Path, study: Driven) -> None:
    """Write the study's dataset with ``truth.csv`` beside it, into a new folder."""
    dataset, truth = driven(study)
    named = replace(dataset, description="Simulated; truth.csv holds what it was made from.")
    named.write(folder)
    truth.to_csv(folder / "truth.csv", index=False, lineterminator="\n")
