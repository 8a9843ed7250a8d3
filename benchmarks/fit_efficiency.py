"""Effective samples per second of a fit beside the same model written plainly and beside nutpie, in one run.

    .venv/bin/python benchmarks/fit_efficiency.py

Every contender samples the posterior of `models/arma.toml` on `data/example`, one after the other on one
core. What counts is the least bulk effective sample size over the standard deviations, the population (b of
`bayestissue.model.hierarchy.population`) and K and C of every impact. See README.md for what each one is.
nutpie's low-rank adaptation is no contender: in an earlier version it got stuck (9 effective draws in 142 s).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from time import perf_counter, process_time
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from evidence import measure
from jax.flatten_util import ravel_pytree
from numpyro.distributions import biject_to
from numpyro.infer import NUTS
from numpyro.infer.util import initialize_model
from plain_hierarchy import check_density, cholesky_factor, plain

from bayestissue.base.resources import shared
from bayestissue.inference.chain.results import ChainDraws
from bayestissue.inference.factors.expansions import expanded
from bayestissue.inference.fit import sample
from bayestissue.inference.quantities.quantity_draws import posterior_draws
from bayestissue.model.hierarchy.gaussian.arrangement import expected
from bayestissue.model.hierarchy.specification import ModelSpecification, read_specification
from bayestissue.model.hierarchy.trace_data import Prepared, prepare
from bayestissue.model.hierarchy.trace_models import hyperparameters_at, trace_likelihood
from bayestissue.recordings.dataset import read_dataset

SEED = 1
# A plain chain's first transitions, whose draws are not counted: fewer than usual, so that some are left.
PLAIN_WARMUP, BLOCK = 60, 5
# Of a core, for each contender that samples the plain model: enough for an upper bound of its rate.
SECONDS = 15
Arrays = dict[str, np.ndarray]


def clocks() -> np.ndarray:
    """Seconds by the clock on the wall, and of this process: the core is also asked for by others."""
    return np.array([perf_counter(), process_time()])


@dataclass(frozen=True)
class Outcome:
    """What a contender came to: draws [chain, draw, ...] and the time that they took, by both clocks."""

    compiling: np.ndarray
    sampling: np.ndarray
    draws: Arrays
    gradients: float
    transitions: int
    remark: str


@dataclass
class Bench:
    """The job that all contenders do."""

    prepared: Prepared
    specification: ModelSpecification

    def chains(self) -> tuple[ChainDraws, Arrays, np.ndarray]:
        """A fit's draws, what is reported of them, and the time that they took."""
        begin = clocks()
        found = sample(self.prepared, self.specification.sampler, SEED)
        draws, model = posterior_draws(self.prepared, found, SEED), self.prepared.model
        parts = {name: draws.population[name] for name in (*model.hyperparameters, *model.locations.parts)}
        return found, parts | {name: np.log(draws.impacts[name]) for name in ("K", "C")}, clocks() - begin


def chain(bench: Bench) -> Outcome:
    """The fit twice: the first compiles as well, the second is what sampling takes."""
    *_, cold = bench.chains()
    found, quantities, warm = bench.chains()
    number, since = found.shape[0], found.segments
    warming = int(found.end.segments) - since
    transitions = number * found.segment * (warming + since)
    remark = f"{number} chains of {found.segment * warming} and {found.segment * since}"
    return Outcome(cold - warm, warm, quantities, 0.0, transitions, remark)


def plain_start(bench: Bench, key: jax.Array) -> dict[str, jax.Array]:
    """A point of the plain model where its posterior is: the last draw of a fit, errors drawn given it."""
    model, data = bench.prepared.model, bench.prepared.data
    found, *_ = bench.chains()
    # Where the first chain ended.
    y = jnp.asarray(found.end.state.y[0])
    b, u = jnp.asarray(found.population.b[0, -1]), list(jnp.asarray(found.u[0, -1]).T)
    hyperparameters = hyperparameters_at(model, y)[0]
    spread = model.covariances(hyperparameters)
    factor = cholesky_factor(
        *(hyperparameters[name] for name in ("sd_impact_K", "sd_impact_C", "residual_correlation"))
    )
    away = [each - mean for each, mean in zip(u, expected(data.design, b), strict=True)]
    errors = trace_likelihood(model, data, u).draw_errors(key)
    return dict(zip(model.hyperparameters, y, strict=True)) | {
        "standard_locations": (b - data.location_mean) / spread.locations,
        "standard_pair": jnp.linalg.solve(factor, jnp.stack(away[:2])).T,
        "standard_mass_error": jnp.zeros(len(data.log_mass)),
        "standard_errors": errors / data.record.error_sd,
        **{
            f"standard_{name}": away[a] / sd
            for a, (name, sd) in enumerate(zip(model.nuisance, spread.nuisance, strict=True), start=2)
        },
    }


