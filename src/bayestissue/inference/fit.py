"""The fit of recorded traces, from prepared data to labelled results."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pandas as pd
import xarray as xr

from bayestissue.elements import element
from bayestissue.errors import InputError
from bayestissue.hierarchy import derived
from bayestissue.hierarchy.gaussian.factor import GaussianFactor
from bayestissue.hierarchy.levels import Recorded
from bayestissue.hierarchy.specification import ModelSpecification
from bayestissue.hierarchy.trace_data import Prepared
from bayestissue.inference.answers.contrasts import contrasts, people_compared
from bayestissue.inference.answers.reliability import (
    Variances,
    as_variables,
    coefficients,
    reliability,
    variances,
)
from bayestissue.inference.chain.ending import r_hat_limit
from bayestissue.inference.chain.explanations import explanations
from bayestissue.inference.chain.run import chain_draws
from bayestissue.inference.checking.model_form import described, misfit_precheck, model_form, with_impacts
from bayestissue.inference.checking.pooled_parameters import pooled_parameters
from bayestissue.inference.checking.straight_lines import straight_lines
from bayestissue.inference.execution.chunks import Progress
from bayestissue.inference.execution.kept import kept_draws, some_impacts, some_of
from bayestissue.inference.factors.noise_left import noise_p
from bayestissue.inference.posterior.approximate import Approximation, approximate, expanded, rows_of
from bayestissue.inference.posterior.constrained_draws import constrained_draws, quantities_of_draws
from bayestissue.inference.posterior.correction import Route, duration
from bayestissue.inference.posterior.exact import exact_draws
from bayestissue.inference.posterior.recipe import corrected_draws
from bayestissue.inference.posterior.scores import LikelihoodApproximation
from bayestissue.inference.quantities.elements import COMMON_DEPTH
from bayestissue.inference.quantities.secants import of_secant
from bayestissue.inference.results.cross_validation import cross_validation, prior_sensitivity
from bayestissue.inference.results.labels import labelled, labelled_statistics
from bayestissue.inference.results.summary import summarise as summary_table
from bayestissue.inference.results.tree import posterior_tree
from bayestissue.inference.results.uncertainty_budget import measurement_sd, uncertainty_budget
from bayestissue.inference.samplers.diagnostics import diagnose
from bayestissue.inference.samplers.sampling import ConstrainedDraws, Draws

Say = Callable[[str, int, int], None]
# So long a fit may take by the exact path without having been asked for it, s.
_LONGEST_UNASKED_S = 300


@dataclass(frozen=True)
class TraceAnalysis:
    """Every result of a fit, labelled; the tables are the files of a finished run."""

    tree: xr.DataTree
    summary: pd.DataFrame
    diagnostics: dict[str, Any]
    hypotheses: pd.DataFrame
    cross_validation: pd.DataFrame
    sensitivity: pd.DataFrame
    interval_sources: pd.DataFrame
    contrasts: pd.DataFrame
    people: pd.DataFrame
    reliability: pd.DataFrame


def fit_traces(
    prepared: Prepared,
    specification: ModelSpecification,
    seed: int,
    say: Say,
    *,
    expansions: GaussianFactor | None = None,
    checkpoints: Path | None = None,
    contradicted: Callable[[], str] = str,
) -> TraceAnalysis | dict[str, Any]:
    """Sample the posterior of every impact and of the population, check it, and label everything.

    Args:
        prepared: model and data.
        specification: the model file.
        seed: of all draws.
        say: told the stage, how much of it is done, and its total.
        expansions: `expanded` of the same, if it is at hand.
        checkpoints: an existing folder for finished segments of the chains; see `run_chains`.
        contradicted: says what the traces contradict of what is declared; asked before a long exact path.

    By the summary path the population is sampled with each trace's site in its place, and the draws are then
    corrected; "automatic" goes on to the exact path, every trace in every step, where no correction can be
    trusted: see `Correction.checks`. "chain" draws everything by one Markov chain. Where the model file
    leaves a discrepancy to the program, and the best fits show plainly that one is needed, this is all that
    is returned: see `misfit_precheck`.

    Raises:
        InputError: by "automatic", where the exact path would take longer than five minutes, or the traces
            contradict what is declared of their measuring chain.
    """
    done = partial(say, "summarising each trace")
    done(0, 1)
    settings, route, sites, first = specification.sampler, Route("exact"), None, None
    if settings.path != "exact":
        expansions = expansions or expanded(prepared)
        if specification.may_add_discrepancy and not prepared.model.discrepancy:
            rows = some_impacts(len(prepared.impacts))
            wrong = misfit_precheck(some_of(prepared, rows), rows_of(expansions, rows), seed)
            if wrong is not None:
                return wrong
        if settings.path == "chain":
            return _by_chain(prepared, specification, expansions, seed, say, checkpoints)
        first = approximate(prepared, expansions=expansions, progress=done)
        sites, draws, correction = corrected_draws(
            prepared, settings, seed, approximation=first, progress=say
        )
        stands_out = correction.stands_out
        spoilt = "" if stands_out is None else str(prepared.impacts["impact"].iloc[stands_out])
        route = Route(settings.path, correction, spoilt)
        if not route.exact:
            likelihood = LikelihoodApproximation(sites, correction.of_impacts)
            return label_standard(prepared, specification, sites, draws, seed, say, likelihood, route)
    automatic = settings.path == "automatic"
    if automatic and (words := contradicted()):
        raise InputError.stated("exact-path", "fit", why=words, route=route.why)
    say(f"sampling by the exact path, {route.why}", 0, 1)
    whitening = first or approximate(prepared, expansions=expansions, progress=done)
    progress = _with_estimate(say, route if automatic else None)
    draws = exact_draws(prepared, whitening, settings, seed, progress=progress, checkpoints=checkpoints)
    # Scores ask for sites that stand for the traces; those of the chains only whiten.
    likelihood = LikelihoodApproximation(sites or whitening)
    return label_standard(prepared, specification, whitening, draws, seed, say, likelihood, route)


@dataclass(frozen=True)
class SamplerRun:
    """What a sampler tells besides its draws.

    Attributes:
        statistics: of the draws that are kept.
        route: as it stands in ``run.json``.
        diagnose: the verdict, of a summary.
    """

    statistics: xr.Dataset
    route: dict[str, Any]
    diagnose: Callable[[pd.DataFrame], dict[str, Any]]


def label_standard(
    prepared: Prepared,
    specification: ModelSpecification,
    approximation: Approximation,
    draws: Draws,
    seed: int,
    say: Say,
    likelihood: LikelihoodApproximation,
    route: Route,
) -> TraceAnalysis:
    """`label` of draws that are in this approximation's coordinates."""
    say("predicting", 0, 1)
    key, transitions = jax.random.PRNGKey(seed), labelled_statistics(draws, of_transitions=True)
    drawn = constrained_draws(prepared, approximation, draws, key, likelihood=likelihood)
    verdict = partial(diagnose, statistics=transitions, further=route.checks())
    sampler = SamplerRun(labelled_statistics(draws), route.record(), verdict)
    return label(prepared, specification, drawn, sampler, seed, say)


