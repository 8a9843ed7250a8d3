"""Answers of the program, from data to number, computed with every fast path on or off.

    BAYESTISSUE_PLAIN=1 python tests/plain_answers.py OUT.npz NAME ...

`differences` compares what such a process writes with what one finds that has the fast paths:
`tests/test_plain.py` asks how far they may be apart, and `benchmarks/plain_against_fast.py` keeps how far
they were. Campaigns have sizes that the fast paths fill up, but where random numbers are drawn by impact:
those of an array depend on its size, so that there the number of impacts is one that stays as it is.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Collection, Mapping
from functools import cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd

import bayestissue as bt
from bayestissue import runtime
from bayestissue.certificate.augmented import truths
from bayestissue.certificate.ranks import ranks_of
from bayestissue.dataset import Dataset
from bayestissue.fitting import resolve
from bayestissue.hierarchy.specification import Sampler
from bayestissue.hierarchy.trace_data import Prepared, prepare
from bayestissue.hierarchy.traces import TraceData, TraceModel, log_likelihood
from bayestissue.inference.chain.draws import chain_draws
from bayestissue.inference.chain.explanations import explanations
from bayestissue.inference.chain.settings import ChainSettings
from bayestissue.inference.execution.chunks import BLOCK
from bayestissue.inference.execution.kept import in_single
from bayestissue.inference.factors.expansions import expanded, first_guess
from bayestissue.likelihood import sine_transforms
from bayestissue.likelihood.arma.arma21 import log_likelihood as series_log_likelihood
from bayestissue.padding import bucket, padded_impacts
from bayestissue.resources import shared
from bayestissue.simulation import Simulation, simulate
from make_fit_run import write_fit_run

Numbers = dict[str, Any]
# Beside what is drawn: its Monte Carlo error.
ERROR = "error"
# What is far from the guess that chains begin from, in logs.
AWAY = 0.1
OF_ONE = {"relative_mass_sd": 0.005, "velocity_sd_m_s": 0.01}
MODEL = {
    "like": "impact",
    "discrepancy": "none",
    "formula": dict.fromkeys("KC", "log(mass_kg) + (1|subject)"),
}


@cache
def campaign(people: int, masses: tuple[float, ...]) -> Dataset:
    """Impacts of unequal lengths."""
    spreads = {f"sd_{group}_{q}": sd for group, sd in (("subject", 0.2), ("impact", 0.05)) for q in "KC"}
    content = {
        "name": "plain and fast",
        "seed": 4,
        "design": {
            "subjects": people,
            "conditions": [{"trial": f"m{m}", "mass_kg": m, "velocity_m_s": 1.5} for m in masses],
        },
        "tissue": {"K_N_per_m": 3000.0, "C_N_s_per_m": 25.0} | spreads,
        "recording": {
            "sampling_rate_hz": 2000.0,
            "noise_relative_to_peak": 0.005,
            "relative_mass_sd": 0.002,
            "velocity_sd_m_s": 0.005,
        },
    }
    return simulate(Simulation.model_validate(content)).dataset("plain and fast")


@cache
def example() -> Dataset:
    """The example that comes with the program."""
    return bt.read_dataset(shared("data", "example"))


def filled_up() -> Dataset:
    """Eleven of its impacts, which become twelve: as many as `test_fitting` has compiled for."""
    return example().part(list(range(0, 88, 8)))


def as_it_is() -> Dataset:
    """Twelve impacts, which no fast path fills up; their samples it does."""
    return campaign(4, (0.4, 0.8, 1.3))


def prepared_of(dataset: Dataset, model: Any) -> Prepared:
    """What a fit would work on."""
    specification, source = resolve(model)
    return prepare(dataset, specification, source=source)


def columns(table: pd.DataFrame) -> Numbers:
    """Its numbers by column."""
    return {str(name): table[name].to_numpy(float) for name in table.select_dtypes("number")}


def estimates(dataset: Callable[[], Dataset], **options: Any) -> Numbers:
    """`bt.estimate`."""
    return columns(bt.estimate(dataset(), **options))


def one_impact() -> Numbers:
    """`bt.impact` of the example's impact that `test_one_impact` has compiled for."""
    trace, about = example().traces[5], example().impacts.iloc[5]
    given = {"mass_kg": about["mass_kg"], "velocity_m_s": about["velocity_m_s"], "uncertainty": OF_ONE}
    return columns(bt.impact(trace.time_s, trace.value, **given).row.to_frame().T.infer_objects())


