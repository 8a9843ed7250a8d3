"""Importance-corrected MCMC on an approximate marginal posterior (Vihola, Helske and Franks 2020).

With a Gaussian site in place of each trace's likelihood, everything but the hyperparameters integrates out,
and a chain moves through a dozen dimensions whatever the number of impacts. Its draws are weighted by the
traces' evidence over that of their sites, p(traces | psi, b) / q(traces | psi, b), the sites are improved
where too few draws stay effective, and each impact's parameters are drawn from their true conditional by
sampling-importance-resampling.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from bayestissue.hierarchy.gaussian.factor import GaussianFactor
from bayestissue.hierarchy.specification import Sampler
from bayestissue.hierarchy.trace_data import Prepared
from bayestissue.hierarchy.traces import COORDINATES, TraceData, TraceModel
from bayestissue.inference.execution.chunks import Progress, in_blocks
from bayestissue.inference.execution.compiling import in_parts
from bayestissue.inference.execution.kept import all_fit, kept_draws
from bayestissue.inference.factors.conditional import (
    ConditionalPrior,
    PopulationDraws,
    evenly_spaced,
    normals,
    of_cells,
)
from bayestissue.inference.factors.likelihoods import log_likelihoods
from bayestissue.inference.posterior.approximate import (
    Approximation,
    approximate,
    marginal_model,
)
from bayestissue.inference.posterior.correction import Correction
from bayestissue.inference.posterior.refinement import (
    CHECKS,
    draws_at,
    importance_weights,
    refitted,
    to_second_order,
    with_second_order,
)
from bayestissue.inference.samplers.independence import LEAST_EFFECTIVE, independence_chains
from bayestissue.inference.samplers.nuts import Start, run_chains
from bayestissue.inference.samplers.psis import systematic
from bayestissue.inference.samplers.sampling import Draws

CANDIDATES, _FEWEST_CANDIDATES, _OFF = 8, 2, 1 / 32
# Independent proposals serve where their weights have a variance (and enough of them count).
PROPOSAL_LIMIT = 0.5
# A matrix of each impact under each of so many draws takes little memory.
_DRAWS_AT_ONCE = 500
# Sites are fitted so often about so many draws to second order, before any chain, fewer of them the more
# impacts there are; and about so many corrected draws of chains, as often as that raises the effective number
# by half.
_PASSES_BEFORE, _DRAWS_BEFORE, _DRAWS_ABOUT = 2, 128, 512
_FEWEST_BEFORE, _ALL_BEFORE = 16, 128_000
_MOST_PASSES, _GAIN = 4, 1.5
# Of log weights: with more next to no draw is effective.
_MOST_SCATTER = 2.0
# Chains of the population so many times longer still take less time than the exact path.
_LONGEST = 8


class Attempt(NamedTuple):
    """Draws of the population made with some sites, and chosen by their weights.

    Attributes:
        approximation: of the traces, with which they were made.
        chains: as the sampler left them.
        draws: those chosen, one chain's after the other's.
        z_b: their standard effects.
        correction: their importance weights.
    """

    approximation: Approximation
    chains: Draws
    draws: PopulationDraws
    z_b: Float[np.ndarray, "draw location"]
    correction: Correction


@dataclass(frozen=True)
class Problem:
    """What every step is asked of; see `corrected_draws`."""

    prepared: Prepared
    settings: Sampler
    seed: int
    rng: np.random.Generator
    progress: Callable[[str, int, int], None] = lambda *_: None

    @property
    def all_weighed(self) -> bool:
        """Whether every draw gets a weight: of many impacts some do, and judge all."""
        return all_fit(self.settings.chains * self.settings.transitions, len(self.prepared.impacts))

    @property
    def most_scatter(self) -> float:
        """The scatter of log weights that is left to the weights: none where these only judge."""
        return _MOST_SCATTER if self.all_weighed else 0.0

    def stage(self, name: str) -> Progress:
        """Progress of one of the stages."""
        return partial(self.progress, name)


@dataclass(frozen=True)
class State:
    """What the steps so far have led to.

    Attributes:
        approximation: of the traces, to go on with.
        attempts: draws made so far, each with the approximation of its time.
        first: number of the first attempt with sites that follow from one another, up to the last.
    """

    approximation: Approximation
    attempts: tuple[Attempt, ...] = ()
    first: int = 0

    @property
    def best(self) -> Attempt:
        """The attempt that fails the fewest checks, and of several the one of most effective draws."""
        return min(self.attempts, key=lambda attempt: attempt.correction.rank)


class Refused(NamedTuple):
    """That a step is not taken, and why."""

    reason: str


Step = Callable[[Problem, State], State | Refused]


def fit_and_sample(problem: Problem, state: State) -> State:
    """Sites fitted to the population, what they leave out where it matters, and draws with both."""
    approximation = fitted_to_population(problem, state.approximation)
    attempt = population_attempt(problem, approximation)
    return State(approximation, (*state.attempts, attempt), first=len(state.attempts))


def refit_about_draws(problem: Problem, state: State) -> State | Refused:
    """Sites fitted anew about the corrected draws of the last attempt, as long as that helps."""
    attempts = state.attempts[state.first :]
    approximation, _, draws, _, correction = attempts[-1]
    if correction.trusted:
        return Refused("the correction can be trusted")
    if approximation.grid is not None:
        return Refused("a grid of the last parameter is not fitted anew")
    if len(attempts) > 1 and correction.effective < _GAIN * attempts[-2].correction.effective:
        return Refused("the last time did not raise the effective number of draws by half")
    if len(attempts) == _MOST_PASSES:
        return Refused(f"sites were fitted {_MOST_PASSES} times")
    prepared, seed = problem.prepared, problem.seed
    subset = draws.rows(np.resize(problem.rng.permutation(len(draws.b)), _DRAWS_ABOUT))
    fitted = refitted(prepared, approximation, subset, seed + _MOST_PASSES + len(attempts))
    completed = with_second_order(prepared, fitted, seed, problem.most_scatter)
    attempt = population_attempt(problem, completed)
    return replace(state, approximation=completed, attempts=(*state.attempts, attempt))


def normal_instead_of_grid(problem: Problem, state: State) -> State | Refused:
    """A normal site of a last parameter that had a grid.

    Never the other way: what traces tell so well that a normal was taken falls between the places of a grid,
    which then looks trusted and is wrong.
    """
    if state.approximation.grid is None:
        return Refused("the sites are normal in all parameters")
    if state.best.correction.trusted:
        return Refused("the correction can be trusted")
    expansions, stage = state.approximation.expansions, problem.stage("summarising each trace")
    approximation = approximate(problem.prepared, expansions=expansions, normal=True, progress=stage)
    return fit_and_sample(problem, replace(state, approximation=approximation))


def lengthen_chains(problem: Problem, state: State) -> State | Refused:
    """Longer chains with the best sites, where all that is wrong is that too few draws are effective."""
    correction = state.best.correction
    if correction.trusted:
        return Refused("the correction can be trusted")
    if not correction.lacks_only_draws:
        return Refused("not only draws are lacking")
    longer = int(np.ceil(1.2 * correction.needed / correction.effective))
    settings = problem.settings.model_copy(update={"thinning": longer * problem.settings.thinning})
    lengthened = replace(problem, settings=settings)
    if longer > _LONGEST:
        return Refused(f"chains {longer} times as long take longer than the exact path")
    if not lengthened.all_weighed:
        return Refused("of so many draws and impacts only some get a weight, however many there are")
    attempt = population_attempt(lengthened, state.best.approximation)
    return replace(state, attempts=(*state.attempts, attempt))


_REFITS = (refit_about_draws,) * (_MOST_PASSES - 1)
STEPS: tuple[Step, ...] = (fit_and_sample, *_REFITS, normal_instead_of_grid, *_REFITS, lengthen_chains)


def corrected_draws(
    prepared: Prepared,
    settings: Sampler,
    seed: int,
    *,
    approximation: Approximation | None = None,
    progress: Callable[[str, int, int], None] = lambda *_: None,
) -> tuple[Approximation, Draws, Correction]:
    """Sites, draws of the approximate marginal posterior made with them, and their correction.

    All of `STEPS` are asked in turn, and go on from the state that those before have left. The best attempt
    is returned, trusted or not; `Correction.attempts` lists them all.

    Args:
        prepared: model and data.
        settings: how many chains and draws.
        seed: of all of it.
        approximation: what `approximate` found, if it was asked before.
        progress: told the stage, how much of it is done, and its total; of every attempt anew.
    """
    problem = Problem(prepared, settings, seed, np.random.default_rng([seed, 22]), progress)
    state = State(approximation or approximate(prepared, progress=problem.stage("summarising each trace")))
    steps = []
    for step in STEPS:
        outcome = step(problem, state)
        reason = outcome.reason if isinstance(outcome, Refused) else ""
        row = {"step": step.__name__, "refused": reason}
        # Refused again for the same reason, a step has one row.
        if not reason or row not in steps:
            steps.append(row)
        state = state if isinstance(outcome, Refused) else outcome
    rows = tuple(attempt.correction.row() for attempt in state.attempts)
    draws = with_impacts(problem, state.best)
    return state.best.approximation, draws, replace(state.best.correction, attempts=rows, steps=tuple(steps))


def fitted_to_population(problem: Problem, approximation: Approximation) -> Approximation:
    """Sites fitted about draws to second order, and what these sites leave out where it matters."""
    prepared, seed, progress = problem.prepared, problem.seed, problem.stage("summarising each trace")
    number_of_draws = int(np.clip(_ALL_BEFORE // len(prepared.impacts), _FEWEST_BEFORE, _DRAWS_BEFORE))
    for seed_step in range(_PASSES_BEFORE if approximation.grid is None else 0):
        draws = to_second_order(prepared, approximation, number_of_draws, problem.rng)
        approximation = refitted(prepared, approximation, draws, seed + seed_step, progress)
    return with_second_order(prepared, approximation, seed, problem.most_scatter, progress)


def population_attempt(problem: Problem, approximation: Approximation) -> Attempt:
    """Chains of the population and their correction.

    Where draws times impacts are more than fits, the weights are those of some draws, by which all are judged
    and none chosen.
    """
    prepared, settings, seed = problem.prepared, problem.settings, problem.seed
    chains = sample_marginal(problem, approximation)
    shape, rng = (settings.chains, settings.transitions), np.random.default_rng([seed, 21])
    y = chains.sites[COORDINATES].reshape(shape[0] * shape[1], -1)
    standard = rng.standard_normal((len(y), prepared.model.locations.size))
    population, z_b = draws_at(prepared, approximation, y, standard)
    # A draw beyond what numbers hold has no density, and no impact is compared at what it expects.
    finite = np.isfinite(population.b).all(1)
    rows = np.where(finite, np.arange(len(finite)), np.argmax(finite))
    population, z_b = population.rows(rows), z_b[rows]
    whole = problem.all_weighed
    checked = slice(None) if whole else evenly_spaced(len(finite), CHECKS)
    ratios = importance_weights(prepared, approximation, population.rows(checked), population)
    log_weight = np.where(finite[checked], ratios.log_weight, -np.inf).reshape(shape if whole else (1, -1))
    number = settings.chains * settings.draws if whole else CHECKS
    correction = Correction.from_log_weights(log_weight, number, ratios.varies)
    places = np.arange(settings.thinning - 1, shape[1], settings.thinning)
    if whole:
        places = systematic(correction.weight, settings.draws, rng)
    chosen = np.ravel(places + shape[1] * np.arange(shape[0])[:, None])
    if whole:
        correction = replace(correction, of_impacts=ratios.of_impacts[chosen])
    return Attempt(approximation, chains, population.rows(chosen), z_b[chosen], correction)


def with_impacts(problem: Problem, attempt: Attempt) -> Draws:
    """The population's draws, and each impact's standard normals under those that are kept of it.

    These are the draws of the sites of `sampled_model`, corrected to the same posterior.
    """
    prepared, settings, seed = problem.prepared, problem.settings, problem.seed
    model, design = prepared.model, prepared.data.design
    shape, cell = (settings.chains, settings.draws), np.asarray(design.cell)
    kept_numbers = kept_draws(*shape, len(cell))
    population = attempt.draws.rows((np.arange(shape[0])[:, None] * shape[1] + kept_numbers).ravel())
    priors = population.priors(design)
    # What has a grid varies besides under the population of each draw.
    measured = attempt.correction.varies if attempt.approximation.grid is None else None
    relative_variance = np.inf if measured is None else float(measured.mean())

    def one(part: TraceData, rows: np.ndarray) -> np.ndarray:
        rng = np.random.default_rng([seed, 24, int(rows[0])])
        part_sites, here = attempt.approximation.of_rows(rows)[0], of_cells(priors, cell[rows])
        choose = partial(sir_proposals, model, part, part_sites, candidates_for(relative_variance))
        seeds = rng.integers(2**32, size=len(population.b))
        return in_parts(choose, (here.mean, population.precision, seeds), _DRAWS_AT_ONCE).swapaxes(0, 1)

    progress = problem.stage("drawing each impact")
    z_u = in_blocks(prepared.data, one, progress=progress).swapaxes(0, 1)
    sites = {**attempt.draws.raw, "standard_locations": attempt.z_b}
    values_by_site = {name: values.reshape(*shape, *values.shape[1:]) for name, values in sites.items()}
    values_by_site["standard_impacts"] = z_u.reshape(shape[0], len(kept_numbers), *z_u.shape[1:])
    return Draws(values_by_site, attempt.chains.statistics, attempt.chains.max_tree_depth)


def sample_marginal(problem: Problem, approximation: Approximation) -> Draws:
    """Draws of the marginal posterior's coordinates, by independent proposals where these serve, or NUTS."""
    prepared, settings, seed = problem.prepared, problem.settings, problem.seed
    progress = problem.stage("sampling the population")
    data = approximation.data(prepared.data)
    arguments = (
        prepared.model,
        data,
        approximation.marginal_grid,
        approximation.coordinates.warp,
    )
    progress(0, 1)
    covariance = approximation.coordinates.covariance
    chains = independence_chains(marginal_model, arguments, COORDINATES, covariance, settings, seed)
    if chains.pareto_k < PROPOSAL_LIMIT and chains.effective > LEAST_EFFECTIVE:
        progress(1, 1)
        return chains.draws
    return run_chains(
        marginal_model,
        arguments,
        Start({COORDINATES: np.zeros(len(covariance))}, COORDINATES, covariance),
        settings,
        seed,
        progress=progress,
        processes=False,
    )