def _by_chain(
    prepared: Prepared,
    specification: ModelSpecification,
    expansions: GaussianFactor,
    seed: int,
    say: Say,
    checkpoints: Path | None,
) -> TraceAnalysis:
    """The fit by one Markov chain over everything; see `bayestissue.inference.chain`."""
    settings = specification.sampler
    sites = explanations(prepared, expansions, partial(say, "looking for other explanations of each trace"))
    chains = chain_draws(prepared, sites, settings.chains, seed, progress=say, checkpoints=checkpoints)
    chains = chains.thinned(settings.draws)
    shape = chains.shape
    u = chains.u[:, kept_draws(*shape, len(prepared.impacts))]
    u = u.reshape(-1, *u.shape[2:])
    say("predicting", 0, 1)
    population, key = chains.population(prepared.model), jax.random.PRNGKey(seed)
    likelihood = LikelihoodApproximation(Approximation.of_sites(chains.sites))
    drawn = quantities_of_draws(prepared, population, lambda rows: u[:, rows], shape, key, likelihood)
    statistics = labelled({"lp": chains.log_likelihood}, {}, {})

    def verdict(summary: pd.DataFrame) -> dict[str, Any]:
        return diagnose(summary, None, (), r_hat_limit(len(summary), *chains.shape))

    return label(prepared, specification, drawn, SamplerRun(statistics, chains.record(), verdict), seed, say)


