"""A plan in words: the answer in a sentence, and the paragraph of a grant application or preregistration."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from bayestissue.declarations import general
from bayestissue.errors import Coded
from bayestissue.outline import counted
from bayestissue.planning.settings import PLAN as SETTINGS
from bayestissue.report.wording import half_width, listed, nouns_of_plan, number, percent, with_error

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
    wanted = number(content["plan"]["goal"]["assurance"], 2)
    design, count = content["designs"][content["chosen"] - 1], len(content["designs"])
    if content["reaches"]:
        which = "" if count == 1 else f": the cheapest of {count} designs that reaches {wanted}"
        return f"{design_words(design, content)}, {_answers(design)}{which}."
    which = (
        f"This design does not answer with a probability of {wanted}: "
        if count == 1
        else f"None of the {count} designs answers with a probability of {wanted}. The best: "
    )
    many = content["variants"]["many people"]
    enough = all(goal["answered"] >= content["plan"]["goal"]["assurance"] for goal in many["goals"].values())
    people = counted(many["people"], "person", "people")
    plateau = (
        f"{people} would: {_shares(many)}."
        if enough
        else f"{people} would not either, {_shares(many)}: {_what_holds_it_open(content)}."
    )
    return f"{which}{design_words(design, content)}, {_answers(design)}. {plateau}"


def _what_holds_it_open(content: Content) -> str:
    """What limits the answer where the number of people does not."""
    held = {held["term"]: held for terms in content["held_open"].values() for held in terms}
    if not held:
        gaining = _gaining(content)
        return "their number is not what limits the answer" + (
            f", but {listed(gaining)} would help" if gaining else ""
        )
    levels = {
        term: "conditions" if x["of"] == "trial" else f"levels of {x['of']}" for term, x in held.items()
    }
    which = listed([f"the effects {term} of its {x['levels']} {levels[term]}" for term, x in held.items()])
    return (
        f"however many people there are, what is asked can't be told from {which}. More "
        f"{listed(list(levels.values()))} would help, or a formula without {listed(list(held))} if these "
        "effects are believed to be 0"
    )


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
    plan, design = content["plan"], content["designs"][content["chosen"] - 1]
    aim, first = plan["goal"], next(iter(design["goals"].values()))
    sure = f"above {aim['probability']:g} or below {1 - aim['probability']:.2g}"
    several = len(design["goals"]) > 1
    numbers = "; ".join(_of_goal(name if several else "", goal) for name, goal in design["goals"].items())
    truth = content["variants"].get("one truth", {"goals": {}})["goals"]
    powers = listed([number(goal["answered"], 2) for goal in truth.values()])
    more = content["variants"]["more people"]
    model = next(
        analysis["model"] for analysis in content["analyses"] if content["chosen"] in analysis["designs"]
    )
    lost = [
        f"{percent(plan['candidates'][key])} of the {what}"
        for key, what in (("lost", "impacts"), ("lost_people", "people"))
        if plan["candidates"].get(key)
    ]
    sentences = [
        f"The study asks {_asked(plan)}.",
        f"It has {design_words(design, content)}.",
        f"Losses of {listed(lost)} are allowed for." if lost else "",
        "The design was chosen by its assurance, the probability that the study answers its question given "
        "all that is believed of people and tissue beforehand (O'Hagan and Stevens, 2001).",
        f"A claim counts as answered if its posterior probability is {sure}." if plan["questions"] else "",
        f"In {first['studies']} simulated studies of this design {numbers}.",
        f"At one assumed truth, the medians of these beliefs, the power is {powers}." if truth else "",
        f"With {more['people']} people the assurance is {_shares(more)}.",
        "Each simulated study is analysed as the study itself will be, by a Bayesian hierarchical model of "
        f"stiffness K and damping C of every impact (bayestissue {content['version']}, model "
        f"{model['name']}, log K by {model['formula']['K']}).",
        f"The plan with all of its assumptions has a SHA-256 that begins with {content['sha256'][:12]}.",
    ]
    return " ".join(filter(None, sentences))


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


def design_words(design: Content, content: Content) -> str:
    """A design: "20 people, each hit 3 times by 0.5 and 1 kg at 1.5 m/s (120 impacts, about 9 hours)"."""
    masses, velocities = design["masses_kg"].split(), design["velocities_m_s"].split()
    by = f"by {listed(masses)} kg at {listed(velocities)} m/s"
    if len(masses) * len(velocities) != design["conditions"]:
        by = (
            f"in {design['conditions']} conditions ({masses[0]} to {masses[-1]} kg, {velocities[0]} to "
            f"{velocities[-1]} m/s)"
        )
    factors = content["plan"]["candidates"].get("factors", [])
    levels = "".join(
        f", {factor['name']} {listed(list(factor['levels']))}"
        + ("" if factor.get("every", True) else " at random")
        for factor in factors
        if not factor.get("of_people")
    )
    groups = [_group_words(factor, design["people"]) for factor in factors if factor.get("of_people")]
    times = "once" if design["repeats"] == 1 else f"{design['repeats']} times"
    kind = ("further person", "further people") if "after" in content["plan"] else ("person", "people")
    people = counted(design["people"], *kind) + (f" ({'; '.join(groups)})" if groups else "")
    size = f"{counted(design['impacts'], 'impact')}, about {duration(design['minutes'])}"
    recorder = f", recorded by {design['recorder']}" if design["recorder"] else ""
    return f"{people}, each hit {times} {by}{levels}{recorder} ({size})"


def _group_words(factor: Content, people: int) -> str:
    """How many people belong to each level of a group: "4 treated and 4 control by group"."""
    levels = list(factor["levels"])
    sizes = [people // len(levels) + (number < people % len(levels)) for number in range(len(levels))]
    named = [f"{count} {level}" for count, level in zip(sizes, levels, strict=True)]
    return f"{factor['name']}: {listed(named)}"


def duration(minutes: float) -> str:
    """Minutes as people say them: "40 minutes", "9 hours"."""
    if minutes < 90:
        return counted(round(minutes), "minute")
    return counted(round(minutes / 60), "hour")


def _answers(design: Content) -> str:
    return f"answers with a probability of {_shares(design)}"


def _shares(design: Content) -> str:
    goals = design["goals"]
    suffix = {name: f" ({name.replace('_', ' ')})" if len(goals) > 1 else "" for name in goals}
    return listed([f"{with_error(g['answered'], g['se'])}{suffix[name]}" for name, g in goals.items()])


def _asked(plan: Content) -> str:
    claims = [f"whether {text}" for text in plan["questions"].values()]
    numbers = plan.get("precision", {}).values()
    widths = [f"for {one['of']} to ± {half_width(one)} (half of the 90 % interval)" for one in numbers]
    return listed(claims + widths)


def _of_goal(name: str, goal: Content) -> str:
    suffix = f" of {name.replace('_', ' ')}" if name else ""
    said = f"the assurance{suffix} is {number(goal['answered'], 2)} (standard error {number(goal['se'], 2)})"
    if goal["misleads"] is None:
        width = goal["width"]
        return said if width is None else f"{said}, with a half width of {general(width, 2)} on average"
    undecided, misleads = number(goal["undecided"], 2), number(goal["misleads"], 2)
    return f"{said}, with {undecided} of them undecided and {misleads} answered wrongly"
