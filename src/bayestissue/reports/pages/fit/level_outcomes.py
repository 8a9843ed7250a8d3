"""What impacts do on the levels that a formula compares: which is best, ranks, loops and curves."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
from markupsafe import Markup

from bayestissue.base.impact_arrays import evenly_spaced
from bayestissue.base.outcome_table import DECLARED
from bayestissue.inference.answers.law import fall_height
from bayestissue.inference.results.meanings import UNITS, outcome_name
from bayestissue.reports.figures import force_curves as drawn
from bayestissue.reports.figures.intervals import intervals
from bayestissue.reports.figures.theme import Figure, number
from bayestissue.reports.pages.fit.answers import person_words
from bayestissue.reports.pages.fit.fit_run import FitRun
from bayestissue.reports.pages.fit.study_answers import FIRST_OUTCOME as FIRST
from bayestissue.reports.pages.fit.study_answers import leading_levels
from bayestissue.reports.pages.page_settings import LIMITS
from bayestissue.reports.pages.page_tables import Field, over, table_of
from bayestissue.reports.pages.posterior import QUANTITIES
from bayestissue.reports.pages.wording import Spread, probability, said


def factors(run: FitRun) -> list[str]:
    """The columns whose levels are compared, those first that the formula has first."""
    return list(dict.fromkeys(run.levels["factor"]))


def compared_levels(run: FitRun) -> list[dict[str, Any]]:
    """Of the first factors: which level is best, and a table of all; nothing where none is compared."""
    compared = [_compared(run, factor) for factor in factors(run)[: LIMITS.comparisons]]
    # Beside a discrepancy K is the element's own, and may be all that differs.
    return [one for one in compared if len(one["table"].columns) > 1]


def _compared(run: FitRun, factor: str) -> dict[str, Any]:
    rows = run.levels[run.levels["factor"] == factor]
    by = {(row["quantity"], row["level"]): row for row in rows.to_dict("records")}
    known = set(rows["quantity"])
    fields = [Field(factor, lambda level: level)]
    if FIRST in known:
        fields.append(Field("P(best)", lambda level: probability(by[FIRST, level]["p_lowest"]), "number"))
    fields += [
        Field(quantity_title(q), partial(_cell, by, q), "number")
        for q in (FIRST, *(q for q in QUANTITIES if q in run.of_tissue))
        if q in known
    ]
    levels = table_of(leading_levels(run)[factor], *fields)
    return {"factor": factor, "best": _best(rows[rows["quantity"] == FIRST]), "table": levels}


def _cell(by: dict[tuple[str, str], dict[Any, Any]], quantity: str, level: str) -> Markup:
    """A median over its interval."""
    shown = Spread.of(by[quantity, level])
    return over(shown.value, shown.range)


def _best(outcome: pd.DataFrame) -> dict[Any, Any]:
    """The row of the level of the least force, and ``others``: the next and the last; empty without rows."""
    if outcome.empty:
        return {}
    first, *others = outcome.sort_values("p_lowest", ascending=False, kind="stable").to_dict("records")
    ordered = sorted(others, key=lambda row: row["median"])
    ends = [ordered[0], ordered[-1]] if len(ordered) > 1 else ordered
    return first | {"spread": Spread.of(first), "others": ends}


def quantity_title(quantity: str) -> str:
    """Name and unit, as of an axis: "peak force (N)"."""
    name, unit, _ = scaled(quantity)
    return name if unit == "1" else f"{name} ({unit})"


_RANKS = ["rank_low", "rank_high"]


def ranks(run: FitRun, factor: str, quantity: str = FIRST) -> Figure:
    """A quantity on each level of a factor, the lowest first, with its rank."""
    rows = run.levels[(run.levels["factor"] == factor) & (run.levels["quantity"] == quantity)]
    title, _, scale = scaled(quantity)
    rows = rows.sort_values("median", ignore_index=True)
    ranks = [" to ".join(dict.fromkeys(map("{:.0f}".format, ends))) for ends in rows[_RANKS].to_numpy()]
    table = pd.DataFrame(
        {"label": [f"{level}, rank {rank}" for level, rank in zip(rows["level"], ranks, strict=True)]}
    )
    table[["median", "eti90_low", "eti90_high"]] = scale * rows[["median", "low", "high"]].to_numpy(float)
    table["rank"] = ranks
    words = said("figures.ranks", name=title, factor=factor)
    return intervals(table, quantity_title(quantity), words, straight=True)


def scaled(quantity: str) -> tuple[str, str, float]:
    """Name, unit, and how many of it per SI unit."""
    if quantity in UNITS:
        return quantity, UNITS[quantity], 1.0
    _, unit, factor = DECLARED[quantity].shown
    return outcome_name(quantity), unit, factor


def loops(run: FitRun, factor: str = "") -> Figure:
    """Force over depth on each level of a factor, at motions that were measured, over what was recorded."""
    rows = run.loops[run.loops["factor"] == factor]
    motions = rows[["mass_kg", "velocity_m_s"]].drop_duplicates()
    titles = {pair: _motion(run, *pair) for pair in motions.itertuples(index=False, name=None)}
    table = rows.assign(
        panel=[titles[pair] for pair in zip(rows["mass_kg"], rows["velocity_m_s"], strict=True)],
        level=rows["level"].replace("", person_words(run)["typical"]),
        depth_mm=1e3 * rows["depth_m"],
    )[["panel", "level", "branch", "depth_mm", "force_N"]].reset_index(drop=True)
    words = said("figures.loops", of=f"each {factor}" if factor else f"a {person_words(run)['typical']}")
    return drawn.loops(table, _recorded(run, factor, titles), words)


def _motion(run: FitRun, mass: float, velocity: float) -> str:
    """A motion in words: "5 kg at 1.53 m/s (12 cm)"."""
    fallen = f" ({fall_height(velocity):.3g} cm)" if run.gravity else ""
    return f"{mass:.3g} kg at {velocity:.3g} m/s{fallen}"


def _recorded(run: FitRun, factor: str, titles: dict[tuple[float, float], str]) -> pd.DataFrame:
    """Recorded force M F/M over depth of impacts that have one of the motions; of many evenly spaced ones."""
    columns = ["panel", "level", "impact", "order", "depth_mm", "force_N"]
    table = run.impacts_table
    if run.shown != "deceleration" or (factor and factor not in table):
        return pd.DataFrame(columns=columns)
    hits = np.log(table[["mass_kg", "velocity_m_s"]].to_numpy(float))
    distance = np.abs(hits[:, None] - np.log(np.array(list(titles)))).max(axis=-1)
    # Of many impacts some have their recordings here.
    matching = np.flatnonzero(distance.min(axis=1)[run.predicted] < LIMITS.same_motion)
    matching = matching[evenly_spaced(len(matching), LIMITS.loops)] if len(matching) else matching
    names, observed, parts = list(titles.values()), run.groups["observed_data"], []
    for index, row in zip(matching, run.predicted[matching], strict=True):
        depth, force = (observed[name].to_numpy()[index] for name in ("displacement", "deceleration"))
        known = np.flatnonzero(np.isfinite(depth) & np.isfinite(force))
        known = known[evenly_spaced(len(known), LIMITS.loop_samples)]
        one = {
            "panel": names[int(distance[row].argmin())],
            "level": str(table[factor].iloc[row]) if factor else person_words(run)["typical"],
            "impact": run.impacts[row],
            "order": np.arange(len(known)),
            "depth_mm": 1e3 * depth[known],
            "force_N": table["mass_kg"].iloc[row] * force[known],
        }
        parts.append(pd.DataFrame(one, columns=columns))
    return pd.concat(parts, ignore_index=True) if parts else pd.DataFrame(columns=columns)


def curves(run: FitRun, factor: str, quantity: str = FIRST) -> Figure:
    """An outcome over the height of the fall, or the velocity, on each level, and of each impact."""
    title, _, scale = scaled(quantity)
    rows = run.curves[(run.curves["factor"] == factor) & (run.curves["quantity"] == quantity)]
    column = "drop_height_cm" if run.gravity else "velocity_m_s"
    x = number(column, "height of the fall (cm)" if run.gravity else "velocity at contact (m/s)")
    masses = np.array(sorted(rows["mass_kg"].unique()))
    panels = [f"{mass:.3g} kg" for mass in masses]
    impacts = _measured(run, factor, quantity)
    nearest = np.abs(np.log(impacts["mass_kg"].to_numpy()[:, None] / masses)).argmin(axis=1)
    ends = ["median", "low", "high"]
    table = rows.assign(panel=[f"{mass:.3g} kg" for mass in rows["mass_kg"]]).reset_index(drop=True)
    table = table[["panel", "level", column, *ends, "beyond"]].astype({column: float})
    points = impacts.assign(
        panel=[panels[at] for at in nearest], drop_height_cm=fall_height(impacts["velocity_m_s"].to_numpy())
    )[["panel", "level", "impact", column, *ends]]
    for shown in (table, points):
        shown[ends] *= scale
    words = said("figures.curves", name=title, over=x["title"], factor=factor)
    return drawn.over_velocity(table, points, x, quantity_title(quantity), panels, words)


def _measured(run: FitRun, factor: str, quantity: str) -> pd.DataFrame:
    """An outcome of each impact, some of very many, with its level; none where a run has no such column."""
    columns = {"median": "median", "eti90_low": "low", "eti90_high": "high"}
    table, values = run.impacts_table, run.of_impacts(quantity)
    if values.empty or factor not in table:
        return pd.DataFrame(columns=["level", "impact", "mass_kg", "velocity_m_s", *columns.values()])
    shown = evenly_spaced(len(table), LIMITS.impacts_drawn)
    rows = table[["impact", "mass_kg", "velocity_m_s"]].assign(level=table[factor].astype(str))
    ends = values[list(columns)].rename(columns=columns).reset_index(drop=True)
    return rows.join(ends).iloc[shown].reset_index(drop=True)


def has_outcomes(run: FitRun) -> bool:
    """Whether the run has pictures of what impacts do."""
    of_levels = bool((run.levels["quantity"] == FIRST).any())
    return not run.undescribed and (of_levels or len(run.loops) > 0)


def loop_figures(run: FitRun) -> list[Figure]:
    """Force over depth, of each factor that is pictured."""
    return [loops(run, str(factor)) for factor in dict.fromkeys(run.loops["factor"])]


def level_figures(run: FitRun) -> dict[str, list[Figure]]:
    """By factor: peak force over height or velocity, and ranks."""
    by_factor: dict[str, list[Figure]] = {}
    for name, make in _of_levels(run):
        by_factor.setdefault(name.rpartition("-by-")[2], []).append(make())
    return by_factor


def _of_levels(run: FitRun) -> Iterator[tuple[str, Callable[[], Figure]]]:
    of_curves = set(run.curves["factor"])
    for factor in factors(run):
        quantities = set(run.levels.loc[run.levels["factor"] == factor, "quantity"])
        if factor in of_curves:
            yield f"{FIRST}-curves-by-{factor}", partial(curves, run, factor)
        for q in (FIRST, "K"):
            if q in quantities and (q != "K" or "K" in run.of_tissue):
                yield f"{q}-ranks-by-{factor}", partial(ranks, run, factor, q)


def published(run: FitRun) -> Iterator[tuple[str, Callable[[], Figure]]]:
    """The figures that serve a paper, by names fit for a file."""
    for factor in dict.fromkeys(run.loops["factor"]):
        yield f"force-over-depth{f'-by-{factor}' if factor else ''}", partial(loops, run, str(factor))
    yield from _of_levels(run)


def simulated_draws(run: FitRun) -> list[str]:
    """In how many draws the impacts of the figures were simulated."""
    return [str(one) for one in sorted({int(n) for table in (run.loops, run.curves) for n in table["draws"]})]