def _with_estimate(say: Say, unasked: Route | None) -> Progress:
    """Tells the transitions done by the exact path, and from the first ones on how long all of them take.

    Where it was ``unasked`` for and would take longer than `_LONGEST_UNASKED_S`, it is given up.
    """
    stage, began = ["first transitions of the exact path"], time.monotonic()

    def report(done: int, total: int) -> None:
        if done and len(stage) == 1:
            seconds = (time.monotonic() - began) / done
            if unasked is not None and seconds * total > _LONGEST_UNASKED_S:
                words = f"The exact path would take about {duration(seconds * total)}."
                raise InputError.stated("exact-path", "fit", why=words, route=unasked.why)
            stage.append(
                f"exact path, {seconds:.2g} s a transition, about {duration(seconds * total)} in all"
            )
        say(stage[-1], done, total)

    return report


def label(
    prepared: Prepared,
    specification: ModelSpecification,
    drawn: ConstrainedDraws,
    sampler: SamplerRun,
    seed: int,
    say: Say,
) -> TraceAnalysis:
    """Labels, tables, checks and scores of the draws."""
    constrained = of_secant(prepared, drawn)
    tree = posterior_tree(prepared, specification, sampler.statistics, constrained, seed)
    posterior = tree["posterior"].dataset
    exponents = {
        q: posterior[f"mass_exponent_{q}"].to_numpy()
        for q in (*derived.RESPONSES, COMMON_DEPTH, "K_secant")
        if f"mass_exponent_{q}" in posterior
    }
    say("checking and scoring", 0, 1)
    form = _form(prepared, constrained, tree)
    scores, sensitivity = cross_validation(tree), prior_sensitivity(tree)
    recorded = prepared.design.recorded
    budget = uncertainty_budget(prepared, constrained)
    repeatable = {
        name: coefficients(_variances(prepared, tree[name].dataset, recorded, budget), tree[name].dataset)
        for name in ("posterior", "prior")
    }
    for name, measures in repeatable.items():
        tree[name] = xr.DataTree(tree[name].dataset.merge(as_variables(measures)))
    posterior = tree["posterior"].dataset
    summary = summary_table(posterior)
    # Functions of standard deviations that are checked themselves.
    checked = summary[~summary["variable"].isin(list(as_variables(repeatable["posterior"])))]
    diagnostics = sampler.diagnose(checked)
    further = {
        "straight_lines": straight_lines(prepared.design, posterior, prepared.model.log_mass_sd),
        "pooled_parameters": [
            one.record() for one in pooled_parameters(posterior, recorded, element(specification.element))
        ],
        "route": sampler.route,
    }
    responses, near = tuple(prepared.design.responses), specification.practical_equivalence
    return TraceAnalysis(
        tree,
        summary,
        diagnostics | form | further,
        derived.hypotheses(exponents, near.mass_exponent),
        scores,
        sensitivity,
        budget,
        contrasts(posterior, recorded, responses, near.ratio, specification.questions.values()),
        people_compared(posterior, recorded, responses),
        reliability(repeatable["posterior"], repeatable["prior"]),
    )


def _variances(
    prepared: Prepared, posterior: xr.Dataset, recorded: Recorded, budget: pd.DataFrame
) -> dict[str, Variances]:
    """What makes measured values of K and C differ; of one impact alone nothing is told."""
    if len(prepared.impacts) == 1:
        return {}
    model = prepared.model
    shared = model.log_mass_sd if model.mass_error == "subject" else 0.0
    return {
        q: variances(posterior, recorded, q, measurement_sd=measurement_sd(budget, q), shared_sd=shared)
        for q in derived.RESPONSES
    }


def _form(prepared: Prepared, constrained: ConstrainedDraws, tree: xr.DataTree) -> dict[str, Any]:
    """What the residuals say of the model, where it is one of the recorded deceleration."""
    if prepared.model.kind != "impact":
        return {}
    parameters = constrained.impacts["parameters"]
    rows = np.arange(parameters.shape[2])
    if constrained.kept_numbers is not None:
        rows = some_impacts(len(rows))
    middle = np.median(parameters[:, :, rows].astype(float), axis=(0, 1))
    chosen = some_of(prepared, rows)
    p = noise_p(chosen.model, chosen.data, middle)
    form = with_impacts(model_form(tree, "deceleration"), chosen.impacts["impact"].astype(str).tolist(), p)
    if not prepared.model.discrepancy:
        return {"model_form": form}
    undescribed = described(tree)
    return {
        "model_form": form
        | undescribed
        | {"words": undescribed["words"] if undescribed["undescribed"] else form["words"]}
    }
