"""The chain's moves, each of which leaves the posterior as it is.

A move proposes a whole state; the traces' likelihoods there are asked for in one place, and each impact's
part, or the whole, is accepted by the ratio of the target to the proposal:

`by_impact`: every u at once, each accepted by itself, in one of two ways that chance decides. `by_site`:
from its site times the population's prior, accepted by L' q / (L q'), q being the site. `by_walk`: u + s L z
with the impact's own covariance L L' and step s, K and C over M + m where tissue of a mass m moves along,
accepted by its own likelihood and prior.

`by_population`: y by a reversible walk on the sites' own posterior, in which b and every u are integrated
out, and b's standard normals given y by an autoregressive step of the same length; each u moves along, so
that its standard normal z = R'(u − m) − h given its site stays. The target in (y, b, z) is the sites'
posterior times Π L / q, which is what accepts it (surrogate transitions: Liu 2001; Christen and Fox 2005,
doi:10.1198/106186005X76983).

`by_level`: the effects of every level of the grouping that is eliminated first, such as every person's, by a
walk along which the level's impacts shift; accepted level by level by L' / L times the effects' prior.

`by_common`, of a parameter that is nearly the same of all impacts, so that one trace hardly tells it and all
together do: its mean further, or its deviations and their spread by one factor; b from its conditional. Of
the mass m of tissue that moves along, K and C go with M + m, which leaves what a deceleration shows but for
its height.

`centred` asks for no trace: y by a walk with every u fixed and b integrated out, then b from its conditional.

Either walk of y stands on a multivariate t that is near y's posterior, as the warm-up left it: a step of 1 is
nearly a draw from it, short ones are those of a random walk (the preconditioned walk of Cotter et al. 2013,
doi:10.1214/13-STS421, for a t instead of a normal). Where hyperparameters are many or their posterior is
bent, steps adapt and grow shorter.

Every random number of a move is drawn before it: calls for a few at a time cost more, in the compiler and in
every step, than what is done with them.

The last three are non-centred and centred parametrisations of the hierarchy, interwoven (Yu and Meng
2011, doi:10.1198/jcgs.2011.203main). A trace with several explanations has several sites: q is their sum, and
one of them, drawn by its share in q at u, makes the proposal.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple, Self

import jax
import jax.numpy as jnp
from jax import Array
from jax.flatten_util import ravel_pytree
from jax.lax import erf_inv
from jax.scipy.linalg import solve_triangular
from jax.scipy.special import logsumexp
from jaxtyping import Bool, Float, Int
from numpyro.distributions import biject_to

from bayestissue.inference.chain.chain_settings import ChainSettings
from bayestissue.inference.chain.target import LogRatios, Target
from bayestissue.model.hierarchy.gaussian.factor import GaussianFactor
from bayestissue.model.likelihood import small

# Of the t that the walks of hyperparameters stand on: tails heavier than any posterior of theirs.
FREEDOM = 6
Shapes = list[tuple[int, ...]]
# Of a uniform random number: twice that is no less than a step from 1, and the normal one finite.
_LEAST = 1e-15


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
    """What is kept of a state.

    Attributes:
        y: hyperparameters, unconstrained.
        b: fixed and group effects.
        log_likelihood: of all traces together.
        log_ratios: of likelihoods over sites.
        u: of every so many states each impact's parameters.
        traces: of these states log likelihood of each trace.
    """

    y: Float[Array, " hyperparameter"]
    b: Float[Array, " location"]
    log_likelihood: Float[Array, ""]
    log_ratios: LogRatios
    u: Float[Array, "parameter impact"] | None = None
    traces: Float[Array, " impact"] | None = None


class StudentT(NamedTuple):
    """A multivariate t distribution of `FREEDOM` degrees of freedom.

    Attributes:
        location: its mean.
        root: Cholesky factor of its scale.
    """

    location: Float[Any, " hyperparameter"]
    root: Float[Any, "hyperparameter hyperparameter"]


class Steps(NamedTuple):
    """What follows the acceptances in the warm-up.

    Attributes:
        impact: length of a walk's step, of each impact, in units of its own posterior.
        walks: how often each impact goes by a walk: the oftener, the less often its site is accepted.
        centred: length of a step of y with the impacts fixed, at most 1.
        population: of y and b on the sites' posterior, likewise; short where sites are poor.
        level: of each level's effects, in units of their own posterior.
    """

    impact: Float[Array, " impact"]
    walks: Float[Array, " impact"]
    centred: Float[Array, ""]
    population: Float[Array, ""]
    level: Float[Array, " level"]


class Tuning(NamedTuple):
    """What the warm-up found, for all chains alike.

    Attributes:
        sites: of the traces; where some have several explanations, of each, along the first axis.
        population: near y's posterior.
        impact_root: of the covariance of each impact's parameters, K and C as `Target.per_inertia` has them.
        level_root: of that of each level's effects.
        common: near the posterior of the mean over impacts of `Target.common`, and of its spread's
            coordinate, each by itself, ``root`` their standard deviations.
        along: how each impact's parameters go along with that mean.
    """

    sites: GaussianFactor
    population: StudentT
    impact_root: Float[Any, "impact parameter parameter"]
    level_root: Float[Any, "level inner inner"]
    common: StudentT
    along: Float[Any, "parameter impact"]


@partial(jax.tree_util.register_dataclass, data_fields=["target", "tuning", "gain"], meta_fields=["settings"])
@dataclass(frozen=True)
class Kernel:
    """The transition kernel of a chain.

    Attributes:
        target: the posterior that it leaves as it is.
        settings: of the run.
        tuning: what the warm-up found.
        gain: by how much the log of a step follows its acceptance; 0 when draws count.
    """

    target: Any
    settings: ChainSettings
    tuning: Any
    gain: float | Float[Array, ""] = 0.0


class Acceptances(NamedTuple):
    """Shares of one transition's proposals that were accepted, no number where there were none.

    Attributes:
        site: of `by_site`.
        walk: of `by_walk`.
        population: of `by_population`.
        inner: of the surrogate's own walk.
        level: of `by_level`.
        centred: of `centred`'s.
    """

    site: Float[Array, ""]
    walk: Float[Array, ""]
    population: Float[Array, ""]
    inner: Float[Array, ""]
    level: Float[Array, ""]
    centred: Float[Array, ""]


class WalkNumbers(NamedTuple):
    """Random numbers of a walk of the hyperparameters, of the t's scale, and of b given the last step."""

    step: Float[Array, "step hyperparameter"]
    scale: Float[Array, "step freedom"]
    effects: Float[Array, " location"]
    decision: Float[Array, " step"]


