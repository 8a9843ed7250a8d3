"""The page of a plan: the cheapest design that answers, and what any other would do."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from markupsafe import Markup

from bayestissue.base.outline import numbers_in_short
from bayestissue.base.remedies import codes_in
from bayestissue.base.results.tables import read_table
from bayestissue.reports.figures import study_comparisons
from bayestissue.reports.figures.theme import Figure
from bayestissue.reports.figures.theme import number as channel
from bayestissue.reports.pages.page import render_page
from bayestissue.reports.pages.page_settings import LIMITS
from bayestissue.reports.pages.page_tables import (
    Field,
    Table,
    declared_fields,
    settings_table,
    shown,
    table_of,
)
from bayestissue.reports.pages.run_folder import read_json, require_files
from bayestissue.reports.pages.wording import SENTENCES, nouns_of_plan, said, with_error

# In what designs differ.
_AXES = ("people", "masses_kg", "velocities_m_s", "conditions", "repeats", "recorder")


def plan_page(folder: Path, record: dict[str, Any]) -> str:
    """The HTML of the page of the plan in ``folder``, whose ``run.json`` holds ``record``.

    Raises:
        InputError: `plan.json` or `designs.csv` lacks or can't be read.
    """
    require_files(folder, ["plan.json"])
    return page_of(read_json(folder / "plan.json"), read_table(folder, "designs"), record)


def page_of(content: Mapping[str, Any], designs: pd.DataFrame, record: Mapping[str, Any]) -> str:
    """The HTML of a plan: content of ``plan.json``, ``designs.csv``, content of ``run.json``."""
    plan, chosen = content["plan"], content["designs"][content["chosen"] - 1]
    wanted = plan["goal"]["assurance"]
    goals = list(chosen["goals"])
    return render_page(
        "plan.html",
        nouns=nouns_of_plan(content),
        codes=codes_in(content["warning"]),
        record=record,
        plan=plan,
        content=content,
        chosen=chosen,
        designs=designs,
        curves=[curves(designs, name, wanted) for name in goals],
        grids=[grid for name in goals if (grid := people_and_repeats(designs, name, chosen, wanted))],
        limit_studies=next(iter(content["limits"]["people"]["goals"].values()))["studies"],
    )


def goal_name(goal: str) -> str:
    """A goal in words."""
    return goal.replace("_", " ")


def _share(goal: Mapping[str, Any], *, bold: bool) -> str:
    words = with_error(goal["answered"], goal["se"])
    return Markup("<strong>{}</strong>").format(words) if bold else words


def settings(plan: Mapping[str, Any], *keys: str) -> Table:
    """Tables of the plan, those that it has; recorders that are compared stand among the candidates."""
    compared = ["recording"] if plan["candidates"].get("recorders") else []
    tables = {key: plan[key] for key in keys if key in plan and key not in compared}
    return settings_table(tables)


def along(content: Mapping[str, Any], axis: str) -> Table:
    """The assurance of each goal by people or recorder, of designs that are the chosen one but for that."""
    chosen = content["designs"][content["chosen"] - 1]
    others = [name for name in _AXES if name != axis]
    rows = {
        design[axis]: design["goals"]
        for design in content["designs"]
        if all(design[name] == chosen[name] for name in others)
    }
    if axis == "people":
        for name in ("more people", "many people"):
            if variant := content["variants"].get(name):
                rows.setdefault(variant["people"], variant["goals"])

    def cell(value: Any, goal: str) -> str:
        return _share(rows[value][goal], bold=value == chosen[axis])

    goals = list(chosen["goals"])
    titles = {name: goal_name(name) if len(goals) > 1 else "answers" for name in goals}
    return table_of(
        sorted(rows) if axis == "people" else list(rows),
        Field(axis, str, "number" if axis == "people" else ""),
        *(Field(titles[name], partial(cell, goal=name), "number") for name in goals),
    )


def curves(designs: pd.DataFrame, goal: str, wanted: float) -> Figure:
    """The assurance over people, or over repeats where people do not vary, a line for each other design."""
    rows = designs[designs["goal"] == goal]
    over = "people" if rows["people"].nunique() >= rows["repeats"].nunique() else "repeats"
    others = [name for name in _AXES if name != over]
    lines = sorted(rows.groupby(others, sort=False), key=lambda group: -group[1]["answered"].mean())
    varying = [name for name in others if len(set(rows[name])) > 1]
    shown = pd.concat(
        [
            line[["design", over, "answered"]].assign(
                kind=_label(dict(zip(others, key, strict=True)), varying),
                low=line["answered"] - line["se"],
                high=line["answered"] + line["se"],
            )
            for key, line in lines[: LIMITS.lines]
        ],
        ignore_index=True,
    )
    values = sorted(float(value) for value in rows[over].unique())
    ends = pd.DataFrame({over: [values[0], values[-1]], "answered": wanted, "line": "wanted"})
    return study_comparisons.points(
        shown,
        channel(over, over, scale={"zero": False}, axis={"values": values}),
        channel("answered", f"assurance: {goal_name(goal)}", scale={"domain": [0, 1]}),
        said("figures.assurance", goal=goal_name(goal), over=over),
        lines=ends,
        joined=True,
    )


def _label(design: dict[str, Any], varying: Sequence[str]) -> str:
    """What tells a line from the others."""
    named = [name for name in varying if name != "conditions" or "masses_kg" not in varying]
    lists = {name: numbers_in_short(design[name].split()) for name in ("masses_kg", "velocities_m_s")}
    return ", ".join(SENTENCES["designs_apart"][name].format((design | lists)[name]) for name in named)


def people_and_repeats(
    designs: pd.DataFrame, goal: str, chosen: Mapping[str, Any], wanted: float
) -> Figure | None:
    """The assurance over people and repeats, where both vary, of designs that are else the chosen one."""
    others = [name for name in _AXES if name not in ("people", "repeats")]
    comparable = np.all([designs[name] == chosen[name] for name in others], axis=0)
    rows = designs[(designs["goal"] == goal) & comparable]
    if min(rows["people"].nunique(), rows["repeats"].nunique()) < 2:
        return None
    return study_comparisons.shares(
        rows[["people", "repeats", "answered"]].rename(columns={"answered": "share"}).reset_index(drop=True),
        "people",
        "repeats",
        said("figures.people_and_repeats", goal=goal_name(goal), wanted=wanted),
        wanted=wanted,
        chosen=(chosen["people"], chosen["repeats"]),
    )


def designs_table(designs: pd.DataFrame, chosen: int, wanted: float) -> Table:
    """A row for each design and goal; the chosen design is marked."""
    marks = {
        "design": Field(
            "design", lambda row: f"{row['design']:.0f}{' ◂' if row['design'] == chosen else ''}"
        ),
        "answered": Field("assurance", lambda row: _share(row, bold=row["answered"] >= wanted), "number"),
    }
    several = len(set(designs["goal"])) > 1
    return shown("designs", designs if several else designs.assign(goal=""), fields=marks)


def gains_table(content: Mapping[str, Any]) -> Table:
    """The chosen design with more or less of one thing, and what that adds to each goal's assurance."""
    chosen = content["designs"][content["chosen"] - 1]
    words = SENTENCES["plan_variants"]
    named = [
        (words[key].format(people=variant["people"], before=chosen["people"]), variant)
        for key, variant in content["variants"].items()
        if key in words
    ]
    named += [(limit["words"], limit) for limit in content["limits"].values()]
    several = len(chosen["goals"]) > 1
    rows = [
        {"with": change, "goal": name if several else "", **goal}
        for change, variant in named
        for name, goal in variant["goals"].items()
    ]
    return table_of(
        rows,
        Field("with", "words"),
        *declared_fields("designs", ("goal", "answered")),
        Field("more by", "± .2", of=["gain", "gain_se"]),
        *declared_fields("designs", ("undecided_bits", "width")),
    )


def power_table(content: Mapping[str, Any]) -> Table:
    """The chosen design's assurance beside its power where every belief is its median."""
    chosen = content["designs"][content["chosen"] - 1]["goals"]
    truth = content["variants"]["one truth"]["goals"]
    return table_of(
        [
            {"goal": name, **chosen[name], "power": goal["answered"], "power_se": goal["se"]}
            for name, goal in truth.items()
        ],
        *declared_fields("designs", ("goal", "answered")),
        Field("power at one truth", "± .2", of=["power", "power_se"]),
    )
