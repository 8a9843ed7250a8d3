"""The chain's moves, each of which leaves the posterior as it is.

A move proposes a whole state; the traces' likelihoods there are asked for in one place, and each impact's
part, or the whole, is accepted by the ratio of the target to the proposal:

`by_site`: every u at once from its site times the population's prior. Accepted impact by impact by
L' q / (L q'), q being the site.

`by_walk`: u + s L z with the impact's own covariance L L' and step s, accepted by its own likelihood and
prior.

`by_population`: y and b by a reversible walk on the sites' own posterior, in which every u is integrated
out; each u moves along, so that its standard normal z = R'(u − m) − h given its site stays. The target in
(y, b, z) is the sites' posterior times Π L / q, which is what accepts it (surrogate transitions: Liu 2001;
Christen and Fox 2005, doi:10.1198/106186005X76983).

`centred` asks for no trace: y by a walk with every u fixed and b integrated out, then b from its conditional.

Every random number of a transition is drawn before its first move: calls for a few at a time cost more, in
the compiler and in every step, than what is done with them.

The last two are the non-centred and the centred parametrisation of the hierarchy, interwoven (Yu and Meng
2011, doi:10.1198/jcgs.2011.203main). A trace with several explanations has several sites: q is their sum, and
one of them, drawn by its share in q at u, makes the proposal.
"""

from __future__ import annotations

import math
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.scipy.special import logsumexp
from jaxtyping import Float

from bayestissue.hierarchy.gaussian.factor import GaussianFactor
from bayestissue.inference.chain.settings import ChainSettings
from bayestissue.inference.chain.target import LogRatios, Target
from bayestissue.likelihood import small

_BY_SITE, _BY_WALK, _BY_POPULATION = range(3)


class State(NamedTuple):
    """Where a chain is.

    Attributes:
        y: hyperparameters, unconstrained.
        b: fixed and group effects.
        u: each impact's parameters.
        log_likelihood: of each trace there.
    """

    y: Float[Array, " hyperparameter"]
    b: Float[Array, " location"]
    u: Float[Array, "parameter impact"]
    log_likelihood: Float[Array, " impact"]


class Visited(NamedTuple):
    """What is kept of a state, whatever is kept of impacts.

    Attributes:
        y: hyperparameters, unconstrained.
        b: fixed and group effects.
        log_likelihood: of all traces together.
        log_ratios: of likelihoods over sites.
    """

    y: Float[Array, " hyperparameter"]
    b: Float[Array, " location"]
    log_likelihood: Float[Array, ""]
    log_ratios: LogRatios


class Steps(NamedTuple):
    """Lengths of the walks, in units of the posterior's own: of each impact, and of y by either move."""

    impact: Float[Array, " impact"]
    centred: Float[Array, ""]
    population: Float[Array, ""]


class Tuning(NamedTuple):
    """What the warm-up found, for all chains alike.

    Attributes:
        sites: of the traces; where some have several explanations, of each, along the first axis.
        root: Cholesky factor of y's covariance.
        impact_root: of that of each impact's parameters.
    """

    sites: GaussianFactor
    root: Float[Any, "hyperparameter hyperparameter"]
    impact_root: Float[Any, "impact parameter parameter"]


class Acceptances(NamedTuple):
    """Shares of one transition's proposals that were accepted; of impacts the mean.

    Attributes:
        site: of `by_site`.
        walk: of `by_walk`, of each impact.
        population: of `by_population`.
        inner: of the surrogate's own walk.
        centred: of `centred`'s.
    """

    site: Float[Array, ""]
    walk: Float[Array, " impact"]
    population: Float[Array, ""]
    inner: Float[Array, ""]
    centred: Float[Array, ""]


class WalkNumbers(NamedTuple):
    """Random numbers of a walk of the hyperparameters, and of b given its last step."""

    step: Float[Array, "step hyperparameter"]
    decision: Float[Array, " step"]
    effects: Float[Array, " location"]


