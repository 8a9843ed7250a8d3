"""Whether what a fit leaves over of the traces is noise, or the mark of another law than the model's.

One verdict for the page, its first screen and `diagnostics.json`: all impacts together say whether another
law is at work (`model_form`), each by itself whether its residuals are the model's noise
(`with_impacts`).

Where the law of spring and damper leaves nothing but noise at some levels of a factor, such as four of five
pads, and not at others, a discrepancy would take the law from all. A stiffening spring is the linear one
where its depth of stiffening is great, so that with a depth for each level it may serve all: it is tried
before (`instead`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

import jax
import numpy as np
import pandas as pd
import xarray as xr
from jax import Array
from jaxtyping import Float
from scipy.stats import binom, combine_pvalues

from bayestissue.base.errors import InputError
from bayestissue.base.impact_arrays import PerImpact, PerParameter, PerSample
from bayestissue.base.outline import first_of
from bayestissue.base.remedies import sentence
from bayestissue.inference.checking.findings import ALL_ROWS, OF_K, Finding, warned_codes
from bayestissue.inference.execution.kept import some_impacts, some_of
from bayestissue.inference.points.whiteness import autocorrelation
from bayestissue.inference.quantities.quantity_draws import PREDICTIVE_DRAWS, replicates
from bayestissue.model.hierarchy import SIDE_BY_SIDE
from bayestissue.model.hierarchy.formulas.group_terms import quoted
from bayestissue.model.hierarchy.gaussian.factor import GaussianFactor
from bayestissue.model.hierarchy.recorded import Recorded
from bayestissue.model.hierarchy.specification import ModelSpecification, specification_of
from bayestissue.model.hierarchy.trace_data import Prepared
from bayestissue.model.hierarchy.trace_models import TraceData

# An impact's p-value that is counted.
SMALL_P = 0.01
# Of sound impacts the share with a smaller one, at the most: 1.0 to 1.6 % of 1,000 were.
_BY_CHANCE = 0.015
# Probability that so many of a sound dataset are counted; and that any of them is named alone, at the most.
_TOO_MANY, _ALONE = 0.01, 0.001
NAMED = 5
# What a p that is 0 to rounding is taken for.
_LEAST_P = 1e-300
# So many times the median impact's is a discrepancy of its own.
_SEVERAL = 5.0
# In standard errors of the pooled score: once in thirty thousand fits of the right model.
LIMIT = 4.0
# A parabola takes up most of what the measuring chain does and little of another law: a stiffening spring
# fitted by a linear one showed at 74 standard errors, and at 12 less a cubic.
_SMOOTH = 3
_LAGS = 6
# Of a discrepancy's rms over the trace's peak: beyond it the element describes nothing of the force.
MOST_DISCREPANCY = 0.2


def model_form(tree: xr.DataTree, name: str) -> dict[str, Any]:
    """How much more alike residuals are from sample to sample than those of replicates from the model.

    The autocorrelations of each trace less the replicates' median, summed over six lags, a parabola in time
    taken off both; the sum's distance from the replicates' mean in their standard deviations; and these
    distances added up over the root of their number.

    Args:
        tree: a finished fit.
        name: "deceleration" or "displacement", in its observed data and its predictions.

    Returns:
        ``score``, the pooled one, and ``structured``, whether it is above `LIMIT`; and what `stated` adds.
    """
    predicted = tree["posterior_predictive"].dataset[name]
    replicated = predicted.to_numpy().reshape(-1, *predicted.shape[2:]).astype(float)
    measured = tree["observed_data"].dataset[name].sel(impact=predicted["impact"]).to_numpy()
    return judged(measured, replicated)


def judged(measured: PerSample, replicated: Float[np.ndarray, "draw impact sample"]) -> dict[str, Any]:
    """`model_form` of traces and their replicates, NaN past a row's end."""
    score = pooled_score(measured, replicated)
    return stated({"score": score, "structured": bool(score > LIMIT)})


