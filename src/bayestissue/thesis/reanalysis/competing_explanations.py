"""Competing explanations of published estimates: how well each predicts impacts and trials not seen."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

import numpy as np
import pandas as pd
import xarray as xr
from jaxtyping import Bool
from scipy.special import logsumexp

from bayestissue.base.result import silent
from bayestissue.inference import model_comparison
from bayestissue.inference.execution.chunks import Progress
from bayestissue.inference.samplers.sampling import k_threshold, pareto_smoothed
from bayestissue.model.hierarchy.specification import Sampler
from bayestissue.thesis.reanalysis.table_chain import (
    EstimatesPosterior,
    evidence_ratios,
    leave_one_out_at,
    sample_posterior,
)
from bayestissue.thesis.reanalysis.table_model import EstimatesData, EstimatesModel, without

# Of each explanation, and of each again without a trial.
SAMPLER = {"chains": 2, "draws": 500, "effective": 200}


def compare_explanations(
    model: EstimatesModel,
    explanations: Mapping[str, EstimatesData],
    trial: np.ndarray,
    sampler: Sampler,
    seed: int,
    progress: Progress = silent,
) -> pd.DataFrame:
    """Leave-one-impact-out and leave-one-trial-out accuracy of explanations of the same data.

    Args:
        model: what all of them assume.
        explanations: the data by each one's formula, which differ in X alone.
        trial: the label of each row's trial.
        sampler: settings, of which the comparison changes what `SAMPLER` says.
        seed: of all draws.
        progress: told how many explanations are done.

    Returns:
        The tables of `bayestissue.inference.model_comparison`, one below the other.
    """
    if not explanations:
        return pd.DataFrame(columns=model_comparison.COLUMNS)
    settings = Sampler.model_validate(sampler.model_dump() | SAMPLER)
    held_out = [trial == label for label in dict.fromkeys(trial)]
    over, trees, scores, fitted = ("chain", "draw"), {}, {}, {}
    for number, (name, data) in enumerate(explanations.items()):
        progress(number, len(explanations))
        posterior = sample_posterior(model, data, settings, seed)
        left_out = leave_one_out_at(model, posterior.data, posterior.y)[..., len(data.roots) :]
        trees[name] = xr.DataTree.from_dict(
            {
                "posterior": xr.Dataset({q: (over, draws) for q, draws in posterior.hyperparameters.items()}),
                "log_likelihood": xr.Dataset({"estimates": ((*over, "impact"), left_out)}),
            }
        )
        densities = posterior.rows[..., len(data.roots) :]
        fitted[name] = (logsumexp(densities, axis=(0, 1)) - np.log(densities[..., 0].size)).sum()
        score = partial(log_predictive_density, model, posterior, settings=settings, seed=seed)
        scores[name] = np.array([score(rows) for rows in held_out])
    progress(len(explanations), len(explanations))
    by_impact = model_comparison.by_importance(trees, model_comparison.BY_IMPACT)
    by_impact["p_effective"] = by_impact["model"].map(fitted) - by_impact["elpd"]
    return pd.concat([by_impact, model_comparison.by_trial(scores)], ignore_index=True)


def log_predictive_density(
    model: EstimatesModel,
    posterior: EstimatesPosterior,
    rows: Bool[np.ndarray, " row"],
    *,
    settings: Sampler,
    seed: int,
) -> float:
    """Log density of some rows given all others: the ratio of the evidences with them and without.

    By Pareto-smoothed importance sampling of the hyperparameters, all effects integrated out (Vehtari et al.
    2016, doi:10.48550/arXiv.1412.8163, call this integrated); where Pareto k refuses that, by chains without
    these rows.
    """
    others = without(posterior.data, rows)
    log_weight = evidence_ratios(model, posterior, others, seed)
    smoothed, k = pareto_smoothed(log_weight)
    if k <= k_threshold(len(log_weight)):
        return float(logsumexp(smoothed - log_weight))
    refitted = sample_posterior(model, others, settings, seed, near=posterior)
    back = evidence_ratios(model, refitted, posterior.data, seed)
    return float(logsumexp(back) - np.log(len(back)))