class MoveNumbers(NamedTuple):
    """Random numbers of one move of the impacts: normal ones, and uniform ones for choice and decision.

    Attributes:
        impacts: normal, of every impact's parameters.
        way: uniform, whether an impact goes by its site or by a walk; the first, what moves the population.
        label: uniform, which of an impact's explanations makes the proposal.
        decision: uniform, whether the part that an impact, a level or all belong to is accepted.
        walk: of the hyperparameters.
    """

    impacts: Float[Array, "parameter impact"]
    way: Float[Array, " impact"]
    label: Float[Array, " impact"]
    decision: Float[Array, " part"]
    walk: WalkNumbers

    def shard(self, target: Target) -> Self:
        """Of the impacts that this device has."""
        impacts, way, label = map(target.shard, (self.impacts, self.way, self.label))
        return self._replace(impacts=impacts, way=way, label=label)


def walk_numbers(target: Target, steps: int, key: Array) -> WalkNumbers:
    """The random numbers of a walk by itself."""
    of_walk, uniform = _drawn(key, _of_walk(target, steps + 1), [(steps + 1,)])
    return WalkNumbers(*of_walk, *uniform)


def move_numbers(target: Target, settings: ChainSettings, key: Array) -> MoveNumbers:
    """The random numbers of one move of the impacts."""
    size, impacts, steps = 2 + len(target.model.nuisance), target.impacts, settings.inner + 1
    normal, uniform = [(size, impacts), *_of_walk(target, steps)], [(impacts,), (impacts,), (target.parts,)]
    numbers, uniform_numbers = _drawn(key, normal, [*uniform, (steps,)])
    of_impacts, step, scale, effects = numbers
    way, label, decision, of_steps = uniform_numbers
    return MoveNumbers(of_impacts, way, label, decision, WalkNumbers(step, scale, effects, of_steps))


