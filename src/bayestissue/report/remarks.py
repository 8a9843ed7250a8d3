"""Sentences beside the report's figures and tables, each computed from what they show."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pandas as pd

from bayestissue.errors import Coded
from bayestissue.hierarchy.formulas.group_terms import stem_of
from bayestissue.inference.comparing.stacking import decides
from bayestissue.report.posterior import QUANTITIES, PosteriorRun
from bayestissue.report.wording import listed

_FINE = ("✓", "")
_WORDS = {"subject": ("person", "people"), "trial": ("condition", "conditions")}


def group_words(level: str) -> tuple[str, str]:
    """What one and what several of a grouping's levels are called."""
    return _WORDS.get(level, (f"level of {level}", f"levels of {level}"))


def who_differs(run: PosteriorRun, level: str, quantities: Iterable[str] = QUANTITIES) -> str:
    """Whose effect on a quantity has a 90 % interval without zero (``level``: "subject", "subject:side")."""
    parts = []
    for quantity in quantities:
        name = f"{stem_of(level)}_effect_{quantity}"
        if run.has(name):
            low, high = np.percentile(run.draws(name), [5, 95], axis=0)
            labels = np.array(run.labels(level))[(low > 0) | (high < 0)]
            named = f": {listed(list(labels))}" if labels.size else ""
            parts.append(f"in {quantity} {labels.size or 'none'} of {low.size}{named}")
    one, several = group_words(level)
    if not parts:
        return f"This model has no effects of {several}."
    text = "; ".join(parts)
    return f"Differ from the typical {one}, by a 90 % interval without zero: {text}."


def best_explanations(comparison: pd.DataFrame) -> list[str]:
    """For each scheme: the model that predicts best, those about as good, and the warnings."""
    return [_best(str(scheme), rows) for scheme, rows in comparison.groupby("scheme", sort=False)]


def _best(scheme: str, rows: pd.DataFrame) -> str:
    ordered = rows.sort_values("elpd", ascending=False)
    others = ordered.iloc[1:]
    close = others[~decides(others["elpd_difference"], others["se_difference"])]
    rivals = (
        f"within two standard errors or four nats of it: {listed(close['model'].to_list())}"
        if len(close)
        else "no other comes within two standard errors or four nats of it"
    )
    warnings = ordered.loc[ordered["warning"] != "", "warning"].value_counts()
    told = listed([f"{warning} ({count} of {len(ordered)} models)" for warning, count in warnings.items()])
    doubt = f" Warned: {told}." if told else ""
    first = f"{scheme[:1].upper()}{scheme[1:]}"
    return f"{first}: “{ordered['model'].iloc[0]}” predicts best; {rivals}.{doubt}"


def prior_remark(sensitivity: pd.DataFrame) -> str:
    """Which posteriors the sensitivity analysis has something to say about."""
    told = sensitivity[~sensitivity["diagnosis"].isin(_FINE)]
    if told.empty:
        return f"No posterior is sensitive to its prior; looked at: {len(sensitivity)}."
    named = [f"{row['variable']} ({row['diagnosis']})" for row in told.to_dict("records")]
    return Coded(f"Worth a look, of {len(sensitivity)} posteriors: {listed(named)}.", "prior-sensitive")