class MoveNumbers(NamedTuple):
    """Random numbers of one move of the impacts: normal ones, and uniform ones for choice and decision.

    Attributes:
        impacts: normal, of every impact's parameters.
        label: uniform, which of an impact's explanations makes the proposal.
        decision: uniform, whether an impact's part is accepted, or the whole by the first.
        walk: of the hyperparameters.
    """

    impacts: Float[Array, "parameter impact"]
    label: Float[Array, " impact"]
    decision: Float[Array, " impact"]
    walk: WalkNumbers


class Numbers(NamedTuple):
    """All random numbers of one transition: of `centred`, and of each evaluation of the traces."""

    centred: WalkNumbers
    moves: MoveNumbers


def random_numbers(target: Target, settings: ChainSettings, key: Array) -> Numbers:
    """The random numbers of one transition, from one call for each kind."""
    size, impacts = 2 + len(target.model.nuisance), len(target.present)
    number, locations = len(target.model.hyperparameters), target.model.locations.size
    evaluations, inner, centred = settings.evaluations, settings.inner + 1, settings.centred + 1
    keys = jax.random.split(key)
    of_impacts, *steps_and_effects = _parts(
        partial(jax.random.normal, keys[0]),
        (evaluations, size, impacts),
        (evaluations, inner, number),
        (evaluations, locations),
        (centred, number),
        (locations,),
    )
    label, decision, of_inner, of_centred = _parts(
        partial(jax.random.uniform, keys[1]),
        (evaluations, impacts),
        (evaluations, impacts),
        (evaluations, inner),
        (centred,),
    )
    inner_steps, inner_effects, centred_steps, centred_effects = steps_and_effects
    walk = WalkNumbers(inner_steps, of_inner, inner_effects)
    return Numbers(
        WalkNumbers(centred_steps, of_centred, centred_effects),
        MoveNumbers(of_impacts, label, decision, walk),
    )


def _parts(draw: Any, *shapes: tuple[int, ...]) -> list[Array]:
    """Arrays of these shapes, of one call's numbers."""
    ends = np.cumsum([math.prod(shape) for shape in shapes])
    parts = jnp.split(draw((int(ends[-1]),)), ends[:-1])
    return [part.reshape(shape) for part, shape in zip(parts, shapes, strict=True)]


class Proposal(NamedTuple):
    """What a move proposes.

    Attributes:
        state: the new state, its likelihood the old one's.
        log_ratio: what is to be added to each trace's own log ratio of likelihoods.
        inner: acceptance of the surrogate's walk, if the move has one.
    """

    state: State
    log_ratio: Float[Array, " impact"]
    inner: Float[Array, ""]


def log_sites(
    sites: GaussianFactor, u: Float[Array, "parameter impact"], *, first: bool = False
) -> Float[Array, " impact"]:
    """Log q of every impact, the sum over its sites, or the first of them alone."""
    log_density = sites.log_density(u.T)
    return log_density[0] if first or len(log_density) == 1 else logsumexp(log_density, axis=0)


def _one_each(sites: GaussianFactor, log_weight: Any, uniform: Float[Array, " impact"]) -> GaussianFactor:
    """Of each impact one of its sites, drawn by these weights [site, impact]."""
    if len(sites.centre) == 1:
        return jax.tree.map(lambda leaf: leaf[0], sites)
    below = jnp.cumsum(jax.nn.softmax(log_weight(), axis=0), axis=0)
    chosen = (uniform > below[:-1]).sum(0)
    return jax.tree.map(lambda leaf: leaf[chosen, jnp.arange(leaf.shape[1])], sites)


