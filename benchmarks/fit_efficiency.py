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
from functools import partial
from time import perf_counter, process_time
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from evidence import recorded
from jax.flatten_util import ravel_pytree
from numpyro.distributions import biject_to
from numpyro.infer import NUTS
from numpyro.infer.util import initialize_model
from plain_hierarchy import check_density, cholesky_factor, plain

from bayestissue.base import runtime
from bayestissue.base.resources import shared
from bayestissue.inference.chain.results import ChainDraws
from bayestissue.inference.factors.expansions import expanded
from bayestissue.inference.fit import draws_of_chain, sample
from bayestissue.model.hierarchy.gaussian.arrangement import expected
from bayestissue.model.hierarchy.specification import ModelSpecification, read_specification
from bayestissue.model.hierarchy.trace_data import Prepared, prepare
from bayestissue.model.hierarchy.trace_models import hyperparameters_at, trace_likelihood
from bayestissue.recordings.dataset import read_dataset

SEED = 1
# A plain chain's first transitions, whose draws are not counted: fewer than usual, so that some are left.
PLAIN_WARMUP, BLOCK = 60, 5
# Of a core, for each contender that samples the plain model: enough for an upper bound of its rate.
MINUTES = 0.25
Arrays = dict[str, np.ndarray]


class Time(NamedTuple):
    """Seconds by the clock on the wall, and of this process: the core is also asked for by others."""

    wall: float
    own: float

    def __add__(self, other: Time) -> Time:  # type: ignore[override]
        """Both spent."""
        return Time(self.wall + other.wall, self.own + other.own)

    def __sub__(self, other: Time) -> Time:
        """What one took more than the other."""
        return Time(self.wall - other.wall, self.own - other.own)

    @classmethod
    def now(cls) -> Time:
        """Both clocks."""
        return cls(perf_counter(), process_time())


@dataclass(frozen=True)
class Outcome:
    """What a contender came to: draws [chain, draw, ...] and the time that they took."""

    compiling: Time
    sampling: Time
    draws: Arrays
    gradients: float
    remark: str = ""
    transitions: int = 0


@dataclass
class Bench:
    """The job that all contenders do."""

    prepared: Prepared
    specification: ModelSpecification
    budget: float

    def chains(self) -> tuple[ChainDraws, Arrays]:
        """A fit's draws, and what is reported of them."""
        found = sample(self.prepared, self.specification.sampler, SEED)
        draws, model = draws_of_chain(self.prepared, found, SEED), self.prepared.model
        parts = {name: draws.population[name] for name in (*model.hyperparameters, *model.locations.parts)}
        return found, parts | {name: np.log(draws.impacts[name]) for name in ("K", "C")}


def timed(call: Callable[[], Any]) -> tuple[Any, Time]:
    begin = Time.now()
    return call(), Time.now() - begin


def chain(bench: Bench) -> Outcome:
    """The fit twice: the first compiles as well, the second is what sampling takes."""
    _, cold = timed(bench.chains)
    (found, quantities), warm = timed(bench.chains)
    number, since = found.shape[0], found.segments
    warming = int(found.end.segments) - since
    transitions = number * found.segment * (warming + since)
    remark = f"{number} chains of {found.segment * warming} and {found.segment * since}"
    return Outcome(cold - warm, warm, quantities, 0.0, remark, transitions)


class FlatDensity:
    """A numpyro model's unconstrained log density as a function of one vector, compiled."""

    def __init__(self, model: Callable[..., None], arguments: tuple[Any, ...]) -> None:
        found = initialize_model(jax.random.PRNGKey(0), model, model_args=arguments)
        middle, self.unravel = ravel_pytree(found.param_info.z)
        self.size = middle.size
        potential = found.potential_fn
        both = jax.jit(jax.value_and_grad(lambda flat: -potential(self.unravel(flat))))
        self._both, self.compiling = timed(lambda: both.lower(middle).compile())

    def __call__(self, flat: np.ndarray) -> tuple[float, np.ndarray]:
        """Value and gradient."""
        value, slope = self._both(flat)
        return float(value), np.asarray(slope)


def nutpie_draws(
    density: FlatDensity,
    starts: Callable[[int], np.ndarray],
    *,
    tune: int,
    draws: int,
    chains: int,
    seconds: float = np.inf,
) -> tuple[Arrays, Time, float, int]:
    """Nutpie's draws by site, their time, gradients and transitions; stopped after ``seconds`` of its own."""
    import nutpie
    from nutpie.compiled_pyfunc import from_pyfunc

    model = from_pyfunc(
        density.size,
        lambda: density,
        lambda *_: lambda flat: {"flat": flat},
        [np.dtype("float64")],
        [(density.size,)],
        ["flat"],
        make_initial_point_fn=starts,
    )
    begin = Time.now()
    running = nutpie.sample(
        model,
        tune=tune,
        draws=draws,
        chains=chains,
        cores=1,
        seed=SEED,
        adaptation="diag",
        save_warmup=True,
        progress_bar=False,
        blocking=False,
    )
    tree = None
    while tree is None:
        try:
            tree = running.wait(timeout=None if np.isinf(seconds) else 1.0)
        except TimeoutError:
            tree = running.abort() if (Time.now() - begin).own > seconds else None
    spent = Time.now() - begin
    warming = tree["warmup_posterior"]["flat"].to_numpy()
    # Cut off while it warms up, it has drawn nothing.
    flat = tree["posterior"]["flat"].to_numpy() if "posterior" in tree.children else warming[:, :0]
    groups = {"sample_stats", "warmup_sample_stats"} & set(tree.children)
    steps = sum(float(tree[group]["n_steps"].sum()) for group in groups)
    transitions = warming[..., 0].size + flat[..., 0].size
    sites = jax.vmap(jax.vmap(density.unravel))(jnp.asarray(flat))
    return {name: np.asarray(values) for name, values in sites.items()}, spent, steps, transitions