def plain_quantities(bench: Bench, found: Arrays) -> Arrays:
    """The compared quantities from unconstrained draws of the plain model, [chain, draw, ...]."""
    model, data = bench.prepared.model, bench.prepared.data
    shape = next(iter(found.values())).shape[:2]
    if shape[1] == 0:
        return {"K": np.empty(shape)}

    def one(raw: dict[str, jax.Array]) -> dict[str, jax.Array]:
        from numpyro.handlers import seed, substitute, trace

        values = {
            name: biject_to(model.prior_of(name).support)(value) if name in model.hyperparameters else value
            for name, value in raw.items()
        }
        sites = trace(substitute(seed(partial(plain, model), 0), values)).get_trace(data)
        b = sites["locations"]["value"]
        parts = {name: b[part] for name, part in model.locations.parts.items()}
        spreads = {name: values[name] for name in model.hyperparameters}
        return spreads | parts | {"K": sites["log_K"]["value"], "C": sites["log_C"]["value"]}

    made = jax.lax.map(one, {name: jnp.asarray(v.reshape(-1, *v.shape[2:])) for name, v in found.items()})
    return {name: np.asarray(v).reshape(*shape, *v.shape[1:]) for name, v in made.items()}


def plain_numpyro(bench: Bench) -> Outcome:
    """One chain of numpyro's NUTS with its defaults, until the budget is spent."""
    data = bench.prepared.data
    kernel = NUTS(partial(plain, bench.prepared.model))
    key, own = jax.random.split(jax.random.PRNGKey(SEED))
    start = plain_start(bench, own)
    begin = clocks()
    state = kernel.init(key, PLAIN_WARMUP, start, (data,), {})

    def step(state: Any, _: None) -> tuple[Any, Any]:
        state = kernel.sample(state, (data,), {})
        return state, (state.z, state.num_steps)

    advance = jax.jit(lambda state: jax.lax.scan(step, state, None, length=BLOCK)).lower(state).compile()
    compiled = clocks()
    blocks: list[Any] = []
    while (clocks() - compiled)[1] < SECONDS:
        state, (z, num_steps) = jax.device_get(advance(state))
        blocks.append((z, num_steps))
    spent = clocks() - compiled
    every, steps = jax.tree.map(lambda *rows: np.concatenate(rows)[None], *blocks)
    kept = {name: values[:, PLAIN_WARMUP:] for name, values in every.items()}
    return cut_off(bench, kept, compiled - begin, spent, steps.sum(), BLOCK * len(blocks))


def plain_nutpie(bench: Bench) -> Outcome:
    """One chain of nutpie on the plain density, begun as numpyro's, until the budget is spent."""
    import nutpie
    from nutpie.compiled_pyfunc import from_pyfunc

    found = initialize_model(
        jax.random.PRNGKey(0), partial(plain, bench.prepared.model), model_args=(bench.prepared.data,)
    )
    middle, unravel = ravel_pytree(found.param_info.z)
    begin = clocks()
    both = (
        jax.jit(jax.value_and_grad(lambda flat: -found.potential_fn(unravel(flat)))).lower(middle).compile()
    )
    compiling = clocks() - begin

    def density(flat: np.ndarray) -> tuple[float, np.ndarray]:
        value, slope = both(flat)
        return float(value), np.asarray(slope)

    # A start where any slope is zero is refused, as that of a standard normal at 0 is.
    start = plain_start(bench, jax.random.split(jax.random.PRNGKey(SEED))[1])
    flat = np.asarray(ravel_pytree(start)[0]) + 1e-3
    shape = [np.dtype("float64")], [(middle.size,)], ["flat"]
    model = from_pyfunc(
        middle.size,
        lambda: density,
        lambda *_: lambda flat: {"flat": flat},
        *shape,
        make_initial_point_fn=lambda _: flat,
    )
    once = {"chains": 1, "cores": 1, "seed": SEED, "adaptation": "diag", "save_warmup": True}
    once |= {"progress_bar": False, "blocking": False}
    begin, tree = clocks(), None
    running = nutpie.sample(model, tune=PLAIN_WARMUP, draws=100_000, **once)
    while tree is None:
        try:
            tree = running.wait(timeout=1.0)
        except TimeoutError:
            tree = running.abort() if (clocks() - begin)[1] > SECONDS else None
    spent = clocks() - begin
    warming = tree["warmup_posterior"]["flat"].to_numpy()
    # Cut off while it warms up, it has drawn nothing.
    drawn = tree["posterior"]["flat"].to_numpy() if "posterior" in tree.children else warming[:, :0]
    groups = {"sample_stats", "warmup_sample_stats"} & set(tree.children)
    steps = sum(float(tree[group]["n_steps"].sum()) for group in groups)
    sites = jax.vmap(jax.vmap(unravel))(jnp.asarray(drawn))
    kept = {name: np.asarray(values) for name, values in sites.items()}
    return cut_off(bench, kept, compiling, spent, steps, warming[..., 0].size + drawn[..., 0].size)


