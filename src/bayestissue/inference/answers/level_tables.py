"""What impacts do on the levels of each factor that a formula compares: values and ranks, loops, curves.

A level is that of a typical person there, all else at the reference, as in a question such as
``peak_force[pad=A]``. Where nothing is compared, loops are those of a typical person.

A loop is force over depth: their medians at equal shares of the time to the greatest depth, and from there
until the impactor leaves.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from bayestissue.base.results.tables import columns_of, table_of_rows, typed
from bayestissue.inference.answers.contrasts import LEVELS, Contrasts
from bayestissue.inference.answers.integration import SETTINGS
from bayestissue.inference.answers.law import fall_height
from bayestissue.inference.answers.meaning import average_notes
from bayestissue.inference.answers.questions import ranked
from bayestissue.inference.answers.study import DRAWN, Study
from bayestissue.inference.checking.findings import ELEMENT_ALONE
from bayestissue.inference.results.labels import unit_of
from bayestissue.inference.samplers.sampling import interval
from bayestissue.mechanics.elements.outcomes import REFERENCE_OUTCOMES
from bayestissue.model.hierarchy.recorded import Condition, Recorded, label_of

IN, OUT = "in", "out"


def levels_table(contrasts: Contrasts) -> pd.DataFrame:
    """Each response and outcome on each level of a factor, with its rank: ``levels.csv``.

    ``p_lowest`` is the probability that the level has the lowest value of all, as of
    ``best(pad, lowest peak_force)``, ``p_highest`` the highest, levels that are equal in a draw sharing it.
    Rank 1 is the lowest; ``above_lowest`` is the mean distance from the lowest.
    """
    study, tables = contrasts.study, []
    for factor, levels in contrasts.factors.items():
        if len(levels) > SETTINGS.in_pairs:
            continue
        at: dict[str, Any] = {"factor": factor, "level": [label_of(level[factor]) for level in levels]}
        notes: list[str] = list(average_notes(study.recorded, study.recorded.formulas, [factor]))
        for response, compared in contrasts.of_responses.items():
            if any(factor == one.factors[0] for one in compared if one.kind == LEVELS):
                alone = [ELEMENT_ALONE] * (response == "K" and study.element_alone)
                values = study.at([response], levels)[response]
                tables.append(_ranked_rows(values, **at, note="; ".join([*notes, *alone])))
        if outcomes := contrasts.outcomes_at(levels):
            note = "; ".join(filter(None, [*notes, study.simulated_words(outcomes)]))
            motion = study.motion(levels)
            at |= {name: motion[name] for name in ("mass_kg", "velocity_m_s")}
            tables += [_ranked_rows(values, **at, note=note) for values in outcomes.values()]
    return _whole("levels", tables)


def _ranked_rows(values: xr.DataArray, **at: Any) -> pd.DataFrame:
    by_level = values.rename(condition="level").transpose("level", ...)
    lowest, rank, above = ranked(by_level, lowest=True)
    highest, _, _ = ranked(by_level, lowest=False)
    return pd.DataFrame(
        {
            **at,
            "quantity": values.name,
            "unit": unit_of(str(values.name)),
            **interval(values),
            **interval(rank, "rank"),
            "p_lowest": lowest.mean(DRAWN).to_numpy(),
            "p_highest": highest.mean(DRAWN).to_numpy(),
            "above_lowest": above.mean(DRAWN).to_numpy(),
            "draws": values.sizes["chain"] * values.sizes["draw"],
        }
    )


def _whole(name: str, parts: Sequence[pd.DataFrame]) -> pd.DataFrame:
    """The table ``name`` of parts that may lack columns."""
    table = pd.concat(parts, ignore_index=True) if parts else table_of_rows(name)
    return typed(name, table.reindex(columns=columns_of(name)))


def pictured(contrasts: Contrasts) -> dict[str, list[Condition]]:
    """The levels whose impacts are drawn, by factor; a typical person, under an empty name, where none is."""
    few = {
        name: levels for name, levels in contrasts.factors.items() if len(levels) <= SETTINGS.pictured_levels
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


def loops_table(contrasts: Contrasts) -> pd.DataFrame:
    """Force over depth on each pictured level, at the motions that were measured: ``loops.csv``."""
    study, tables = contrasts.study, []
    motions = measured_motions(study.recorded)
    if not (study.law.everywhere and motions):
        return _whole("loops", [])
    for factor, levels in pictured(contrasts).items():
        conditions: list[Condition] = [{**level, **motion} for motion, level in product(motions, levels)]
        loops = study.loops(conditions, _step(study, len(conditions)))
        for row, condition in enumerate(conditions):
            at: dict[str, Any] = _labels(factor, condition) | {name: condition[name] for name in motions[0]}
            at["draws"] = loops.sizes["chain"] * loops.sizes["draw"]
            tables += [_median_way(loops.isel(condition=row), branch).assign(**at) for branch in (IN, OUT)]
    return _whole("loops", tables)


def _labels(factor: str, condition: Condition) -> dict[str, str]:
    return {"factor": factor, "level": label_of(condition[factor]) if factor else ""}


def _step(study: Study, conditions: int) -> int:
    """One draw of so many is pictured."""
    least, most = SETTINGS.pictured
    wanted = min(max(least, SETTINGS.together // conditions), most)
    return max(1, study.count // wanted)


def _median_way(loops: xr.Dataset, branch: str) -> pd.DataFrame:
    """The medians of depth and force at even shares of the time in or out, where most draws have them."""
    medians: dict[str, Any] = {"branch": branch}
    for part, column in (("depth", "depth_m"), ("force", "force_N")):
        values = loops[f"{part}_{branch}"]
        known = xr.apply_ufunc(np.isfinite, values).mean(DRAWN) >= SETTINGS.reached
        medians[column] = values.where(known, 0.0).median(DRAWN, skipna=False).where(known).to_numpy()
    return pd.DataFrame(medians).dropna(subset="depth_m")


def curves_table(contrasts: Contrasts) -> pd.DataFrame:
    """Outcomes over the velocity at contact on each pictured level of a factor: ``curves.csv``.

    At each mass that was measured, of few; ``beyond`` is 1 at velocities that were not.
    """
    study, tables = contrasts.study, []
    rows = study.recorded.rows[["mass_kg", "velocity_m_s"]].astype(float)
    rows = rows[(rows > 0).all(axis=1)]
    mass_group = (np.log(rows["mass_kg"]) / SETTINGS.same_motion).round()
    masses = rows["mass_kg"].groupby(mass_group).mean().to_numpy()
    if not (study.law.everywhere and 0 < len(masses) <= SETTINGS.motions):
        return _whole("curves", [])
    least, most = float(rows["velocity_m_s"].min()), float(rows["velocity_m_s"].max())
    inside = np.geomspace(least, most, SETTINGS.pictured_velocities - 2)
    velocities = np.unique([SETTINGS.beyond[0] * least, *inside, SETTINGS.beyond[1] * most])
    for factor, levels in pictured(contrasts).items():
        if not factor:
            continue
        conditions: list[Condition] = [
            {**level, "mass_kg": float(mass), "velocity_m_s": float(velocity)}
            for level, mass, velocity in product(levels, masses, velocities)
        ]
        outcomes = study.at(REFERENCE_OUTCOMES, conditions, step=_step(study, len(conditions)))
        V = np.array([condition["velocity_m_s"] for condition in conditions], float)
        at = pd.DataFrame([_labels(factor, condition) for condition in conditions]).assign(
            mass_kg=[condition["mass_kg"] for condition in conditions],
            velocity_m_s=V,
            drop_height_cm=fall_height(V) if study.law.gravity else np.nan,
            beyond=((least * (1 - SETTINGS.rounding) > V) | (most * (1 + SETTINGS.rounding) < V)).astype(int),
            draws=outcomes.sizes["chain"] * outcomes.sizes["draw"],
        )
        tables += [
            at.assign(quantity=str(name), unit=unit_of(str(name)), **interval(values))
            for name, values in outcomes.items()
        ]
    return _whole("curves", tables)
