"""Draws from the posterior of hyperparameters, effects and every impact's parameters, by one Markov chain."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from bayestissue.hierarchy.gaussian.factor import GaussianFactor
from bayestissue.hierarchy.specification import Sampler
from bayestissue.hierarchy.trace_data import Prepared
from bayestissue.hierarchy.traces import TraceModel, constrained, population
from bayestissue.inference.chain.ending import Verdict
from bayestissue.inference.chain.moves import Acceptances, State, Steps, Tuning, transition
from bayestissue.inference.chain.run import Chains, Say, Segment, sampled, warmed_up
from bayestissue.inference.chain.settings import ChainSettings
from bayestissue.inference.chain.target import Target
from bayestissue.inference.chain.warm_up import begin, retuned
from bayestissue.inference.execution.compiling import FULLY, by_row
from bayestissue.inference.factors.conditional import DRAWS, PopulationDraws
from bayestissue.padding import padded_impacts

SETTINGS = ChainSettings()


@dataclass(frozen=True)
class ChainDraws:
    """The last half of all transitions since the warm-up, [chain, draw, ...], impacts before parameters.

    Attributes:
        y: hyperparameters, unconstrained.
        b: fixed and group effects.
        u: each impact's parameters.
        log_likelihood: of each trace.
        acceptance: of each move, the mean.
        sites: of the traces, the first of each, as the warm-up left them.
        segments: of the warm-up, and since.
        segment: transitions of one.
        verdict: of the last look.
    """

    y: Float[np.ndarray, "chain draw hyperparameter"]
    b: Float[np.ndarray, "chain draw location"]
    u: Float[np.ndarray, "chain draw impact parameter"]
    log_likelihood: Float[np.ndarray, "chain draw impact"]
    acceptance: dict[str, float]
    sites: GaussianFactor
    segments: tuple[int, int]
    segment: int
    verdict: Verdict

    @property
    def shape(self) -> tuple[int, int]:
        """The numbers of chains and of draws of each."""
        return self.y.shape[0], self.y.shape[1]

    def thinned(self, draws: int) -> ChainDraws:
        """The same with at most so many draws of each chain, evenly spaced, the last among them."""
        number = self.y.shape[1]
        rows = np.unique(np.linspace(number - 1, 0, min(draws, number)).round().astype(int))
        thinned = {name: getattr(self, name)[:, rows] for name in ("y", "b", "u", "log_likelihood")}
        return replace(self, **thinned)

    def population(self, model: TraceModel) -> PopulationDraws:
        """Hyperparameters and effects of all draws, one chain's after the other's."""
        y, b = (values.reshape(-1, values.shape[-1]) for values in (self.y, self.b))
        sites, precision = _constrained(model, y)
        return PopulationDraws(dict(zip(model.hyperparameters, y.T, strict=True)), sites, b, precision)

    def log_ratio(self) -> Float[np.ndarray, "draw impact"]:
        """Log of each trace's likelihood over its site at every draw, one chain's after the other's."""
        u = self.u.reshape(-1, *self.u.shape[2:])
        ratio = self.log_likelihood.reshape(len(u), -1) - self.sites.log_density(u)
        return np.asarray(ratio)

    def record(self) -> dict[str, Any]:
        """How the chain ran, as it stands in ``run.json``."""
        warm, since = self.segments
        moves = ", ".join(f"{name} {share:.0%}" for name, share in self.acceptance.items())
        return {
            "words": (
                "Sampled by one Markov chain over hyperparameters, effects and impacts, "
                f"{since * self.segment} transitions of each chain after {warm * self.segment} of warm-up; "
                f"accepted: {moves}."
            ),
            "segments": since,
            "warm_up_segments": warm,
            "acceptance": self.acceptance,
        }


@by_row(DRAWS, constant=1)
def _constrained(model: TraceModel, y: Float[Array, " hyperparameter"]) -> tuple[dict[str, Array], Array]:
    """Constrained hyperparameters, and the precision of an impact's parameters about X b."""
    sites = constrained(model, dict(zip(model.hyperparameters, y, strict=True)))
    return sites, population(model, sites).of_impact()


@partial(jax.jit, static_argnames="settings", compiler_options=FULLY)
def _advanced(
    target: Target,
    settings: ChainSettings,
    tuning: Tuning,
    carried: tuple[State, Steps],
    key: Array,
    gain: Float[Array, ""],
) -> Segment:
    keys = jax.random.split(key, settings.segment)
    of_segment = jax.lax.scan(partial(transition, target, settings, tuning, gain), carried, keys)
    return Segment(of_segment[0], *of_segment[1])


def chain_draws(
    prepared: Prepared,
    sites: GaussianFactor,
    sampler: Sampler,
    seed: int,
    *,
    settings: ChainSettings = SETTINGS,
    progress: Say = lambda *_: None,
    checkpoints: Path | None = None,
) -> ChainDraws:
    """Draws from the posterior of everything.

    Args:
        prepared: model and data.
        sites: of the traces, [site, impact, ...]; the chain is exact whatever they are, and faster the
            nearer they are.
        sampler: how many chains, and how many effective draws.
        seed: of all of it.
        settings: how long its parts are.
        progress: told the stage, how much of it is done, and its total.
        checkpoints: an existing folder to which finished segments are written, and in which those of an
            earlier run of the same job are looked for.
    """
    target, count = Target.from_prepared(prepared), len(prepared.impacts)
    keys = jax.random.split(jax.random.PRNGKey(seed), sampler.chains)
    # Filled up with copies of the first, which count nowhere.
    padded = GaussianFactor(*map(jnp.asarray, padded_impacts(sites, 1)))
    start = begin(target, padded, sampler.chains, np.random.default_rng(seed))
    carried = list(zip(start.states, start.steps, strict=True))
    like = Segment(carried[0], start.states[0], Acceptances(*range(len(Acceptances._fields))))
    run = Chains(partial(_advanced, target, settings), settings, keys, carried, like, checkpoints)

    def next_tuning(tuning: Tuning, visited: State, first: bool) -> Tuning:
        return retuned(tuning, start.tuning, visited, refit=not first)

    tuning = warmed_up(run, start.tuning, next_tuning, progress)
    warm = run.number
    drawn = sampled(run, tuning, _quantities, progress, sampler=sampler, kept=partial(_trimmed, count=count))
    path: State = drawn.path
    return ChainDraws(
        y=np.asarray(path.y),
        b=np.asarray(path.b),
        u=np.moveaxis(np.asarray(path.u), -1, -2),
        log_likelihood=np.asarray(path.log_likelihood),
        acceptance=dict(drawn.rates._asdict()),
        sites=GaussianFactor(*(np.asarray(leaf)[0, :count] for leaf in tuning.sites)),
        segments=(warm, drawn.segments),
        segment=settings.segment,
        verdict=drawn.verdict,
    )


def _trimmed(visited: State, count: int) -> State:
    """Without the impacts that fill up."""
    u, log_likelihood = visited.u[..., :count], visited.log_likelihood[..., :count]
    return visited._replace(u=u, log_likelihood=log_likelihood)


def _quantities(drawn: State) -> tuple[np.ndarray, np.ndarray]:
    """Hyperparameters and effects, and impacts' parameters, [quantity, chain, draw]."""
    population = np.concatenate([drawn.y, drawn.b], axis=-1)
    impacts = np.reshape(drawn.u, (*drawn.u.shape[:2], -1))
    return np.moveaxis(population, -1, 0), np.moveaxis(impacts, -1, 0)