@partial(jax.jit, static_argnames="tangents")
def _density(model: TraceModel, data: TraceData, u: jax.Array, *, tangents: int) -> tuple[jax.Array, ...]:
    def total(u: jax.Array) -> tuple[jax.Array, jax.Array]:
        value = log_likelihood(model, data, [u[:, a] for a in range(tangents)])
        return value.sum(), value

    slope, value = jax.grad(total, has_aux=True)(u)
    return value, slope


def density(dataset: Callable[[], Dataset], model: Any) -> Numbers:
    """Log density of every trace, and its gradient by the impact's parameters."""
    made = prepared_of(dataset(), model)
    u = first_guess(made)
    u = u + AWAY * np.random.default_rng(1).standard_normal(u.shape)
    value, slope = _density(made.model, made.data.padded, padded_impacts(u), tangents=u.shape[1])
    return {"log density": np.asarray(value)[: len(u)], "gradient": np.asarray(slope)[: len(u)]}


def series() -> Numbers:
    """The likelihood of ARMA(2,1) of transformed series, and its gradient."""
    x = np.random.default_rng(2).normal(size=(5, 77)).cumsum(axis=1)
    data = sine_transforms(x, np.array([77, 60, 33, 77, 20]))

    def total(at: jax.Array) -> tuple[jax.Array, jax.Array]:
        value = series_log_likelihood(data, *at)
        return value.sum(), value

    at = jnp.array([0.3, 0.05, 0.4, 0.9])[:, None] * jnp.linspace(0.8, 1.2, 5)
    slope, value = jax.jit(jax.grad(total, has_aux=True))(at)
    return {"log density": np.asarray(value), "gradient": np.asarray(slope)}


def short_chain() -> Numbers:
    """Where a chain has come after two dozen transitions of all its moves."""
    made = prepared_of(as_it_is(), MODEL)
    lengths = {"first_rounds": (1,), "round": 1, "last_round": 1, "most_rounds": 1, "first_look": 1}
    settings = ChainSettings(segment=6, in_a_row=1, **lengths)  # type: ignore[arg-type]
    sampler = Sampler(chains=2, transitions=100)
    sites = explanations(made, expanded(made), lambda *_: None)
    drawn = next(chain_draws(made, sites, sampler, 1, settings=settings))
    # Near a draw, and not a draw itself, which would be as good as its own rounding in a comparison.
    truth = truths(drawn, 1)[0]
    ranks = ranks_of(made, drawn, truth._replace(u=truth.u + AWAY / 10), len(made.impacts))
    kept = {"u": drawn.u, "b": drawn.population.b} | drawn.population.hyperparameters
    return {name: values[:, :24] for name, values in kept.items()} | {
        f"rank of {n}": r for n, r in ranks.items()
    }


def fit(dataset: Callable[[], Dataset], kind: str) -> Numbers:
    """Means of a short fit, and their Monte Carlo errors."""
    model = {"like": kind, "sampler": {"chains": 2, "draws": 500, "effective": 100}}
    model |= {"discrepancy": "none"} if kind == "impact" else {}
    summary = columns(bt.fit(dataset(), model, seed=3).summary)
    return {"mean": summary["mean"], ERROR: summary["mcse_mean"]}


@cache
def finished() -> bt.Fit:
    """A run whose draws are invented."""
    with TemporaryDirectory() as folder:
        return bt.read_run(write_fit_run(Path(folder) / "run"))


