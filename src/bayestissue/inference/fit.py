"""The fit of recorded traces, from prepared data to labelled results."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from bayestissue.base.outcome_table import HEADFORM_OUTCOMES, MEASURED
from bayestissue.inference.answers.contrasts import Contrasts, contrasts_table
from bayestissue.inference.answers.law import Law
from bayestissue.inference.answers.level_tables import curves_table, levels_table, loops_table
from bayestissue.inference.answers.reliability import (
    as_variables,
    coefficients,
    reliability,
)
from bayestissue.inference.answers.study import Study
from bayestissue.inference.chain.draws import ChainJob, chain_draws
from bayestissue.inference.chain.ending import r_hat_limit
from bayestissue.inference.chain.explanations import explanations
from bayestissue.inference.chain.results import ChainDraws, ChainEnd
from bayestissue.inference.checking.formula_checks import pooled_parameters, straight_lines
from bayestissue.inference.checking.mass_checks import judge_added_mass
from bayestissue.inference.checking.model_form import described, model_form, stated, with_impacts
from bayestissue.inference.execution.kept import some_impacts, some_of
from bayestissue.inference.factors.expansions import expanded
from bayestissue.inference.factors.noise_left import noise_p, noise_p_of_both
from bayestissue.inference.quantities.impact_quantities import COMMON_DEPTH
from bayestissue.inference.quantities.quantity_draws import Draws, posterior_draws
from bayestissue.inference.results.cross_validation import cross_validation, prior_sensitivity
from bayestissue.inference.results.labels import labelled
from bayestissue.inference.results.summary import diagnose, more_would_help
from bayestissue.inference.results.summary import summarise as summary_table
from bayestissue.inference.results.tree import posterior_tree
from bayestissue.inference.results.uncertainty_budget import measurement_sd, uncertainty_budget
from bayestissue.mechanics.elements import element
from bayestissue.mechanics.elements.element import GRAVITY
from bayestissue.model.hierarchy import derived
from bayestissue.model.hierarchy.gaussian.factor import GaussianFactor
from bayestissue.model.hierarchy.specification import ModelSpecification, Sampler
from bayestissue.model.hierarchy.trace_data import Prepared

# What chains begin with: the traces' own expansions, if they are at hand; or where an earlier run ended.
type Beginning = GaussianFactor | ChainEnd | None


@dataclass(frozen=True)
class TraceAnalysis:
    """Every result of a fit, labelled.

    Attributes:
        tree: the groups of ``posterior.nc``.
        diagnostics: the content of ``diagnostics.json``.
        tables: those of a finished run, by the names of their files.
        end: where the chains ended.
    """

    tree: xr.DataTree
    diagnostics: dict[str, Any]
    tables: dict[str, pd.DataFrame]
    end: ChainEnd | None = None

    @property
    def summary(self) -> pd.DataFrame:
        """The table of all quantities."""
        return self.tables["summary"]


def fit_traces(
    job: ChainJob, specification: ModelSpecification, beginning: Beginning = None
) -> TraceAnalysis:
    """Sample the posterior of every impact and of the population, check it, and label everything.

    Where the chains agree on all that was drawn and not yet on what follows from it, they go on.

    Args:
        job: what is sampled, as the model file has it.
        specification: the model file.
        beginning: as of `samples`.
    """
    job.progress("summarising each trace", 0, 1)
    settings = job.sampler
    for chains in samples(job, beginning):
        thin = chains.thinned(settings.draws)
        job.progress("predicting", 0, 1)
        analysis = label(job, specification, posterior_draws(job.prepared, thin, job.seed), thin)
        thinned = thin.shape != chains.shape
        if not more_would_help(analysis.diagnostics, thinned=thinned, effective=settings.effective):
            break
    return analysis


def sample(prepared: Prepared, sampler: Sampler, seed: int) -> ChainDraws:
    """The first draws of `samples`."""
    return next(samples(ChainJob(prepared, sampler, seed)))


def samples(job: ChainJob, beginning: Beginning = None) -> Iterator[ChainDraws]:
    """Draws of hyperparameters, effects and impacts as `chain_draws` yields them; see `fit_traces`.

    Args:
        job: what is sampled.
        beginning: `expanded` of the same, if it is at hand; or what to go on with.
    """
    if not isinstance(beginning, ChainEnd):
        finding = partial(job.progress, "looking for other explanations of each trace")
        beginning = explanations(job.prepared, beginning or expanded(job.prepared), finding)
    return chain_draws(job, beginning)


def label(
    job: ChainJob, specification: ModelSpecification, draws: Draws, chains: ChainDraws
) -> TraceAnalysis:
    """Labels, tables, checks and scores of the draws."""
    prepared, statistics = job.prepared, labelled({"lp": chains.log_likelihood})
    tree = posterior_tree(prepared, specification, statistics, draws, job.seed)
    job.progress("checking and scoring", 0, 1)
    form = _form(prepared, draws, tree)
    scores, sensitivity = cross_validation(tree), prior_sensitivity(tree)
    budget = uncertainty_budget(prepared, draws)
    # Beside a discrepancy K is the element's own, and the tissue's stiffness is K_secant.
    of_tissue = [q for q in derived.RESPONSES if q != "K" or not prepared.model.discrepancy]
    recorded, repeatable = prepared.design.recorded, {}
    # Of one impact alone nothing is said of what makes measured values differ.
    spreads = {q: measurement_sd(budget, q) for q in of_tissue if len(prepared.impacts) > 1}
    shared_sd = prepared.model.log_mass_sd if of_persons(prepared) else 0.0
    for name in ("posterior", "prior"):
        values = tree[name].dataset
        repeatable[name] = coefficients(values, recorded, spreads, shared_sd)
        tree[name] = xr.DataTree(values.merge(as_variables(repeatable[name])))
    posterior = tree["posterior"].dataset
    summary = summary_table(posterior)
    # Coefficients are functions of standard deviations, which are checked themselves.
    checked = summary[~summary["variable"].isin(list(as_variables(repeatable["posterior"])))]
    # Levels are compared by the law of force where there is one.
    gravity = float(tree["constant_data"].dataset.get(GRAVITY, 0.0))
    law = Law(specification.element, gravity, described=not prepared.model.discrepancy)
    compared, near = Contrasts(Study(posterior, recorded, law)), specification.practical_equivalence
    diagnostics = _diagnostics(prepared, specification, tree, checked, chains, form)
    # How K and C go with mass, of every exponent that there is.
    of_mass = {q: f"mass_exponent_{q}" for q in (*of_tissue, COMMON_DEPTH, "K_secant")}
    exponents = {q: posterior[name].to_numpy() for q, name in of_mass.items() if name in posterior}
    tables = {
        "summary": summary,
        "hypotheses": derived.hypotheses(exponents, near.mass_exponent),
        "cross_validation": scores,
        "sensitivity": sensitivity,
        "interval_sources": budget,
        "contrasts": contrasts_table(compared, near.ratio),
        "levels": levels_table(compared),
        "loops": loops_table(compared),
        "curves": curves_table(compared),
        "reliability": reliability(repeatable["posterior"], repeatable["prior"]),
    }
    return TraceAnalysis(tree, diagnostics, tables, chains.end)


def _diagnostics(
    prepared: Prepared,
    specification: ModelSpecification,
    tree: xr.DataTree,
    checked: pd.DataFrame,
    chains: ChainDraws,
    form: dict[str, Any],
) -> dict[str, Any]:
    """What draws say of chains and model, for ``diagnostics.json``; ``checked`` are rows of the summary."""
    model, design, posterior = prepared.model, prepared.design, tree["posterior"].dataset
    of_impacts = [str(name) for name, values in posterior.data_vars.items() if "impact" in values.dims]
    # Outcomes of single impacts that follow from K and C, less the measured ones and those of questions.
    questions = " ".join(specification.questions.values())
    unasked = [name for name in HEADFORM_OUTCOMES if name not in MEASURED and name not in questions]
    pooled = pooled_parameters(posterior, design.recorded, element(model.element))
    added = judge_added_mass(prepared, posterior, tree["prior"].dataset)
    return {
        **diagnose(checked, r_hat_limit(len(checked), *chains.shape), of_impacts, unasked),
        **form,
        "straight_lines": straight_lines(design, posterior, model.log_mass_sd, prepared.mass_group),
        "pooled_parameters": [one.record() for one in pooled],
        "route": chains.record(),
        **({"added_mass": added} if added else {}),
    }


def of_persons(prepared: Prepared) -> bool:
    """Whether each person has one error of the mass, in all impacts, that nobody else has."""
    if prepared.mass_group is None:
        return False
    people = prepared.design.subject
    pairs = len(np.unique(np.stack([people, prepared.mass_group]), axis=1).T)
    return pairs == people.max() + 1 == prepared.mass_group.max() + 1


def _form(prepared: Prepared, draws: Draws, tree: xr.DataTree) -> dict[str, Any]:
    """What the residuals say of the model, where it is one of recorded decelerations."""
    if prepared.model.kind != "impact":
        return {}
    parameters = draws.impacts["parameters"]
    rows = some_impacts(parameters.shape[2])
    middle = np.median(parameters[:, :, rows].astype(float), axis=(0, 1))
    chosen = some_of(prepared, rows)
    names = chosen.impacts["impact"].astype(str).tolist()
    p = noise_p(chosen.model, chosen.data, middle)
    form = with_impacts(model_form(tree, "deceleration"), names, p)
    if prepared.force:
        p = noise_p_of_both(chosen.model, chosen.data, middle)
        of_force = with_impacts(model_form(tree, "force"), names, p, together=True)
        return {"model_form": form, "channels": {"form": of_force}}
    if not prepared.model.discrepancy:
        return {"model_form": form}
    return {"model_form": stated(form | described(tree))}
