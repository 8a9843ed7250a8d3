"""What impacts do on the levels of each factor that a formula compares: values and ranks, loops, curves.

A level is that of a typical person there, all else at the reference, as in a question such as
``peak_force[pad=A]``. Where nothing is compared, loops are those of a typical person.

A loop is force over depth: their medians at equal shares of the time to the greatest depth, and from there
until the impactor leaves.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import product
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from jaxtyping import Float

from bayestissue.hierarchy.levels import log_at_levels
from bayestissue.hierarchy.recorded import Condition, Recorded, label_of
from bayestissue.inference.answers.contrasts import LEVELS, Comparison
from bayestissue.inference.answers.law import fall_height, simulated_words
from bayestissue.inference.answers.meaning import average_notes
from bayestissue.inference.answers.questions import ranked
from bayestissue.inference.answers.settings import SETTINGS
from bayestissue.inference.checking.findings import ELEMENT_ALONE
from bayestissue.inference.results.labels import element_attributes
from bayestissue.inference.results.meanings import REFERENCE_OUTCOMES, UNITS, element_alone
from bayestissue.results.tables import columns_of, table_of_rows, typed

IN, OUT = "in", "out"
_ENDS = [5.0, 50.0, 95.0]


def levels_table(comparison: Comparison) -> pd.DataFrame:
    """Each response and outcome on each level of a factor, with its rank: ``levels.csv``.

    ``p_lowest`` is the probability that the level has the lowest value of all, as of
    ``best(pad, lowest peak_force)``, ``p_highest`` the highest, levels that are equal in a draw sharing it.
    Rank 1 is the lowest; ``above_lowest`` is the mean distance from the lowest.
    """
    draws, recorded, in_outcomes = comparison.draws, comparison.recorded, comparison.in_outcomes
    tables = []
    for factor, levels in comparison.factors.items():
        if len(levels) > SETTINGS.in_pairs:
            continue
        at = {"factor": factor, "level": [label_of(level[factor]) for level in levels]}
        note = "; ".join(average_notes(recorded, comparison.responses, [factor]))
        for response, compared in comparison.of_responses.items():
            if any(factor == one.factors[0] for one in compared if one.kind == LEVELS):
                values = np.exp(log_at_levels(draws, recorded, response, levels)).reshape(-1, len(levels))
                alone = [ELEMENT_ALONE] if response == "K" and element_alone(draws) else []
                tables.append(_ranked_rows(at, response, values, [*filter(None, [note]), *alone]))
        rows = in_outcomes.rows_of(levels) if in_outcomes is not None else []
        if in_outcomes is None or comparison.law is None or not rows:
            continue
        conditions = [in_outcomes.conditions[row] for row in rows]
        motion = comparison.law.motion(recorded, conditions)
        notes = [*filter(None, [note, simulated_words(in_outcomes.outcomes, draws)])]
        tables += [
            _ranked_rows(at | motion, name, values[:, rows], notes)
            for name, values in in_outcomes.outcomes.items()
        ]
    return _whole("levels", tables)


def _ranked_rows(
    at: Mapping[str, Any], quantity: str, values: Float[np.ndarray, "draw level"], notes: Sequence[str]
) -> pd.DataFrame:
    by_level = xr.DataArray(values.T, dims=("level", "draw"))
    lowest, rank, above = ranked(by_level, lowest=True)
    highest, _, _ = ranked(by_level, lowest=False)
    return pd.DataFrame(
        {
            **at,
            "quantity": quantity,
            "unit": UNITS.get(quantity) or element_attributes()[quantity]["unit"],
            **dict(zip(("low", "median", "high"), np.percentile(values, _ENDS, axis=0), strict=True)),
            **dict(
                zip(
                    ("rank_low", "rank", "rank_high"),
                    np.percentile(rank.to_numpy(), _ENDS, axis=1),
                    strict=True,
                )
            ),
            "p_lowest": lowest.mean("draw").to_numpy(),
            "p_highest": highest.mean("draw").to_numpy(),
            "above_lowest": above.mean("draw").to_numpy(),
            "draws": len(values),
            "note": "; ".join(notes),
        }
    )


def _whole(name: str, parts: Sequence[pd.DataFrame]) -> pd.DataFrame:
    """The table ``name`` of parts that may lack columns."""
    table = pd.concat(parts, ignore_index=True) if parts else table_of_rows(name)
    return typed(name, table.reindex(columns=columns_of(name)))


def pictured(comparison: Comparison) -> dict[str, list[Condition]]:
    """The levels whose impacts are drawn, by factor; a typical person, under an empty name, where none is."""
    few = {
        name: levels for name, levels in comparison.factors.items() if len(levels) <= SETTINGS.pictured_levels
    }
    return few or {"": [{}]}


def measured_motions(recorded: Recorded) -> list[dict[str, float]]:
    """Mass [kg] and velocity [m/s] of few of the conditions that were measured, the least energy first."""
    rows = recorded.rows[["mass_kg", "velocity_m_s"]].astype(float)
    known = (rows > 0).all(axis=1).to_numpy()
    means = rows[known].groupby(recorded.labels("trial")[known]).mean()
    cells = means.transform(np.log).div(SETTINGS.same_motion).round()
    means = means[~cells.duplicated()]
    means = means.iloc[np.argsort(means["mass_kg"] * means["velocity_m_s"] ** 2, kind="stable")]
    chosen = np.linspace(0, len(means) - 1, min(len(means), SETTINGS.motions)).round().astype(int)
    mass, velocity = (means[name].to_numpy()[np.unique(chosen)] for name in means)
    return [{"mass_kg": float(m), "velocity_m_s": float(v)} for m, v in zip(mass, velocity, strict=True)]


def loops_table(comparison: Comparison) -> pd.DataFrame:
    """Force over depth on each pictured level, at the motions that were measured: ``loops.csv``."""
    law, recorded, tables = comparison.law, comparison.recorded, []
    motions = measured_motions(recorded)
    if law is None or not motions:
        return _whole("loops", [])
    for factor, levels in pictured(comparison).items():
        conditions: list[Condition] = [{**level, **motion} for motion, level in product(motions, levels)]
        loops = law.loops(comparison.draws, recorded, conditions, _step(comparison.draws, len(conditions)))
        for row, condition in enumerate(conditions):
            at: dict[str, Any] = _labels(factor, condition) | {name: condition[name] for name in motions[0]}
            at["draws"] = len(loops["depth_in"])
            of_one = {name: values[:, row] for name, values in loops.items()}
            tables += [_median_way(of_one, branch).assign(**at) for branch in (IN, OUT)]
    return _whole("loops", tables)


def _labels(factor: str, condition: Condition) -> dict[str, str]:
    return {"factor": factor, "level": label_of(condition[factor]) if factor else ""}


def _step(draws: xr.Dataset, conditions: int) -> int:
    """One draw of so many is pictured."""
    count = draws.sizes["chain"] * draws.sizes["draw"]
    least, most = SETTINGS.pictured
    wanted = min(max(least, SETTINGS.together // conditions), most)
    return max(1, count // wanted)


def _median_way(loops: Mapping[str, Float[np.ndarray, "draw place"]], branch: str) -> pd.DataFrame:
    """The medians of depth and force at even shares of the time in or out, where most draws have them."""
    medians: dict[str, Any] = {"branch": branch}
    for part, column in (("depth", "depth_m"), ("force", "force_N")):
        values = loops[f"{part}_{branch}"]
        known = np.isfinite(values).mean(axis=0) >= SETTINGS.reached
        medians[column] = np.where(known, np.median(np.where(known, values, 0.0), axis=0), np.nan)
    return pd.DataFrame(medians).dropna(subset="depth_m")


def curves_table(comparison: Comparison) -> pd.DataFrame:
    """Outcomes over the velocity at contact on each pictured level of a factor: ``curves.csv``.

    At each mass that was measured, of few; ``beyond`` is 1 at velocities that were not.
    """
    law, recorded, tables = comparison.law, comparison.recorded, []
    rows = recorded.rows[["mass_kg", "velocity_m_s"]].astype(float)
    rows = rows[(rows > 0).all(axis=1)]
    mass_group = (np.log(rows["mass_kg"]) / SETTINGS.same_motion).round()
    masses = rows["mass_kg"].groupby(mass_group).mean().to_numpy()
    if law is None or not 0 < len(masses) <= SETTINGS.motions:
        return _whole("curves", [])
    least, most = float(rows["velocity_m_s"].min()), float(rows["velocity_m_s"].max())
    inside = np.geomspace(least, most, SETTINGS.pictured_velocities - 2)
    velocities = np.unique([SETTINGS.beyond[0] * least, *inside, SETTINGS.beyond[1] * most])
    for factor, levels in pictured(comparison).items():
        if not factor:
            continue
        conditions: list[Condition] = [
            {**level, "mass_kg": float(mass), "velocity_m_s": float(velocity)}
            for level, mass, velocity in product(levels, masses, velocities)
        ]
        step = _step(comparison.draws, len(conditions))
        values = law.all_at_levels(comparison.draws, recorded, conditions, step)
        V = np.array([condition["velocity_m_s"] for condition in conditions], float)
        at = pd.DataFrame([_labels(factor, condition) for condition in conditions]).assign(
            mass_kg=[condition["mass_kg"] for condition in conditions],
            velocity_m_s=V,
            drop_height_cm=fall_height(V) if law.gravity else np.nan,
            beyond=((least * (1 - SETTINGS.rounding) > V) | (most * (1 + SETTINGS.rounding) < V)).astype(int),
        )
        for name in REFERENCE_OUTCOMES:
            ends = dict(
                zip(("low", "median", "high"), np.percentile(values[name], _ENDS, axis=0), strict=True)
            )
            unit = element_attributes()[name]["unit"]
            tables.append(at.assign(quantity=name, unit=unit, draws=len(values[name]), **ends))
    return _whole("curves", tables)
