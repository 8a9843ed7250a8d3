"""Tables 5.10 and 5.11 recomputed: averages, standard deviations and ranges of the nine conditions."""

from __future__ import annotations

import numpy as np
import pandas as pd

from bayestissue.dataset.published import PublishedTables
from bayestissue.thesis.reproduction.agreement import Line, Recomputed, line
from bayestissue.thesis.reproduction.conditions import QUANTITIES, conditions

_NAMES = {"average": "average", "sd": "standard deviation", "range": "range"}


def summary_lines(published: PublishedTables) -> list[Line]:
    """Average, standard deviation (with n - 1) and range of K and C in every trial, printed and recomputed.

    The masses of the first of the two tables are set beside 2E/V², which defines them (section 6.4).
    """
    lines = []
    for quantity in QUANTITIES:
        table = conditions(published, quantity)
        if quantity == QUANTITIES[0]:
            lines += _mass_lines(table)
        for trial, condition in table.iterrows():
            lines += [
                line(
                    condition["table"],
                    condition["row"],
                    f"{label} of {quantity}, trial {trial}",
                    condition[f"{name}_text"],
                    _summary(condition, name, f"the impacts of trial {trial} are lost"),
                )
                for name, label in _NAMES.items()
            ]
    return lines


def _summary(condition: pd.Series, name: str, lost: str) -> Recomputed:
    if not condition["from_rows"]:
        return Recomputed(None, note=lost)
    repeated = name == "sd" and condition["sd_text"] == condition["range_text"]
    return Recomputed(
        condition[name],
        rounding=condition[f"{name}_rounding"],
        hint="repeats the range printed beside it" if repeated else "",
    )


def _mass_lines(table: pd.DataFrame) -> list[Line]:
    return [
        line(
            condition["table"],
            condition["row"],
            f"mass, trial {trial}",
            condition["mass_kg_text"],
            _mass(condition),
        )
        for trial, condition in table.iterrows()
    ]


def _mass(condition: pd.Series) -> Recomputed:
    # Energy and velocity are levels of a designed experiment (section 2.1): exact, whatever their digits.
    energy = condition["energy_J"]
    needed = np.sqrt(2 * energy / condition["mass_kg"])
    return Recomputed(
        2 * energy / condition["velocity_m_s"] ** 2,
        hint=f"E = ½MV² with the printed mass needs V = {needed:.3f} m/s",
    )
