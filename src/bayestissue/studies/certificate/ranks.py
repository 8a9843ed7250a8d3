"""Ranks of truths among the draws of their posteriors, and whether they are uniform as they should be.

Ranks of one element go by the farthest point of their empirical distribution. The distance at a place is the
binomial tail of the count of ranks below it; that of the whole curve is the smallest of these, whose
distribution is simulated (Säilynoja, Bürkner and Vehtari 2022, doi:10.1007/s11222-022-10090-6).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Float, Int
from scipy.special import bdtr, ndtr
from scipy.stats import binom, norm, t

from bayestissue.base.impact_arrays import evenly_spaced
from bayestissue.base.results.tables import columns_of, table_of_rows
from bayestissue.inference.chain.results import ChainDraws
from bayestissue.inference.factors.sites import log_likelihoods
from bayestissue.model.hierarchy.population import MASS_ERROR
from bayestissue.model.hierarchy.trace_data import Prepared
from bayestissue.studies.certificate.augmented import Truth

# A rank is among so many draws: one of a hundred places.
DRAWS = 99
_SIMULATED = 20_000
# What an interval of 90 % holds of these places.
_LEVEL = 0.9
# Below so much, over all quantities together, ranks are called not uniform: of certificates of a correct fit
# one in a hundred is wrong.
RARE = 0.01
_STUDIES = 4_000
Ranks = dict[str, Int[np.ndarray, " element"]]


def ranks_of(prepared: Prepared, chains: ChainDraws, truth: Truth, recorded: int) -> Ranks:
    """How many of `DRAWS` draws are below the truth, of each quantity that the chain draws.

    Args:
        prepared: the fit of recorded and drawn impacts.
        chains: its draws.
        truth: of all its impacts.
        recorded: how many impacts were recorded; the others were drawn.

    Returns:
        By name the ranks of its elements: of standard deviations and fixed effects one, of a group term those
        of its levels, of K, C and an impact's further parameters those of the recorded impacts and, apart, of
        the drawn ones; and that of the log likelihood of all traces.
    """
    model, design, levels = prepared.model, prepared.design, _levels(prepared)
    ranks = {
        name: _rank(chains.population.hyperparameters[name], truth.population.hyperparameters[name])
        for name in model.hyperparameters
    }
    for part in model.locations.blocks:
        where = model.locations.parts[part.name]
        where = slice(where.start, where.start + levels.get(part.name, part.width))
        ranks[part.name] = _rank(chains.population.b[..., where], truth.population.b[where])
    for q in ("K", "C"):
        # Each covariate's by its own name.
        if (name := f"covariate_effect_{q}") in ranks:
            columns = design.responses[q].names
            ranks |= {f"{name} of {c}": row[None] for c, row in zip(columns, ranks.pop(name), strict=True)}
    of_impacts = _rank(chains.u, truth.u)
    for number, name in enumerate(("K", "C", *model.nuisance)):
        ranks[f"{name} of recorded impacts"] = of_impacts[:recorded, number]
        ranks[f"{name} of drawn impacts"] = of_impacts[recorded:, number]
    density = log_likelihoods(model, prepared.data, truth.u[None]).sum()
    return ranks | {"log likelihood": _rank(chains.log_likelihood, density)}


def _rank(draws: Float[np.ndarray, "chain draw ..."], truth: np.ndarray | float) -> Int[np.ndarray, ...]:
    """Of `DRAWS` draws of all chains, evenly spaced."""
    flat = np.asarray(draws).reshape(-1, *np.shape(draws)[2:])
    return np.atleast_1d((flat[evenly_spaced(len(flat), DRAWS)] < np.asarray(truth)).sum(axis=0))


def _levels(prepared: Prepared) -> dict[str, int]:
    """How many levels there are of each group term, and errors of masses; the part of b may be wider."""
    masses = {} if prepared.mass_group is None else {MASS_ERROR: int(prepared.mass_group.max()) + 1}
    return masses | {
        term.effect(part.response): len(prepared.design.groupings[term.grouping].levels)
        for part in prepared.design.responses.values()
        for term in part.terms
    }


def calibration_table(ranks: Sequence[Mapping[str, Sequence[int]]]) -> pd.DataFrame:
    """The table ``calibration.csv``: a row a quantity, of the ranks of every refit.

    ``passed`` is 0 where p is small even for the least of so many quantities (Holm 1979). Without refits it
    is empty.
    """
    from statsmodels.stats.multitest import multipletests

    if not ranks:
        return table_of_rows("calibration")
    judged = pd.DataFrame([judge(name, np.array([row[name] for row in ranks])) for name in ranks[0]])
    _, p_all, *_ = multipletests(judged["p"], method="holm")
    table = judged.assign(refits=len(ranks), p_all=p_all, passed=(p_all >= RARE).astype(int))
    return table[columns_of("calibration")]


def judge(name: str, ranks: Int[np.ndarray, "refit element"]) -> dict[str, Any]:
    """Whether ranks of `DRAWS` are uniform: of one element over the refits, of several their means too.

    Elements of one refit are told from the same truth, so that refits alone are independent: standard errors
    are those of the refits' means, or of independent elements if greater. p of one element is that of
    `p_of_uniform`. Of several it is twice the smaller of two: a t test of the shift, and
    `p_of_held`.

    Returns:
        Cells of ``calibration.csv``.
    """
    refits, elements = ranks.shape
    places = (ranks + 0.5) / (DRAWS + 1)
    held = np.abs(places - 0.5) < _LEVEL / 2
    scores = norm.ppf(places)
    held_se = _standard_error(held.mean(axis=1), _LEVEL * (1 - _LEVEL) / (refits * elements))
    shift_se = _standard_error(scores.mean(axis=1), 1 / (refits * elements))
    if elements == 1:
        p = p_of_uniform(ranks[:, 0])
    else:
        p_shift = 2 * float(t.sf(abs(scores.mean()) / shift_se, refits - 1))
        p = min(1.0, 2 * min(p_shift, p_of_held(held.sum(axis=1), elements, scores.mean(axis=1).var(ddof=1))))
    means = {"held": float(held.mean()), "shift": float(scores.mean())}
    return means | {"quantity": name, "elements": elements, "held_se": held_se, "shift_se": shift_se, "p": p}


def p_of_held(held: Int[np.ndarray, " refit"], elements: int, variance: float) -> float:
    """How often so many intervals of 90 % hold as few, or as many, though all ranks are uniform.

    The scores of a refit's elements are taken as normal with one correlation, which the ``variance`` of their
    means over refits tells: (1 + (m - 1) rho) / m. As it is known from the refits alone, it is drawn too.
    """
    refits, rng = len(held), np.random.default_rng([len(held), elements])
    drawn = variance * (refits - 1) / rng.chisquare(refits - 1, (_STUDIES, 1))
    rho = np.clip((drawn * elements - 1) / (elements - 1), 0.0, 0.99)
    common, single = np.sqrt(rho) * rng.standard_normal((_STUDIES, refits)), np.sqrt(1 - rho)
    end = norm.isf((1 - _LEVEL) / 2)
    share = ndtr((end - common) / single) - ndtr((-end - common) / single)
    simulated, observed = rng.binomial(elements, share).sum(axis=1), held.sum()
    tail = min(int((simulated <= observed).sum()), int((simulated >= observed).sum()))
    # Beyond all that was simulated by the normal of the same mean and standard deviation.
    beyond = norm.sf(abs(observed - simulated.mean()) / max(simulated.std(), 0.5))
    return float(min(1.0, 2 * (tail / _STUDIES if tail else min(beyond, 1 / _STUDIES))))


def _standard_error(of_refits: Float[np.ndarray, " refit"], least: float) -> float:
    """Of their mean, whose variance is this at the least."""
    return float(np.sqrt(max(of_refits.var(ddof=1) / len(of_refits), least)))


def p_of_uniform(ranks: Int[np.ndarray, " refit"]) -> float:
    """How often uniform ranks have an empirical distribution as far from the diagonal as these."""
    simulated = _smallest_tails(len(ranks))
    return float((1 + (simulated <= _smallest_tail(ranks[None])[0]).sum()) / (1 + len(simulated)))


def half_band(refits: int) -> float:
    """How far the share of ranks in the lower half may be off 0.5, within an envelope of 95 % of curves."""
    end = np.quantile(_smallest_tails(refits), 0.05)
    return 0.5 - float(binom.ppf(end, refits, 0.5)) / refits


@cache
def _smallest_tails(refits: int) -> Float[np.ndarray, " simulated"]:
    rng = np.random.default_rng(refits)
    return _smallest_tail(rng.integers(0, DRAWS + 1, (_SIMULATED, refits)))


def _smallest_tail(ranks: Int[np.ndarray, "sample refit"]) -> Float[np.ndarray, " sample"]:
    """The smallest binomial tail of the counts up to each rank."""
    count, places = ranks.shape[1], np.arange(1, DRAWS + 1) / (DRAWS + 1)
    samples = np.repeat(np.arange(len(ranks)), count)
    by_rank = np.zeros((len(ranks), DRAWS + 1))
    np.add.at(by_rank, (samples, ranks.ravel()), 1)
    below = by_rank.cumsum(axis=1)[:, :-1]
    lower, upper = bdtr(below, count, places), 1 - np.where(below > 0, bdtr(below - 1, count, places), 0.0)
    return np.minimum(lower, upper).min(axis=1)
