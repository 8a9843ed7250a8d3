"""A plan in words: the answer in a sentence, and the paragraph of a grant application or preregistration."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from bayestissue.base.errors import Coded
from bayestissue.reports.pages.page import worded
from bayestissue.reports.pages.wording import half_width, listed, nouns_of_plan, percent, with_error
from bayestissue.studies.planning.plan_settings import PLAN as SETTINGS

Content = Mapping[str, Any]
# What may limit the answer, by its key in plan.json: the chosen design with that much more or less of it. Any
# other key is of a group of levels, such as subject_side.
LIMITS = {
    "people": "twice the people",
    "impacts": "twice the impacts of each person",
    "trial": "conditions that differ in mass and velocity alone",
    "noise": "a recorder with a tenth of the noise",
    "chain": "a chain whose mass, velocity, gain and zero are known exactly",
}


def answer(content: Content) -> str:
    """The cheapest design that answers; where none does, the best one, and whether many people would.

    Args:
        content: of ``plan.json``.
    """
    return worded("plan", "answer", content, _held_open(content), _gaining(content))


def _held_open(content: Content) -> list[dict[str, str]]:
    """The group terms that hold an answer open however many people there are, each with what it is of."""
    held = {one["term"]: one for terms in content["held_open"].values() for one in terms}
    kinds = {term: "conditions" if x["of"] == "trial" else f"levels of {x['of']}" for term, x in held.items()}
    return [
        {"term": term, "of": kind, "which": f"the effects {term} of its {held[term]['levels']} {kind}"}
        for term, kind in kinds.items()
    ]


def _gaining(content: Content) -> list[str]:
    """What would make more studies answer some goal, apart from chance, the most first."""
    limits = [
        (limit["goals"][name]["gain"], limit["words"])
        for key, limit in content["limits"].items()
        for name in limit["goals"]
        if key != "people" and limit["goals"][name]["gain"] > SETTINGS.shows * limit["goals"][name]["gain_se"]
    ]
    return list(dict.fromkeys(words for _, words in sorted(limits, reverse=True)))


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
    return LIMITS.get(key, f"no differences of {key.replace('_', ' ')}")


def what_limits(content: Content) -> list[str]:
    """Of each goal, what would make more studies answer and what would not, in a sentence."""
    sentences = []
    goals = list(content["designs"][content["chosen"] - 1]["goals"])
    for name in goals:
        gained, others = [], []
        by_gain = sorted(content["limits"].values(), key=lambda limit: -limit["goals"][name]["gain"])
        for limit in by_gain:
            goal = limit["goals"][name]
            if goal["gain"] > SETTINGS.shows * goal["gain_se"]:
                more = with_error(goal["gain"], goal["gain_se"])
                gained.append(f"{limit['words']} (answers {more} more often)")
            else:
                others.append(limit["words"])
        which = f"{name.replace('_', ' ')}: " if len(goals) > 1 else ""
        parts = [f"most would be gained by {', then by '.join(gained)}"] if gained else []
        parts += [f"nothing that shows by {listed(others)}"] if others else []
        sentences.append(f"{which}{'; '.join(parts)}.")
    return [sentence[0].upper() + sentence[1:] for sentence in sentences]


def warning(content: Content) -> str:
    """What speaks against the numbers of a plan; empty if nothing."""
    if content["normal_traces"]:
        return ""
    return Coded.stated("traces-not-normal")


def duration(minutes: float) -> str:
    """Minutes as people say them: "40 minutes", "9 hours"."""
    return worded("plan", "duration", minutes)