def question() -> Numbers:
    """Of a finished run."""
    return columns(finished().ask("K[mass_kg=1.2] / K[mass_kg=0.4] > 1.1", "K[subject=new]"))


def prediction() -> Numbers:
    """Of a finished run, for another mass and velocity."""
    return columns(finished().predict(pd.DataFrame({"mass_kg": [0.6, 1.0], "velocity_m_s": [1.2, 2.0]})))


def plan() -> Numbers:
    """A study's assurance."""
    made = bt.plan(people=6, masses_kg=[0.5, 1.0], ask="mass_exponent_K < 0.5", studies=100, seed=2)
    return columns(made.designs)


# Those of the default tests, those that take long to compile, and fits, whose means have Monte Carlo errors.
QUICK: Mapping[str, Callable[[], Numbers]] = {
    "estimate of one impact": one_impact,
    "point estimates, dds": partial(estimates, filled_up, method="dds"),
    "log density of impact": partial(density, filled_up, MODEL),
    "log density of arma": partial(density, filled_up, "arma"),
    "log density of a2": partial(density, filled_up, "a2"),
    "log density of series": series,
    "question": question,
    "prediction": prediction,
}
SLOW: Mapping[str, Callable[[], Numbers]] = {
    "estimates": partial(estimates, filled_up),
    "log density of maxwell": partial(density, filled_up, "maxwell"),
    "short chain": short_chain,
    "plan": plan,
}
FITS: Mapping[str, Callable[[], Numbers]] = {
    "fit by impact": partial(fit, as_it_is, "impact"),
    "fit by arma": partial(fit, as_it_is, "arma"),
}


def answered(names: Collection[str]) -> Numbers:
    """What this process finds, which has the fast paths or none."""
    found: Numbers = {"paths": np.array(paths())}
    for name in names:
        for what, values in (QUICK | SLOW | FITS)[name]().items():
            found[f"{name}: {what}"] = np.asarray(values, float)
    return found


def both_ways(folder: Path, names: Collection[str]) -> tuple[Numbers, Numbers]:
    """What this process finds, and one without fast paths, which reads no kept compilation either."""
    out = folder / "plain.npz"
    environment = os.environ | {"BAYESTISSUE_PLAIN": "1", "PYTHONPATH": os.pathsep.join(sys.path)}
    environment.pop("JAX_COMPILATION_CACHE_DIR", None)
    subprocess.run([sys.executable, __file__, str(out), *names], env=environment, check=True)  # noqa: S603 - our own
    with np.load(out) as arrays:
        return answered(names), dict(arrays)


def differences(fast: Numbers, plain: Numbers) -> dict[str, float]:
    """The largest difference of each answer, over the largest number of its kind.

    Of what is drawn it is in Monte Carlo errors of the difference. Infinite where one way has a number and
    the other none.
    """
    largest: dict[str, float] = {}
    for key, here in fast.items():
        name, _, what = key.partition(": ")
        if what in (ERROR, ""):
            continue
        there, finite = plain[key], np.isfinite(here)
        error = f"{name}: {ERROR}"
        if error in fast:
            size = np.hypot(fast[error], plain[error])
        else:
            size = np.full(here.shape, np.abs(here[finite]).max(initial=0.0))
        size = np.where(size > 0, size, 1.0)
        apart = np.abs(here - there)[finite] / size[finite]
        alike = here.shape == there.shape and (finite == np.isfinite(there)).all()
        largest[name] = max(largest.get(name, 0.0), float(apart.max(initial=0.0)) if alike else np.inf)
    return largest


def paths() -> list[bool]:
    """Whether padding, blocks, processes, kept compilations and single precision are off."""
    return [
        bucket(9) == 9,
        BLOCK > 10**9,
        runtime.cores() == 1,
        runtime._cache_folder() is None,
        in_single(np.zeros(1)).dtype == np.float64,
    ]


def main() -> None:
    out, *names = sys.argv[1:]
    runtime.configure(one_core=True)
    np.savez(Path(out), **answered(names))


if __name__ == "__main__":
    main()