def _of_walk(target: Target, steps: int) -> Shapes:
    """Of its normal numbers."""
    number = len(target.model.hyperparameters)
    return [(steps, number), (steps, number + FREEDOM), (target.model.locations.size,)]


def _drawn(key: Array, normal: Shapes, uniform: Shapes) -> tuple[list[Array], list[Array]]:
    """Normal and uniform random numbers, all of one call."""
    flat, in_shapes = ravel_pytree([[jnp.zeros(shape) for shape in shapes] for shapes in (normal, uniform)])
    uniform_numbers = jax.random.uniform(key, flat.shape, minval=_LEAST)
    # Without the barrier they are made anew wherever they are used.
    below, among = in_shapes(jax.lax.optimization_barrier(uniform_numbers))
    return [math.sqrt(2) * erf_inv(2 * values - 1) for values in below], among


class Proposal(NamedTuple):
    """What a move proposes.

    Attributes:
        state: the new state, its likelihood the old one's.
        log_ratio: what is to be added to each trace's own log ratio of likelihoods.
        part: of each impact, the number of the part that is accepted or not.
        effect: the same of each element of b; y belongs to the first.
        log_prior: what is to be added to each part's sum of these.
        inner: acceptance of the surrogate's walk, if the move has one.
    """

    state: State
    log_ratio: Float[Array, " impact"]
    part: Int[Array, " impact"]
    effect: Int[Array, " location"]
    log_prior: Float[Array, " part"]
    inner: Float[Array, ""]

    @classmethod
    def of_impacts(cls, target: Target, state: State, log_ratio: Float[Array, " impact"]) -> Self:
        """Of impacts alone, each by itself."""
        effects = jnp.zeros(len(state.b), int)
        return cls(state, log_ratio, target.numbers, effects, jnp.zeros(target.parts), jnp.zeros(()))


def log_sites(
    sites: GaussianFactor, u: Float[Array, "parameter impact"], *, first: bool = False
) -> Float[Array, " impact"]:
    """Log q of every impact, the sum over its sites, or the first of them alone."""
    # Not a sum along an axis, for which the compiler has several ways, by the number of impacts.
    log_density = sites.batch_last().recentred(u[:, None]).log_scale
    return log_density[0] if first or len(log_density) == 1 else logsumexp(log_density, axis=0)


def _one_each(sites: GaussianFactor, log_weight: Any, uniform: Float[Array, " impact"]) -> GaussianFactor:
    """Of each impact one of its sites, drawn by these weights [site, impact]."""
    if len(sites.centre) == 1:
        return jax.tree.map(lambda leaf: leaf[0], sites)
    below = jnp.cumsum(jax.nn.softmax(log_weight(), axis=0), axis=0)
    chosen = (uniform > below[:-1]).sum(0)
    return jax.tree.map(lambda leaf: leaf[chosen, jnp.arange(leaf.shape[1])], sites)


def by_site(kernel: Kernel, steps: Steps, state: State, numbers: MoveNumbers) -> Proposal:
    """Every impact's parameters from its site and the population."""
    target, tuning = kernel.target, kernel.tuning
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
    return Proposal.of_impacts(target, state._replace(u=u), log_ratio)


def by_walk(kernel: Kernel, steps: Steps, state: State, numbers: MoveNumbers) -> Proposal:
    """Every impact's parameters a step further, by its own covariance."""
    target = kernel.target
    mean, D = target.prior_mean(state.b), target.covariances(state.y).of_impact()
    step = steps.impact * jnp.einsum("iab,bi->ai", kernel.tuning.impact_root, numbers.impacts)
    u = target.per_inertia(target.per_inertia(state.u) + step, -1.0)

    def log_prior(u: Array) -> Array:
        return -((u - mean) * jnp.einsum("ab,bi->ai", D, u - mean)).sum(0) / 2

    return Proposal.of_impacts(target, state._replace(u=u), log_prior(u) - log_prior(state.u))