def by_site(target: Target, tuning: Tuning, steps: Steps, state: State, numbers: MoveNumbers) -> Proposal:
    """Every impact's parameters from its site and the population."""
    mean = target.prior_mean(state.b)

    def log_evidence() -> Array:
        of_each = [
            target.impact_given(state.y, jax.tree.map(lambda leaf: leaf[n], tuning.sites))  # noqa: B023
            for n in range(len(tuning.sites.centre))
        ]
        return jnp.stack([conditional.marginal(list(mean)).log_scale for conditional in of_each])

    conditional = target.impact_given(state.y, _one_each(tuning.sites, log_evidence, numbers.label))
    u = jnp.stack(conditional.draw(list(mean), list(numbers.impacts)))
    log_ratio = log_sites(tuning.sites, state.u) - log_sites(tuning.sites, u)
    return Proposal(state._replace(u=u), log_ratio, jnp.zeros(()))


def by_walk(target: Target, tuning: Tuning, steps: Steps, state: State, numbers: MoveNumbers) -> Proposal:
    """Every impact's parameters a step further, by its own covariance."""
    mean, D = target.prior_mean(state.b), target.covariances(state.y).of_impact()
    u = state.u + steps.impact * jnp.einsum("iab,bi->ai", tuning.impact_root, numbers.impacts)

    def log_prior(u: Array) -> Array:
        return -((u - mean) * jnp.einsum("ab,bi->ai", D, u - mean)).sum(0) / 2

    return Proposal(state._replace(u=u), log_prior(u) - log_prior(state.u), jnp.zeros(()))


def by_population(
    target: Target, tuning: Tuning, steps: Steps, state: State, numbers: MoveNumbers
) -> Proposal:
    """Hyperparameters and effects by the sites' own posterior, every impact's parameters along with them."""
    sites = _one_each(tuning.sites, lambda: tuning.sites.log_density(state.u.T), numbers.label)
    here, mean = target.impact_given(state.y, sites), target.prior_mean(state.b)
    pulled = small.turned_times(here.root, list(state.u - here.factor.centre))
    standard = [p - h for p, h in zip(pulled, here.half(list(mean)), strict=True)]
    density = partial(target.given_sites, blocked=target.blocked(sites))
    scale = steps.population * tuning.root
    y, effects, inner = walk(density, state.y, scale, numbers.walk)
    b = target.effects_at(effects, numbers.walk.effects)
    there = target.impact_given(y, sites)
    u = jnp.stack(there.draw(list(target.prior_mean(b)), standard))
    log_ratio = log_sites(tuning.sites, state.u) - log_sites(tuning.sites, u)
    return Proposal(state._replace(y=y, b=b, u=u), log_ratio, inner)


PROPOSALS = (by_site, by_walk, by_population)


def centred(
    target: Target, tuning: Tuning, steps: Steps, state: State, numbers: WalkNumbers
) -> tuple[State, Array]:
    """Hyperparameters and effects with every impact's parameters fixed."""
    density = partial(target.given_impacts, sums=target.cell_sums(state.u))
    y, effects, rate = walk(density, state.y, steps.centred * tuning.root, numbers)
    return state._replace(y=y, b=target.effects_at(effects, numbers.effects)), rate


def walk(density: Any, y: Array, scale: Array, numbers: WalkNumbers) -> tuple[Array, Any, Array]:
    """A random walk of y, what ``density`` gives at its end, and the share of the steps that was accepted.

    Args:
        density: what has a ``log_density``, of y.
        y: where it begins.
        scale: of a step, a matrix.
        numbers: one step more than are tried.
    """
    number = len(numbers.decision) - 1

    def step(index: Array, at: Any) -> Any:
        y, effects, rate = at
        # The first step stays where it is, and is taken: what is compiled has the density once.
        moved = jnp.where(index > 0, 1.0, 0.0)
        proposed = y + moved * (scale @ numbers.step[index])
        there = density(proposed)
        likelier = jnp.log(numbers.decision[index]) < there.log_density - effects.log_density
        accepted = likelier | (index == 0)
        return *_either(accepted, (proposed, there), (y, effects)), rate + moved * accepted / number

    nothing = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), jax.eval_shape(density, y))
    return jax.lax.fori_loop(0, number + 1, step, (y, nothing, jnp.zeros(())))