def with_impacts(
    form: dict[str, Any], names: Sequence[str], p: PerImpact, *, together: bool = False
) -> dict[str, Any]:
    """What was said of the form, with what each impact's residuals say.

    Args:
        form: as `model_form` has it.
        names: of the impacts.
        p: of each, as `bayestissue.inference.factors.noise_left.noise_p` finds them; NaN where not tested.
        together: whether chance is asked of all p at once by Fisher's method, -2 sum log p being chi-squared
            with twice as many degrees of freedom as impacts (Fisher 1925, Statistical Methods for Research
            Workers, section 21.1), instead of how many are small: what is slight in every impact shows then.

    Returns:
        Besides ``impacts``: ``p`` by name, how many were ``tested`` and are ``below`` `SMALL_P`, whether
        they are ``structured``, which chance makes of fewer than two sound datasets in a hundred, and then
        the ``names`` of those below; of all ``together`` their p as ``combined`` too.
    """
    p_values = {
        str(name): float(f"{value:.4g}") for name, value in zip(names, p, strict=True) if np.isfinite(value)
    }
    below = [name for name, value in p_values.items() if value < SMALL_P]
    tested, least = len(p_values), min(p_values.values(), default=1.0)
    by_chance = float(binom.sf(len(below) - 1, tested, _BY_CHANCE))
    if together:
        combined = combine_pvalues(np.maximum(list(p_values.values()) or [1.0], _LEAST_P)).pvalue
        by_chance = float(f"{combined:.4g}")
    structured = bool(by_chance < _TOO_MANY or least < _ALONE / max(tested, 1))
    impacts = {
        "p": p_values,
        "tested": tested,
        "below": len(below),
        "structured": structured,
        "names": below if structured else [],
    } | ({"combined": by_chance} if together else {})
    return stated(form | {"impacts": impacts})


def with_discrepancy(first: dict[str, Any], tree: xr.DataTree) -> dict[str, Any]:
    """What `model_form` said of a fit without a discrepancy, after one with it.

    Args:
        first: of the fit without.
        tree: the fit with it.

    Returns:
        ``score`` and ``structured`` as they were, what `described` says of the fit with it, ``apart``, the
        impacts in which the discrepancy is several times the median one, ``greatest``, its largest, ``sure``,
        half the relative width of the 90 % interval of K_secant (median impact), and ``left``, the score of
        the fit with it.
    """
    posterior = tree["posterior"].dataset
    discrepancy, sizes = described(tree), of_impacts(posterior["discrepancy"])
    larger = sizes[sizes > _SEVERAL * discrepancy["discrepancy"]].sort_values(ascending=False)
    stiffness = posterior["K_secant"]
    drawn = [name for name in stiffness.dims if name != "impact"]
    low, high = stiffness.quantile([0.05, 0.95], drawn).to_numpy()
    further = {
        "apart": list(larger.index),
        "greatest": float(sizes.max()),
        "of": len(sizes),
        "sure": float(np.sqrt(np.median(high / low)) - 1),
        "left": model_form(tree, "deceleration")["score"],
    }
    return stated(first | discrepancy | further)


def described(tree: xr.DataTree) -> dict[str, Any]:
    """Whether the element describes the traces of a fit with a discrepancy at all.

    Where the smooth force that is added beside the element has an rms above `MOST_DISCREPANCY` of the peak,
    what is left of K and C is that force's and not the tissue's: clipped and saturated records are such.

    Returns:
        ``discrepancy``, its rms as a fraction of the trace's peak (median impact), ``undescribed``, whether
        that is beyond the limit, and ``undescribed_impacts``, which are so by themselves.
    """
    draws = tree["posterior"].dataset["discrepancy"]
    size, sizes = float(draws.median()), of_impacts(draws)
    return {
        "discrepancy": size,
        "undescribed": size > MOST_DISCREPANCY,
        "undescribed_impacts": list(sizes.index[sizes > MOST_DISCREPANCY]),
    }


