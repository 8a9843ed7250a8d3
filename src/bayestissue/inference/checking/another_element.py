"""Whether a spring that stiffens at some levels of a factor explains what is left of a fit without one.

Where the law of spring and damper leaves nothing but noise at some levels, such as four of five pads, and not
at others, a discrepancy would take the law from all. A stiffening spring is the linear one where its depth of
stiffening is great, so that with a depth for each level it may serve all of them.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from bayestissue.base.errors import InputError
from bayestissue.base.outline import first_of
from bayestissue.base.remedies import sentence
from bayestissue.inference.checking.findings import Finding, warned_codes
from bayestissue.inference.checking.model_form import SMALL_P
from bayestissue.model.hierarchy import SIDE_BY_SIDE
from bayestissue.model.hierarchy.formulas.group_terms import quoted
from bayestissue.model.hierarchy.recorded import Recorded
from bayestissue.model.hierarchy.specification import ModelSpecification, specification_of

STIFFENS, DEPTH = "stiffening", "stiffening_depth_m"
# Of the impacts at a level with a small p: the law holds there up to the one, and does not from the other on.
_HOLDS, _FAILS = 0.1, 0.5
# Of a law, after which another element is not taken.
_DOUBTS = {"model-form", "structured-residuals", "pooled-parameter"}


def differing(form: Mapping[str, Any], names: np.ndarray, recorded: Recorded) -> dict[str, list[str]]:
    """The categories of K's formula at some of whose levels a law holds and at others not, with the others.

    Args:
        form: as `bayestissue.inference.checking.model_form.with_impacts` has it.
        names: of the impacts.
        recorded: of the fit.
    """
    p = pd.Series(form.get("impacts", {}).get("p", {}), dtype=float).reindex(names).to_numpy()
    tested, found = np.isfinite(p), {}
    for column in recorded.response("K").categories:
        small = pd.Series(p < SMALL_P)[tested].groupby(recorded.labels(column)[tested])
        shares = small.mean().reindex(recorded.levels(column)).dropna()
        fails = shares.index[shares >= _FAILS].tolist()
        if fails and (shares <= _HOLDS).any():
            found[column] = fails
    return found


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
    """What another element is tried for: the ``formula`` of its depth, and ``words``; empty where none is."""
    found = differing(form, names, recorded)
    if not found:
        return {}
    where = "; ".join(f"{column} {first_of(levels, 8)}" for column, levels in found.items())
    formula = " + ".join(f"C({n})" if recorded.is_number(n) else quoted([n]) for n in found)
    words = sentence("model-form.stiffens", score=form["score"], where=where, formula=formula)
    numbers = {"formula": formula, "instead_of": SIDE_BY_SIDE, "score_without": form["score"]}
    return Finding("model-form", passed=True, words=words).record(**numbers)


def explains(diagnostics: Mapping[str, Any]) -> bool:
    """Whether a fit with the other element leaves no doubt of its law."""
    return bool(diagnostics["passed"]) and not _DOUBTS & set(warned_codes(diagnostics))
