"""The fit of recorded traces, from prepared data to labelled results."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pandas as pd
import xarray as xr

from bayestissue.hierarchy import derived
from bayestissue.hierarchy.conditional import Summaries
from bayestissue.hierarchy.specification import ModelSpecification
from bayestissue.hierarchy.trace_data import Prepared
from bayestissue.hierarchy.traces import sampled_model
from bayestissue.inference.chains import Start, run_chains
from bayestissue.inference.diagnostics import diagnose
from bayestissue.inference.sampling import Draws
from bayestissue.inference.summary import summarise as summary_table
from bayestissue.inference.trace_draws import unfold
from bayestissue.inference.trace_scores import cross_validation, prior_sensitivity
from bayestissue.inference.trace_start import Spreads, summarise
from bayestissue.inference.trace_tree import posterior_tree

Say = Callable[[str, int, int], None]


@dataclass(frozen=True)
class TraceAnalysis:
    """Every result of a fit, labelled; the tables are the files of a finished run."""

    tree: xr.DataTree
    summary: pd.DataFrame
    diagnostics: dict[str, Any]
    hypotheses: pd.DataFrame
    cross_validation: pd.DataFrame
    sensitivity: pd.DataFrame


def fit_traces(
    prepared: Prepared,
    specification: ModelSpecification,
    seed: int,
    say: Say,
    *,
    checkpoints: Path | None = None,
) -> TraceAnalysis:
    """Sample the posterior of every impact and of the population, check it, and label everything.

    Args:
        prepared: model and data.
        specification: the model file.
        seed: of all draws.
        say: told the stage, how much of it is done, and its total.
        checkpoints: an existing folder for finished segments of the chains; see `run_chains`.
    """
    say("summarising each trace", 0, 1)
    summaries, spreads = summarise(prepared)
    draws = run_chains(
        partial(sampled_model, prepared.model),
        (prepared.data, summaries),
        start_of(prepared, summaries, spreads),
        specification.sampler,
        seed,
        progress=partial(say, "sampling the posterior"),
        checkpoints=checkpoints,
    )
    return label(prepared, specification, summaries, draws, seed, say)


def start_of(prepared: Prepared, summaries: Summaries, spreads: Spreads) -> Start:
    """Chains begin at the spreads' mode given the summaries, and at the middle of all standard normals."""
    middle = {
        "standard_locations": np.zeros(prepared.model.locations.size),
        "standard_impacts": np.zeros(summaries.centre.shape),
    }
    return Start({**spreads.mode, **middle}, tuple(sorted(spreads.mode)), spreads.covariance)


def label(
    prepared: Prepared,
    specification: ModelSpecification,
    summaries: Summaries,
    draws: Draws,
    seed: int,
    say: Say,
) -> TraceAnalysis:
    """Everything that follows from the draws."""
    say("predicting", 0, 1)
    unfolded = unfold(prepared, summaries, draws, jax.random.PRNGKey(seed))
    tree = posterior_tree(prepared, specification, draws, unfolded, seed)
    posterior = tree["posterior"].dataset
    exponents = {
        q: posterior[f"mass_exponent_{q}"].to_numpy()
        for q in derived.RESPONSES
        if f"mass_exponent_{q}" in posterior
    }
    say("checking and scoring", 0, 1)
    return TraceAnalysis(
        tree,
        summary_table(posterior),
        diagnose(tree),
        derived.hypotheses(exponents, specification.practical_equivalence.mass_exponent),
        cross_validation(tree),
        prior_sensitivity(tree),
    )