def of_impacts(draws: xr.DataArray) -> pd.Series:
    """The median of each impact, by its name."""
    return draws.median([name for name in draws.dims if name != "impact"]).to_series()


def stated(form: dict[str, Any], chain: Mapping[str, Any] = MappingProxyType({})) -> dict[str, Any]:
    """What is known of the form, with its code where it is a finding, and its words.

    Args:
        form: as the other functions have it.
        chain: as `bayestissue.inference.checking.measuring_chain.judge` has it. Where another measuring chain
            would leave no structure, that comes first.
    """
    impacts, score = form.get("impacts", {}), sentence("model-form.score", score=form["score"])
    if form.get("undescribed"):
        code, words = "undescribed", sentence("undescribed.words", size=100 * form["discrepancy"])
        words = f"{score}. {words}" if "left" in form else words
    elif form["structured"]:
        code, law, remedy = "model-form", sentence("model-form.first"), sentence("model-form.remedy")
        if chain.get("passed") is False:
            law = sentence("model-form.explained", error=chain["error"], left=chain["structure_left"])
            remedy = sentence("model-form.mend")
        key = "discrepancy" if "left" in form else "structured"
        words = sentence(f"model-form.{key}", score=score, law=law, remedy=remedy, **_sizes(form))
    else:
        code, words = "structured-residuals", sentence("model-form.sound", score=score)
        if impacts:
            counted = sentence("structured-residuals.counted", small=SMALL_P, **impacts)
            key, named = "impacts" if impacts["structured"] else "nothing", first_of(impacts["names"], NAMED)
            words = sentence(f"structured-residuals.{key}", counted=counted, named=named, words=words)
        if not impacts.get("structured"):
            return form | {"words": words}
    return Finding(code, passed=False, words=words, first=sentence(f"{code}.first")).record(**form)


def _sizes(form: dict[str, Any]) -> dict[str, Any]:
    """The numbers of the sentence on a discrepancy, if there is one."""
    if "left" not in form:
        return {}
    larger = form["apart"]
    numbers = {"most": 100 * form["greatest"], "count": len(larger), "of": form["of"]}
    apart = sentence("model-form.apart", named=first_of(larger, NAMED), **numbers) if larger else ""
    return {"size": 100 * form["discrepancy"], "sure": 100 * form["sure"], "apart": apart}


def marked_rows(form: dict[str, Any]) -> list[dict[str, Any]]:
    """Findings that mark rows of the summary beside a discrepancy: K is the element's own, or no estimate."""
    if "discrepancy" not in form:
        return []
    none = ALL_ROWS if form["undescribed"] else form["undescribed_impacts"]
    marked = Finding("element-alone", passed=True, rows=OF_K), Finding("undescribed", passed=True, rows=none)
    return [finding.record() for finding in marked]


def pooled_score(measured: PerSample, replicated: Float[np.ndarray, "draw impact sample"]) -> float:
    """See `model_form`; NaN past a row's end."""
    middle = np.median(replicated, axis=0)
    used = np.isfinite(measured) & np.isfinite(middle)
    # One after the other: of thousands of traces all replicates at once take a third of a GiB.
    observed, *others = (
        autocorrelation(traces - middle, used, powers=_SMOOTH, lags=_LAGS)
        for traces in (measured, *replicated)
    )
    drawn = np.array(others)
    distance = (observed - drawn.mean(0)) / drawn.std(0, ddof=1)
    return float(distance.sum() / np.sqrt(len(distance)))


# Short of this a whole fit decides.
_PLAIN = 2 * LIMIT
# Fitted noise over the recorder's own, above which it is worth a look.
_SUSPICIOUS = 1.2


