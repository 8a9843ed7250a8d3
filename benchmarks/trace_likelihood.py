"""Time the log densities that `bayestissue fit` evaluates on the traces of data/example, and their gradients.

    python benchmarks/trace_likelihood.py

For each likelihood of a free mass's traces: the log density of all 90 impacts at their point estimates, and
it with its gradient by each impact's own parameters, errors of the measuring chain integrated out; least of
many.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from time import perf_counter
from typing import Any

import jax
import jax.numpy as jnp
from evidence import recorded

from bayestissue.base.runtime import configure
from bayestissue.inference.factors.expansions import first_guess
from bayestissue.model.hierarchy.specification import read_specification
from bayestissue.model.hierarchy.trace_data import prepare
from bayestissue.model.hierarchy.trace_models import Kind, trace_likelihood
from bayestissue.recordings.dataset import read_dataset

LIKELIHOODS: tuple[Kind, ...] = ("arma", "a2", "impact")
ROUNDS, BURST = 100, 10
HERE = Path(__file__).resolve().parents[1]


def calls(kind: Kind) -> dict[str, Callable[[], Any]]:
    """Log density, and it with its gradient."""
    specification = read_specification(HERE / "models" / f"{kind}.toml")
    prepared = prepare(read_dataset(HERE / "data" / "example"), specification, source=kind)
    model, data, u = prepared.model, prepared.data, list(jnp.asarray(first_guess(prepared)).T)

    def density(u: list[jax.Array], data: Any) -> jax.Array:
        return trace_likelihood(model, data, u).log_density().sum()

    value, both = jax.jit(density), jax.jit(jax.value_and_grad(density))
    return {"value": lambda: value(u, data), "value and gradient": lambda: both(u, data)}


def least(contenders: dict[str, Callable[[], Any]]) -> dict[str, float]:
    """The least time of a call of each [ms]."""
    times = dict.fromkeys(contenders, float("inf"))
    for _ in range(ROUNDS):
        for name, call in contenders.items():
            for _ in range(BURST):
                begin = perf_counter()
                jax.block_until_ready(call())
                times[name] = min(times[name], 1e3 * (perf_counter() - begin))
    return times


def main() -> None:
    configure()
    with recorded("trace_likelihood") as record:
        record.write([{"likelihood": kind} | least(calls(kind)) for kind in LIKELIHOODS])


if __name__ == "__main__":
    main()