def candidates_for(relative_variance: float) -> int:
    """How many candidates an impact's parameters are chosen from.

    The choice is off the truth by about v / n, v being the variance of likelihood over site relative to its
    mean squared, infinite where it has no mean.
    """
    wanted = np.ceil(relative_variance / _OFF) if np.isfinite(relative_variance) else CANDIDATES
    return int(np.clip(wanted, _FEWEST_CANDIDATES, CANDIDATES))


def sir_proposals(
    model: TraceModel,
    data: TraceData,
    sites: GaussianFactor,
    candidates: int,
    prior_mean: Float[np.ndarray, "draw impact parameter"],
    precision: Float[np.ndarray, "draw parameter parameter"],
    seeds: Int[np.ndarray, " draw"],
) -> Float[np.ndarray, "draw impact parameter"]:
    """Standard normals of every impact, one of a few candidates each, chosen by likelihood over site."""
    proposal = normals(sites, ConditionalPrior(prior_mean, precision[:, None]))
    rng = np.random.default_rng(seeds)
    best, most = np.zeros(prior_mean.shape), np.full(prior_mean.shape[:2], -np.inf)
    for number in range(candidates):
        z = rng.standard_normal(prior_mean.shape)
        u = proposal.at(z)
        ratio = log_likelihoods(model, data, u) - sites.log_density(u)
        # The greatest of these sums is a choice by likelihood over site (Gumbel 1954).
        value = ratio + rng.gumbel(size=ratio.shape)
        better = (value > most) | (number == 0)
        best = np.where(better[..., None], z, best)
        most = np.where(better, value, most)
    return best