def by_population(kernel: Kernel, steps: Steps, state: State, numbers: MoveNumbers) -> Proposal:
    """Hyperparameters and effects by the sites' own posterior, every impact's parameters along with them."""
    target, tuning = kernel.target, kernel.tuning
    sites = _one_each(tuning.sites, lambda: tuning.sites.log_density(state.u.T), numbers.label)
    here, mean = target.impact_given(state.y, sites), target.prior_mean(state.b)
    pulled = small.turned_times(here.root, list(state.u - here.factor.centre))
    standard = [p - h for p, h in zip(pulled, here.half(list(mean)), strict=True)]
    density = partial(target.given_sites, blocked=target.blocked(sites))
    length = steps.population
    y, (begin, end), inner = walk(density, state.y, tuning.population, length, numbers.walk)
    of_b = jnp.sqrt(1 - length**2) * target.standard_effects(begin, state.b) + length * numbers.walk.effects
    b = target.effects_at(end, of_b)
    there = target.impact_given(y, sites)
    u = jnp.stack(there.draw(list(target.prior_mean(b)), standard))
    log_ratio = log_sites(tuning.sites, state.u) - log_sites(tuning.sites, u)
    whole, effects = jnp.zeros(len(target.present), int), jnp.zeros(len(b), int)
    state = state._replace(y=y, b=b, u=u)
    return Proposal(state, log_ratio, whole, effects, jnp.zeros(target.parts), inner)


def by_level(kernel: Kernel, steps: Steps, state: State, numbers: MoveNumbers) -> Proposal:
    """The effects of every level, every impact's parameters along with its level's."""
    target = kernel.target
    elements = target.level_effects
    there = elements < len(state.b)
    standard = jnp.append(numbers.walk.effects, 0.0)[elements]
    move = jnp.where(there, steps.level * jnp.einsum("lab,bl->al", kernel.tuning.level_root, standard), 0.0)
    b = jnp.append(state.b, 0.0).at[elements].add(move)[:-1]
    precision = target.covariances(state.y).precision_among(elements)

    def log_prior(b: Array) -> Array:
        deviation = jnp.where(there, jnp.append(b - target.data.location_mean, 0.0)[elements], 0.0)
        return -jnp.einsum("al,abl,bl->l", deviation, precision, deviation) / 2

    gained = log_prior(b) - log_prior(state.b)
    levels = jnp.broadcast_to(jnp.arange(elements.shape[1]), elements.shape)
    effect = jnp.zeros(len(b) + 1, int).at[elements].set(levels)[:-1]
    u = state.u + target.prior_mean(b) - target.prior_mean(state.b)
    return Proposal(
        state._replace(b=b, u=u),
        jnp.zeros(len(target.present)),
        target.level,
        effect,
        jnp.zeros(target.parts).at[: len(gained)].set(gained),
        jnp.zeros(()),
    )