def _either(accepted: Array, new: Any, old: Any) -> Any:
    return jax.tree.map(lambda a, b: jnp.where(accepted, a, b), new, old)


def decided(
    target: Target, state: State, proposal: Proposal, uniform: Float[Array, " impact"], *, whole: Any
) -> tuple[State, Float[Array, " impact"]]:
    """The state after a proposal, and of each impact that there is 1 where its part was accepted, else 0.

    Args:
        target: the posterior.
        state: before it.
        proposal: what is proposed.
        uniform: random numbers that decide.
        whole: whether all of it is accepted or nothing, else each impact's part by itself.
    """
    value = target.log_likelihood(proposal.state.u)
    log_ratio = jnp.where(target.present, value - state.log_likelihood + proposal.log_ratio, 0.0)
    decision = jnp.log(uniform)
    together = decision[0] < log_ratio.sum()
    accepted = jnp.where(whole, together, decision < log_ratio)
    u, value = _either(accepted, (proposal.state.u, value), (state.u, state.log_likelihood))
    y, b = _either(whole & together, proposal.state[:2], state[:2])
    return State(y, b, u, value), jnp.where(target.present, accepted, 0.0)


def transition(
    target: Target,
    settings: ChainSettings,
    tuning: Tuning,
    gain: Float[Array, ""],
    carried: tuple[State, Steps],
    key: Array,
) -> tuple[tuple[State, Steps], tuple[Visited, Acceptances]]:
    """Every move once or more; then steps follow their acceptances, unless ``gain`` is 0."""
    state, steps = carried
    numbers = random_numbers(target, settings, key)
    state, of_centred = centred(target, tuning, steps, state, numbers.centred)

    def move(index: Array, at: tuple[State, Acceptances]) -> tuple[State, Acceptances]:
        # One copy of the likelihood serves all moves: each more would be compiled again.
        state, rates = at
        kind = jnp.where(index == 0, _BY_SITE, jnp.where(index <= settings.walks, _BY_WALK, _BY_POPULATION))
        of_move = jax.tree.map(lambda leaf: leaf[index], numbers.moves)
        moves = [partial(move, target, tuning, steps) for move in PROPOSALS]
        proposal = jax.lax.switch(kind, moves, state, of_move)
        whole = kind == _BY_POPULATION
        state, accepted = decided(target, state, proposal, of_move.decision, whole=whole)
        mean = accepted.sum() / target.present.sum()
        rates = Acceptances(
            rates.site + jnp.where(kind == _BY_SITE, mean, 0.0),
            rates.walk + jnp.where(kind == _BY_WALK, accepted, 0.0) / max(settings.walks, 1),
            rates.population + jnp.where(whole, mean, 0.0) / max(settings.surrogates, 1),
            rates.inner + proposal.inner / max(settings.surrogates, 1),
            rates.centred,
        )
        return state, rates

    none, of_impacts = jnp.zeros(()), jnp.zeros(len(target.present))
    rates = Acceptances(none, of_impacts, none, none, of_centred)
    state, rates = jax.lax.fori_loop(0, settings.evaluations, move, (state, rates))

    def followed(step: Array, rate: Array, wanted: float, bounds: tuple[float, float]) -> Array:
        return jnp.clip(step * jnp.exp(gain * (rate - wanted)), *bounds)

    of_population = settings.population_acceptance, settings.population_steps
    steps = Steps(
        followed(steps.impact, rates.walk, settings.impact_acceptance, settings.impact_steps),
        followed(steps.centred, rates.centred, *of_population),
        followed(steps.population, rates.inner, *of_population),
    )
    log_ratios = target.log_ratios(state.log_likelihood - log_sites(tuning.sites, state.u, first=True))
    return (state, steps), (Visited(state.y, state.b, state.log_likelihood.sum(), log_ratios), rates)
