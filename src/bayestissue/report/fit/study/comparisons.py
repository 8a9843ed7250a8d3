"""Levels and people held against each other, in words, in a table, and as a matrix."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from bayestissue.report.fit.run import FitRun
from bayestissue.report.posterior import Spread
from bayestissue.report.tables import Field, Table, lines, table_of
from bayestissue.report.wording import likelihood_words, percent, probability, significant

_ON_FIRST_SCREEN = 2
MOST_ROWS = 300
_MASSES = (
    "Here conditions stand for masses, so that the mass exponent compares them; their effects are what the "
    "mass leaves over."
)


def first_contrasts(run: FitRun) -> list[dict[str, Any]]:
    """The first comparisons, not of one person's levels: each with K, C and a sentence; empty if none."""
    if run.contrasts is None:
        return []
    own = run.contrasts[~run.contrasts["factor"].str.contains(":")]
    found = []
    for (factor, level, against), part in own.groupby(["factor", "level", "against"], sort=False):
        shown = [line for line in lines(part) if line.quantity in ("K", "C")]
        found.append(
            {
                # A number alone says nothing: session 2 over session 1.
                "what": f"{factor} {level} over {against}"
                if _is_number(level)
                else f"{level} over {against}",
                "factor": factor,
                "ratios": [_ratio(line) for line in shown],
                "words": " ".join(_words(line, str(level), equivalence(run)) for line in shown),
            }
        )
    return found[:_ON_FIRST_SCREEN]


def _is_number(level: Any) -> bool:
    try:
        float(level)
    except ValueError:
        return False
    return True


def equivalence(run: FitRun) -> float:
    """The relative difference that counts as none in practice."""
    return float(run.about.get("model", {}).get("practical_equivalence", {}).get("ratio", 0.1))


def _ratio(line: Any) -> dict[str, str]:
    found = Spread(line.ratio, line.low, line.high)
    return {"quantity": line.quantity, "value": found.value, "range": found.range}


def _words(line: Any, level: str, near: float) -> str:
    what = "greater" if line.ratio > 1 else "less"
    return (
        f"{line.quantity} is {likelihood_words(line.p_direction)} {what} for {level} (probability "
        f"{probability(line.p_direction)}); the probability that it differs by less than {percent(near)} is "
        f"{probability(line.p_equivalent)}."
    )


def conditions_words(run: FitRun) -> str:
    """Why conditions are not compared; empty where they are, or where the model has none."""
    masses = run.has("mass_exponent_K") or run.has("mass_exponent_C")
    conditions = run.has("trial_effect_K") or run.has("trial_effect_C")
    compared = run.contrasts is not None and bool((run.contrasts["factor"] == "trial").any())
    return _MASSES if masses and conditions and not compared else ""


def contrasts_table(run: FitRun) -> Table | None:
    """The first 300 rows of `contrasts.csv`; None where there is nothing to compare."""
    if run.contrasts is None or run.contrasts.empty:
        return None
    return table_of(
        lines(run.contrasts[:MOST_ROWS]),
        Field("of", lambda line: line.factor),
        Field("comparison", lambda line: f"{line.level} over {line.against}"),
        Field("quantity", lambda line: line.quantity),
        Field("ratio", lambda line: _ratio(line)["value"], "number"),
        Field("90 %", lambda line: _ratio(line)["range"], "number"),
        Field("direction", lambda line: probability(line.p_direction), "number"),
        Field(f"within {percent(equivalence(run))}", lambda line: probability(line.p_equivalent), "number"),
    )


def matrices(run: FitRun) -> list[dict[str, Any]]:
    """For each quantity the people, the greatest first, and the probability that each exceeds each other."""
    if run.people_compared is None:
        return []
    return [_matrix(str(name), part) for name, part in run.people_compared.groupby("quantity", sort=False)]


def _matrix(quantity: str, part: pd.DataFrame) -> dict[str, Any]:
    square = part.pivot_table(index="person", columns="against", values="p_greater")
    order = square.mean(axis=1).sort_values(ascending=False, kind="stable").index
    values = square.reindex(index=order, columns=order).to_numpy()
    return {
        "quantity": quantity,
        "people": [str(name) for name in order],
        "rows": [[_cell(value) for value in row] for row in values],
    }


def _cell(value: float) -> dict[str, str]:
    """A probability as whole percent, and the depth of its colour from −1 to 1; the diagonal is empty."""
    if not np.isfinite(value):
        return {"text": "", "tint": "", "word": "self"}
    text = ">99" if value >= 0.995 else "<1" if value <= 0.005 else f"{100 * value:.0f}"
    depth = significant(0.65 * abs(2 * value - 1), 2)
    return {"text": text, "tint": depth, "word": "greater" if value >= 0.5 else "less"}