def by_common(kernel: Kernel, steps: Steps, state: State, numbers: MoveNumbers) -> Proposal:
    """What impacts have in common of one parameter, or their spread in it if that is unknown; b given them.

    The mean of the parameter p, or the spread's coordinate, goes a step on a t near its posterior, of a
    length that chance decides. p goes to mean + d + e^s (p - mean), an impact's other parameters along with
    d, and its standard deviation between impacts to e^s times as much, either d or s being 0: volumes grow by
    e^s for each impact but one.
    """
    target, tuning, walk = kernel.target, kernel.tuning, numbers.walk
    which, at = target.common, target.common_spread
    assert which is not None  # noqa: S101 - made of such models alone
    shown, number = target.per_inertia(state.u), target.gathered(target.present).sum()
    mean = target.gathered(jnp.where(target.present, shown[which], 0.0)).sum() / number
    z = (jnp.stack([mean, mean if at is None else state.y[at]]) - tuning.common.location) / tuning.common.root
    length = _COMMON_LEAST ** jnp.maximum(2 * walk.decision[0] - 1, 0.0)
    scale = jnp.sqrt((FREEDOM + z**2) / (walk.scale[0, : FREEDOM + 1] ** 2).sum())
    proposed = jnp.sqrt(1 - length**2) * z + length * scale * target.gathered(numbers.impacts)[0, 0]
    # The first of a walk's numbers says how far, the second which of the two.
    chosen = jnp.arange(2) == (0 if at is None else (walk.decision[1] < 1 / 2).astype(int))
    shift, further = jnp.where(chosen, (proposed - z) * tuning.common.root, 0.0)
    ratio = jnp.where(chosen, jnp.log1p(proposed**2 / FREEDOM) - jnp.log1p(z**2 / FREEDOM), 0.0).sum()
    gained, log_scale, y = (FREEDOM + 1) / 2 * ratio, jnp.zeros(()), state.y
    if at is not None:
        transform = biject_to(target.model.prior_of(target.model.hyperparameters[at]).support)
        y = y.at[at].add(further)
        log_scale = jnp.log(transform(y[at]) / transform(state.y[at]))
        gained += (number - 1) * log_scale
    moved = shown.at[which].set(mean + jnp.exp(log_scale) * (shown[which] - mean))
    u = target.per_inertia(moved + shift * tuning.along, -1.0)
    here = target.given_impacts(state.y, target.cell_sums(state.u))
    there = target.given_impacts(y, target.cell_sums(u))
    b = target.effects_at(there, walk.effects)
    gained += there.log_density - here.log_density
    whole, effects = jnp.zeros(len(target.present), int), jnp.zeros(len(b), int)
    unchanged = jnp.zeros(len(target.present))
    of_part = jnp.zeros(target.parts).at[0].set(gained)
    return Proposal(state._replace(y=y, b=b, u=u), unchanged, whole, effects, of_part, jnp.zeros(()))


def by_impact(kernel: Kernel, steps: Steps, state: State, numbers: MoveNumbers) -> Proposal:
    """Every impact's parameters in one of the two ways."""
    site, walk = (move(kernel, steps, state, numbers) for move in (by_site, by_walk))
    walks = numbers.way < steps.walks
    u = jnp.where(walks, walk.state.u, site.state.u)
    log_ratio = jnp.where(walks, walk.log_ratio, site.log_ratio)
    return Proposal.of_impacts(kernel.target, state._replace(u=u), log_ratio)


MOVES = (by_impact, by_population, by_level)
_BY_IMPACT, _BY_POPULATION, _BY_LEVEL, _BY_COMMON = range(4)
# The least step of `by_common`: half of them are the longest, and as good as draws from the t.
_COMMON_LEAST = 0.05


def centred(kernel: Kernel, steps: Steps, state: State, numbers: WalkNumbers) -> tuple[State, Array]:
    """Hyperparameters and effects with every impact's parameters fixed."""
    target = kernel.target
    density = partial(target.given_impacts, sums=target.cell_sums(state.u))
    y, (_, effects), rate = walk(density, state.y, kernel.tuning.population, steps.centred, numbers)
    return state._replace(y=y, b=target.effects_at(effects, numbers.effects)), rate


def walk(
    density: Any, y: Array, near: StudentT, length: Float[Array, ""], numbers: WalkNumbers
) -> tuple[Array, tuple[Any, Any], Array]:
    """A walk of y, what ``density`` gives at its beginning and end, and the share of accepted steps.

    In units of the t, z = root⁻¹(y − location), a step goes to √(1 − s²) z + s √g x, x standard normal and g
    a scale that the t may have at z, (ν + z'z) / χ² of ν + n degrees of freedom: reversible for the t,
    whatever its length s is. It is accepted by the ratio of ``density`` to the t.

    Args:
        density: what has a ``log_density``, of y.
        y: where it begins.
        near: the t.
        length: of a step, s, between 0 and 1.
        numbers: one step more than are tried.
    """
    number, freedom = len(numbers.decision) - 1, FREEDOM + len(y)

    @partial(jax.jit, inline=True)
    def at(z: Array) -> tuple[Any, Array]:
        effects = density(near.location + near.root @ z)
        return effects, effects.log_density + freedom / 2 * jnp.log1p(z @ z / FREEDOM)

    def step(index: Array, carried: Any) -> Any:
        z, end, log_ratio, begin, rate = carried
        # The first step stays where it is, and is taken: what is compiled has the density once.
        s = jnp.where(index > 0, length, 0.0)
        scale = jnp.sqrt((FREEDOM + z @ z) / (numbers.scale[index] ** 2).sum())
        proposed = jnp.sqrt(1 - s**2) * z + s * scale * numbers.step[index]
        there, proposed_ratio = at(proposed)
        accepted = (jnp.log(numbers.decision[index]) < proposed_ratio - log_ratio) | (index == 0)
        new, old = (proposed, there, proposed_ratio), (z, end, log_ratio)
        rate = rate + jnp.where(index > 0, accepted, 0.0) / number
        return *_either(accepted, new, old), _either(index == 0, there, begin), rate

    z = solve_triangular(near.root, y - near.location, lower=True)
    nothing = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), jax.eval_shape(at, z))
    first = z, *nothing, nothing[0], jnp.zeros(())
    z, end, _, begin, rate = jax.lax.fori_loop(0, number + 1, step, first)
    return near.location + near.root @ z, (begin, end), rate


