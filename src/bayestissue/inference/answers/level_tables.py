"""What impacts do on the levels of each factor that a formula compares: values and ranks, loops, curves.

A level is that of a typical person there, all else at the reference, as in a question such as
``peak_force[pad=A]``. Where nothing is compared, loops are those of a typical person.

A loop is force over depth: their medians at equal shares of the time to the greatest depth, and from there
until the impactor leaves.
"""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from bayestissue.base.outcome_table import REFERENCE_OUTCOMES
from bayestissue.base.results.tables import joined, typed
from bayestissue.inference.answers.contrasts import LEVELS, Contrasts
from bayestissue.inference.answers.integration import SETTINGS
from bayestissue.inference.answers.law import fall_height
from bayestissue.inference.answers.meaning import average_notes
from bayestissue.inference.answers.questions import ranked
from bayestissue.inference.answers.study import DRAWN, Study
from bayestissue.inference.checking.findings import ELEMENT_ALONE
from bayestissue.inference.results.labels import unit_of
from bayestissue.inference.samplers.sampling import interval
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
    return typed("levels", joined("levels", tables))


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


def pictured(contrasts: Contrasts) -> dict[str, list[Condition]]:
    """The levels whose impacts are drawn, by factor."""
    factors = contrasts.factors.items()
    return {name: levels for name, levels in factors if len(levels) <= SETTINGS.pictured_levels}


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
        return typed("loops", joined("loops", []))
    # A typical person, under an empty name, where nothing is compared.
    for factor, levels in (pictured(contrasts) or {"": [{}]}).items():
        pairs = list(product(motions, levels))
        loops = study.loops([{**level, **motion} for motion, level in pairs], _step(study, len(pairs)))
        known = xr.apply_ufunc(np.isfinite, loops).mean(DRAWN) >= SETTINGS.reached
        medians = loops.where(known, 0.0).median(DRAWN, skipna=False).where(known)
        draws = loops.sizes["chain"] * loops.sizes["draw"]
        for (row, (motion, level)), branch in product(enumerate(pairs), (IN, OUT)):
            way = medians.isel(condition=row)
            at = {
                "factor": factor,
                "level": label_of(level.get(factor, "")),
                "branch": branch,
                "draws": draws,
            }
            columns = {"depth_m": way[f"depth_{branch}"], "force_N": way[f"force_{branch}"]}
            tables.append(pd.DataFrame({**at, **motion, **columns}).dropna(subset="depth_m"))
    return typed("loops", joined("loops", tables))


def _step(study: Study, conditions: int) -> int:
    """One draw of so many is pictured."""
    least, most = SETTINGS.pictured
    wanted = min(max(least, SETTINGS.together // conditions), most)
    return max(1, study.count // wanted)


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
        return typed("curves", joined("curves", []))
    least, most = float(rows["velocity_m_s"].min()), float(rows["velocity_m_s"].max())
    inside = np.geomspace(least, most, SETTINGS.pictured_velocities - 2)
    velocities = np.unique([SETTINGS.beyond[0] * least, *inside, SETTINGS.beyond[1] * most])
    low, high = least * (1 - SETTINGS.rounding), most * (1 + SETTINGS.rounding)
    for factor, levels in pictured(contrasts).items():
        conditions: list[Condition] = [
            {**level, "mass_kg": float(mass), "velocity_m_s": float(velocity)}
            for level, mass, velocity in product(levels, masses, velocities)
        ]
        outcomes = study.at(REFERENCE_OUTCOMES, conditions, step=_step(study, len(conditions)))
        at = pd.DataFrame(conditions)
        V = at["velocity_m_s"].to_numpy(float)
        at = at.assign(
            factor=factor,
            level=[label_of(condition[factor]) for condition in conditions],
            drop_height_cm=fall_height(V) if study.law.gravity else np.nan,
            beyond=((low > V) | (high < V)).astype(int),
            draws=outcomes.sizes["chain"] * outcomes.sizes["draw"],
        )
        tables += [
            at.assign(quantity=str(name), unit=unit_of(str(name)), **interval(values))
            for name, values in outcomes.items()
        ]
    return typed("curves", joined("curves", tables))