def cut_off(
    bench: Bench, kept: Arrays, compiling: np.ndarray, spent: np.ndarray, steps: float, transitions: int
) -> Outcome:
    """Of one chain of the plain model, whose budget was spent."""
    count = next(iter(kept.values())).shape[1]
    remark = f"1 chain of {transitions - count} and {count}, cut off by the budget"
    return Outcome(compiling, spent, plain_quantities(bench, kept), float(steps), transitions, remark)


def per_element(draws: Arrays, measure: str, **options: str) -> Arrays:
    """One of ArviZ's measures of every element of every quantity."""
    # Imported before numpyro, ArviZ leaves numpyro.distributions without a module that numpyro asks for.
    from arviz_stats.base import array_stats

    of = getattr(array_stats, measure)
    return {
        name: np.array([float(of(values[:, :, i], **options)) for i in range(values.shape[2])])
        for name, values in ((n, v.reshape(*v.shape[:2], -1)) for n, v in draws.items())
    }


def row(outcome: Outcome) -> dict[str, Any]:
    """One line of the table; a chain that is cut off before it has 20 draws has an upper bound only."""
    chains, draws = next(iter(outcome.draws.values())).shape[:2]
    if draws < 20:
        # No more than if every transition, those of the warm-up too, had been an independent draw.
        worst, least, r_hat = "at most", float(outcome.transitions), np.nan
    else:
        ess = per_element(outcome.draws, "ess", method="bulk")
        halves = outcome.draws if chains > 1 else {name: in_halves(v) for name, v in outcome.draws.items()}
        r_hat = max(float(np.nanmax(values)) for values in per_element(halves, "rhat").values())
        worst = min(ess, key=lambda each: ess[each].min())
        least = float(ess[worst].min())
        if any((np.ptp(values, axis=1) == 0).any() for values in outcome.draws.values()):
            # A chain that stands still has no effective draws, whatever the formula says of constants.
            worst, least = "a chain stands still", 0.0
    wall, own = outcome.sampling
    return {
        "chains": chains,
        "draws": draws,
        "compiling_s": outcome.compiling[0],
        "sampling_s": wall,
        "own_sampling_s": own,
        "gradients_a_draw": outcome.gradients / outcome.transitions,
        "remark": outcome.remark,
        "worst": worst,
        "ess_bulk": least,
        "r_hat": r_hat,
        "per_s": least / wall,
        "per_own_s": least / own,
        "per_s_overall": least / (wall + outcome.compiling[0]),
    }


def in_halves(values: np.ndarray) -> np.ndarray:
    """One chain as two."""
    half = values.shape[1] // 2
    return np.concatenate([values[:, :half], values[:, half : 2 * half]])


CONTENDERS: dict[str, Callable[[Bench], Outcome]] = {
    "bayestissue": chain,
    "numpyro, plain model, started at our posterior": plain_numpyro,
    "nutpie (diag), plain model, started at our posterior": plain_nutpie,
}


@cache
def bench() -> Bench:
    """The job, once the plain density has been found to be the program's."""
    # The plain model has a gain of each impact among the latent errors of its chain.
    arma = read_specification(shared("models", "arma.toml"))
    specification = arma.model_copy(update={"gain_error": "impact"})
    prepared = prepare(read_dataset(shared("data", "example")), specification, source="arma.toml")
    check_density(prepared.model, prepared.data, list(expanded(prepared).centre.T))
    return Bench(prepared, specification)


def main() -> None:
    measure("fit_efficiency", CONTENDERS, lambda contender: row(contender(bench())))


if __name__ == "__main__":
    main()