def _either(accepted: Array, new: Any, old: Any) -> Any:
    return jax.tree.map(lambda a, b: jnp.where(accepted, a, b), new, old)


def decided(
    target: Target, state: State, proposal: Proposal, uniform: Float[Array, " part"]
) -> tuple[State, Float[Array, " part"]]:
    """The state after a proposal, and of each of its parts 1 where it was accepted, else 0.

    Args:
        target: the posterior.
        state: before it.
        proposal: what is proposed.
        uniform: random numbers that decide.
    """
    value = target.log_likelihood(proposal.state.u)
    log_ratio = jnp.where(target.present, value - state.log_likelihood + proposal.log_ratio, 0.0)
    log_ratio, part = target.gathered(log_ratio), target.gathered(proposal.part)
    log_ratio = jax.ops.segment_sum(log_ratio, part, target.parts) + proposal.log_prior
    accepted = jnp.log(uniform) < log_ratio
    of_impact = accepted[proposal.part]
    u, value = _either(of_impact, (proposal.state.u, value), (state.u, state.log_likelihood))
    y, b = _either(accepted[0], proposal.state.y, state.y), accepted[proposal.effect]
    return State(y, _either(b, proposal.state.b, state.b), u, value), jnp.where(accepted, 1.0, 0.0)


def _share(accepted: Float[Array, " part"], among: Bool[Array, " part"]) -> Float[Array, ""]:
    return jnp.where(among, accepted[: len(among)], 0.0).sum() / among.sum()


def followed(step: Array, gain: Any, excess: Array, bounds: tuple[float, float]) -> Array:
    """A step that grows by the ``excess`` of its acceptance over what is wanted, within its bounds."""
    return jnp.clip(step * jnp.exp(gain * excess), *bounds)


class MoveOutcome(NamedTuple):
    """What one move led to.

    Attributes:
        kind: which of `MOVES` it was.
        walks: which impacts went by a walk.
        accepted: of each part 1 where it was accepted, else 0.
        inner: acceptance of the surrogate's walk.
    """

    kind: Int[Array, ""]
    walks: Bool[Array, " impact"]
    accepted: Float[Array, " part"]
    inner: Float[Array, ""]

    def acceptances(self, target: Target) -> Acceptances:
        """No number for what was not tried."""
        tried = Acceptances(
            _share(self.accepted, target.gathered(target.present & ~self.walks)),
            _share(self.accepted, target.gathered(target.present & self.walks)),
            self.accepted[0],
            self.inner,
            _share(self.accepted, target.level_present),
            jnp.asarray(jnp.nan),
        )
        kinds = (_BY_IMPACT, _BY_IMPACT, _BY_POPULATION, _BY_POPULATION, _BY_LEVEL, -1)
        return Acceptances(
            *(jnp.where(self.kind == one, rate, jnp.nan) for one, rate in zip(kinds, tried, strict=True))
        )

    def steps_after(self, kernel: Kernel, steps: Steps) -> Steps:
        """Longer ones where more is accepted than is wanted."""
        settings, gain = kernel.settings, kernel.gain
        population, alone = settings.population_acceptance, settings.impact_acceptance

        def longer(step: Array, among: Any, rate: Array, wanted: float, bounds: tuple[float, float]) -> Array:
            return jnp.where(among, followed(step, gain, rate - wanted, bounds), step)

        of_level, of_impact = (self.accepted[:size] for size in (len(steps.level), kernel.target.impacts))
        of_impact = kernel.target.shard(of_impact)
        by_impact, by_level = self.kind == _BY_IMPACT, self.kind == _BY_LEVEL
        oftener = jnp.clip(steps.walks + gain * (1 - of_impact - steps.walks), *settings.walks)
        return steps._replace(
            impact=longer(steps.impact, by_impact & self.walks, of_impact, alone, settings.impact_steps),
            walks=jnp.where(by_impact & ~self.walks, oftener, steps.walks),
            # However far the sites' own walk may go, the whole has to be accepted.
            population=longer(
                steps.population,
                self.kind == _BY_POPULATION,
                jnp.minimum(self.inner, self.accepted[0]),
                population,
                settings.population_steps,
            ),
            level=longer(steps.level, by_level, of_level, alone, settings.impact_steps),
        )


