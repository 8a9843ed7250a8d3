"""A plan in words: the answer in a sentence, and the paragraph of a grant application or preregistration."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pandas as pd

from bayestissue.reports.pages.page import worded
from bayestissue.reports.pages.wording import (
    SENTENCES,
    half_width,
    listed,
    nouns_of_plan,
    percent,
    with_error,
)
from bayestissue.studies.planning.plan_settings import PLAN as SETTINGS

Content = Mapping[str, Any]


def answer(content: Content) -> str:
    """The cheapest design that answers; where none does, the best one, and whether many people would.

    Args:
        content: of ``plan.json``.
    """
    gains = _gains(content).sort_values(["gain", "words"], ascending=False)
    gaining = gains.loc[gains["shows"] & (gains["limit"] != "people"), "words"].drop_duplicates().tolist()
    return worded("plan", "answer", content, _held_open(content), gaining)


def _held_open(content: Content) -> list[dict[str, str]]:
    """The group terms that hold an answer open however many people there are, each with what it is of."""
    held = {one["term"]: one for terms in content["held_open"].values() for one in terms}
    kinds = {term: "conditions" if x["of"] == "trial" else f"levels of {x['of']}" for term, x in held.items()}
    return [
        {"term": term, "of": kind, "which": f"the effects {term} of its {held[term]['levels']} {kind}"}
        for term, kind in kinds.items()
    ]


def _gains(content: Content) -> pd.DataFrame:
    """A row a limit and goal: what is gained, the most first, and whether it ``shows`` apart from chance."""
    rows = [
        {"limit": key, "words": limit["words"], "goal": name, "gain": goal["gain"], "se": goal["gain_se"]}
        for key, limit in content["limits"].items()
        for name, goal in limit["goals"].items()
    ]
    table = pd.DataFrame(rows).sort_values("gain", ascending=False, kind="stable")
    return table.assign(shows=table["gain"] > SETTINGS.shows * table["se"])


def paragraph(content: Content) -> str:
    """The sample size and its reason, for those who judge the study.

    Args:
        content: of ``plan.json``.
    """
    plan = content["plan"]
    model = next(
        analysis["model"] for analysis in content["analyses"] if content["chosen"] in analysis["designs"]
    )
    lost = [
        f"{percent(plan['candidates'][key])} of the {what}"
        for key, what in (("lost", "impacts"), ("lost_people", "people"))
        if plan["candidates"].get(key)
    ]
    numbers = plan.get("precision", {}).values()
    asked = [f"whether {text}" for text in plan["questions"].values()]
    asked += [f"for {one['of']} to ± {half_width(one)} (half of the 90 % interval)" for one in numbers]
    return worded("plan", "paragraph", content, model, lost, asked)


def in_own_words(content: Content) -> dict[str, Any]:
    """The content of ``plan.json`` whose sentences have the study's own nouns, such as pad for person."""
    nouns = nouns_of_plan(content)
    texts = {name: nouns(content[name]) for name in ("answer", "paragraph")}
    limits = {key: {**limit, "words": nouns(limit["words"])} for key, limit in content["limits"].items()}
    return {**content, **texts, "limits": limits, "limiting": [nouns(text) for text in content["limiting"]]}


def limit_words(key: str) -> str:
    """What is changed to see whether it limits the answer."""
    return SENTENCES["plan_limits"].get(key, f"no differences of {key.replace('_', ' ')}")


def what_limits(content: Content) -> list[str]:
    """Of each goal, what would make more studies answer and what would not, in a sentence."""
    sentences, goals, gains = [], list(content["designs"][content["chosen"] - 1]["goals"]), _gains(content)
    for name in goals:
        of_goal = gains[gains["goal"] == name]
        gained = [
            f"{limit.words} (answers {with_error(limit.gain, limit.se)} more often)"
            for limit in of_goal[of_goal["shows"]].itertuples()
        ]
        others = of_goal.loc[~of_goal["shows"], "words"].tolist()
        which = f"{name.replace('_', ' ')}: " if len(goals) > 1 else ""
        parts = [f"most would be gained by {', then by '.join(gained)}"] if gained else []
        parts += [f"nothing that shows by {listed(others)}"] if others else []
        sentences.append(f"{which}{'; '.join(parts)}.")
    return [sentence[0].upper() + sentence[1:] for sentence in sentences]