def misfit_precheck(prepared: Prepared, expansions: GaussianFactor, seed: int) -> dict[str, Any] | None:
    """What `model_form` says of replicates of the best fits, where that leaves no doubt of the form.

    A best fit follows its trace more closely than the draws of a posterior do, and so understates what its
    residuals have in common. Of very many impacts some are asked.

    Args:
        prepared: the model and its data.
        expansions: each trace's own, as `bayestissue.inference.factors.expansions.expanded` finds them.
        seed: of the replicates.
    """
    rows = some_impacts(len(prepared.impacts))
    prepared, best = some_of(prepared, rows), np.asarray(expansions.centre)[rows]
    noise = np.exp(best[:, 2] + np.asarray(prepared.data.log_peak))
    if np.median(noise / np.maximum(prepared.signal.quiet.noise_sd, 1e-12)) < _SUSPICIOUS:
        return None
    key = jax.random.fold_in(jax.random.PRNGKey(seed), 31)
    verdict = judged_at(prepared, prepared.data, best, key)
    return verdict if verdict["score"] > _PLAIN else None


def judged_at(
    prepared: Prepared,
    data: TraceData,
    u: PerParameter,
    key: Array,
    offset: Float[np.ndarray, "impact 1"] | float = 0.0,
) -> dict[str, Any]:
    """`model_form` of decelerations less the offset, beside replicates of ``data`` at one u."""
    keys = jax.random.split(key, PREDICTIVE_DRAWS)
    draws = np.broadcast_to(u, (PREDICTIVE_DRAWS, *u.shape))
    of_each = replicates(prepared.model, data, draws, keys)
    replicated, signal = of_each["deceleration"], prepared.signal
    # An offset does not move samples at the sensor's limit.
    used = signal.inside & ~signal.at_limit
    return judged(np.where(used, signal.deceleration - offset, np.nan), replicated)


STIFFENS, DEPTH = "stiffening", "stiffening_depth_m"
# Of the impacts at a level with a small p: the law holds there up to the one, and does not from the other on.
_HOLDS, _FAILS = 0.1, 0.5
# Of a law, after which another element is not taken.
_DOUBTS = {"model-form", "structured-residuals", "pooled-parameter"}


def stiffening_by(specification: ModelSpecification, formula: str) -> ModelSpecification | None:
    """The same model with a spring that stiffens by a formula; None where it has another element."""
    if specification.element != SIDE_BY_SIDE:
        return None
    content = specification.model_dump(mode="json", exclude_unset=True)
    formulas = content.get("formula", {}) | {DEPTH: formula}
    try:
        return specification_of(content | {"element": STIFFENS, "formula": formulas}, "model")
    except InputError:
        return None


def instead(form: Mapping[str, Any], names: np.ndarray, recorded: Recorded) -> dict[str, Any]:
    """What another element is tried for: the ``formula`` of its depth, and ``words``; empty where none is.

    It is by the categories of K's formula at some of whose levels the law holds and at others not.

    Args:
        form: as `with_impacts` has it.
        names: of the impacts.
        recorded: of the fit.
    """
    p = pd.Series(form.get("impacts", {}).get("p", {}), dtype=float).reindex(names).to_numpy()
    tested, failing = np.isfinite(p), {}
    for column in recorded.response("K").categories:
        small = pd.Series(p < SMALL_P)[tested].groupby(recorded.labels(column)[tested])
        shares = small.mean().reindex(recorded.levels(column)).dropna()
        fails = shares.index[shares >= _FAILS].tolist()
        if fails and (shares <= _HOLDS).any():
            failing[column] = fails
    if not failing:
        return {}
    where = "; ".join(f"{column} {first_of(levels, 8)}" for column, levels in failing.items())
    formula = " + ".join(f"C({n})" if recorded.is_number(n) else quoted([n]) for n in failing)
    words = sentence("model-form.stiffens", score=form["score"], where=where, formula=formula)
    numbers = {"formula": formula, "instead_of": SIDE_BY_SIDE, "score_without": form["score"]}
    return Finding("model-form", passed=True, words=words).record(**numbers)


def explains(diagnostics: Mapping[str, Any]) -> bool:
    """Whether a fit with the other element leaves no doubt of its law."""
    return bool(diagnostics["passed"]) and not _DOUBTS & set(warned_codes(diagnostics))