def plain_start(bench: Bench, key: jax.Array) -> dict[str, jax.Array]:
    """A point of the plain model where its posterior is: the last draw of a fit, errors drawn given it."""
    model, data = bench.prepared.model, bench.prepared.data
    found, _ = bench.chains()
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
    begin = Time.now()
    state = kernel.init(key, PLAIN_WARMUP, start, (data,), {})

    def step(state: Any, _: None) -> tuple[Any, Any]:
        state = kernel.sample(state, (data,), {})
        return state, (state.z, state.num_steps)

    advance = jax.jit(lambda state: jax.lax.scan(step, state, None, length=BLOCK)).lower(state).compile()
    compiling, begin = Time.now() - begin, Time.now()
    blocks: list[Any] = []
    while (Time.now() - begin).own < bench.budget:
        state, (z, num_steps) = jax.device_get(advance(state))
        blocks.append((z, num_steps))
    spent = Time.now() - begin
    every, every_steps = jax.tree.map(lambda *rows: np.concatenate(rows)[None], *blocks)
    steps = float(every_steps.sum())
    kept = {name: values[:, PLAIN_WARMUP:] for name, values in every.items()}
    count = next(iter(kept.values())).shape[1]
    transitions = BLOCK * len(blocks)
    remark = f"1 chain of {min(transitions, PLAIN_WARMUP)} and {count}, cut off by the budget"
    return Outcome(compiling, spent, plain_quantities(bench, kept), steps, remark, transitions)


def plain_nutpie(bench: Bench) -> Outcome:
    """One chain of nutpie on the plain density, begun as numpyro's, until the budget is spent."""
    density = FlatDensity(partial(plain, bench.prepared.model), (bench.prepared.data,))
    start = plain_start(bench, jax.random.split(jax.random.PRNGKey(SEED))[1])
    # A start where any slope is zero is refused, as that of a standard normal at 0 is.
    flat = np.asarray(ravel_pytree(start)[0]) + 1e-3
    found, spent, steps, transitions = nutpie_draws(
        density,
        lambda _: flat,
        tune=PLAIN_WARMUP,
        draws=100_000,
        chains=1,
        seconds=bench.budget,
    )
    count = next(iter(found.values())).shape[1]
    remark = f"1 chain of {transitions - count} and {count}, cut off by the budget"
    return Outcome(density.compiling, spent, plain_quantities(bench, found), steps, remark, transitions)


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
    line = {
        "chains": chains,
        "draws": draws,
        "compiling_s": outcome.compiling.wall,
        "sampling_s": outcome.sampling.wall,
        "own_sampling_s": outcome.sampling.own,
        "gradients_a_draw": outcome.gradients / (outcome.transitions or chains * draws),
        "remark": outcome.remark,
    }
    if draws < 20:
        # No more than if every transition, those of the warm-up too, had been an independent draw.
        most = outcome.transitions
        return line | {
            "worst": "at most",
            "ess_bulk": most,
            "r_hat": np.nan,
            "per_s": most / outcome.sampling.wall,
            "per_own_s": most / outcome.sampling.own,
            "per_s_overall": most / (outcome.sampling + outcome.compiling).wall,
        }
    ess = per_element(outcome.draws, "ess", method="bulk")
    halves = outcome.draws if chains > 1 else {name: in_halves(v) for name, v in outcome.draws.items()}
    r_hat = per_element(halves, "rhat")
    worst = min(ess, key=lambda each: ess[each].min())
    least = float(ess[worst].min())
    if any((np.ptp(values, axis=1) == 0).any() for values in outcome.draws.values()):
        # A chain that stands still has no effective draws, whatever the formula says of constants.
        worst, least = "a chain stands still", 0.0
    return line | {
        "worst": worst,
        "ess_bulk": least,
        "r_hat": max(float(np.nanmax(values)) for values in r_hat.values()),
        "per_s": least / outcome.sampling.wall,
        "per_own_s": least / outcome.sampling.own,
        "per_s_overall": least / (outcome.sampling + outcome.compiling).wall,
    }


def in_halves(values: np.ndarray) -> np.ndarray:
    """One chain as two."""
    half = values.shape[1] // 2
    return np.concatenate([values[:, :half], values[:, half : 2 * half]])


def contenders() -> dict[str, Callable[[Bench], Outcome]]:
    return {
        "bayestissue": chain,
        "numpyro, plain model, started at our posterior": plain_numpyro,
        "nutpie (diag), plain model, started at our posterior": plain_nutpie,
    }


def main() -> None:
    runtime.configure()
    with recorded("fit_efficiency") as record:
        specification = read_specification(shared("models", "arma.toml"))
        prepared = prepare(read_dataset(shared("data", "example")), specification, source="arma.toml")
        bench = Bench(prepared, specification, 60 * MINUTES)
        centre = expanded(prepared).centre
        check_density(prepared.model, prepared.data, [centre[:, a] for a in range(centre.shape[1])])
        contend = contenders()
        for name in record.missing(contend):
            record.add(name, [row(contend[name](bench))])


if __name__ == "__main__":
    main()