def transition(
    kernel: Kernel, carried: tuple[State, Steps], key: Array
) -> tuple[tuple[State, Steps], tuple[Visited, Acceptances]]:
    """Every kind of move, then steps that follow acceptances unless the kernel's ``gain`` is 0.

    Chance decides between `by_population`, `by_level` and `by_common`.
    """
    target, settings = kernel.target, kernel.settings
    state, steps = carried
    keys = jax.random.split(key, 2 + max(settings.surrogates))
    numbers = walk_numbers(target, settings.centred, keys[0])
    state, of_centred = centred(kernel, steps, state, numbers)
    excess = of_centred - settings.population_acceptance
    steps = steps._replace(centred=followed(steps.centred, kernel.gain, excess, settings.population_steps))
    # Levels move by themselves the oftener, the shorter the steps are that all of the population moves by.
    by_levels = jnp.clip(1 - steps.population, *settings.levels) * (len(target.level_effects) > 0)
    by_common_share = jnp.clip(1 - steps.population, *settings.common) * (target.common is not None)

    def move(index: Array, at: tuple[State, Steps, Acceptances]) -> tuple[State, Steps, Acceptances]:
        # One copy of the likelihood serves all moves: each more would be compiled again.
        state, steps, rates = at
        of_move = move_numbers(target, settings, keys[1 + index])
        way = of_move.way[0] - by_common_share
        of_move = of_move.shard(target)
        of_population = jnp.where(way < by_levels * (1 - by_common_share), _BY_LEVEL, _BY_POPULATION)
        of_population = jnp.where(way < 0, _BY_COMMON, of_population)
        kind, walks = jnp.where(index == 0, _BY_IMPACT, of_population), of_move.way < steps.walks
        # The first step of a walk is taken whatever its number is: that is free to say how far the move goes.
        length = steps.population * settings.shortened(of_move.walk.decision[0])
        ways = MOVES if target.common is None else (*MOVES, by_common)
        moves = [partial(one, kernel, steps._replace(population=length)) for one in ways]
        proposal = jax.lax.switch(kind, moves, state, of_move)
        state, accepted = decided(target, state, proposal, of_move.decision)
        outcome = MoveOutcome(kind, walks, accepted, proposal.inner)
        here, steps = outcome.acceptances(target), outcome.steps_after(kernel, steps)
        return state, steps, jax.tree.map(lambda new, old: jnp.where(jnp.isnan(new), old, new), here, rates)

    long, short = settings.surrogates
    of_all = settings.common[0] < 1 or target.common is not None
    evaluations = 1 + of_all * jnp.where(steps.population < settings.short, short, long)
    none = jnp.asarray(jnp.nan)
    rates = Acceptances(none, none, none, none, none, of_centred)
    state, steps, rates = jax.lax.fori_loop(0, evaluations, move, (state, steps, rates))
    log_ratios = target.log_ratios(state.log_likelihood - log_sites(kernel.tuning.sites, state.u, first=True))
    return (state, steps), (
        Visited(state.y, state.b, target.gathered(state.log_likelihood).sum(), log_ratios),
        rates,
    )
