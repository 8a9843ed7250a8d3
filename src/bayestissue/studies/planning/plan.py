"""A plan carried out: every design assessed, the cheapest that answers, and what more would add."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from bayestissue.base import runtime
from bayestissue.base.errors import Coded, InputError, path_argument
from bayestissue.base.outline import Rows, short
from bayestissue.base.result import Result, Say, silent
from bayestissue.base.results.files import write_json
from bayestissue.base.results.tables import table_of_rows, typed
from bayestissue.inference.answers.fixed import confounded
from bayestissue.model.hierarchy.design import build_design
from bayestissue.model.hierarchy.formulas.formula import terms_of
from bayestissue.model.hierarchy.formulas.group_terms import SUBJECT, grouping_of
from bayestissue.model.hierarchy.responses import RESPONSES
from bayestissue.reports.pages.page import worded, written
from bayestissue.reports.pages.plan_page import page_of
from bayestissue.reports.pages.wording import SENTENCES, nouns_of_plan
from bayestissue.studies.fitting import Questions, formulas_of, named_questions
from bayestissue.studies.planning.assurance import Assessment, Goal
from bayestissue.studies.planning.ledger import Case, Ledger, sha256_of
from bayestissue.studies.planning.plan_file import MOST_PEOPLE, PlanSpecification, plan_of, read_plan
from bayestissue.studies.planning.plan_settings import PLAN as SETTINGS
from bayestissue.studies.planning.planned_study import PlannedStudy, factors_named, study_of
from bayestissue.studies.simulation.simulation_file import Recording

PLAN, DESIGNS, STUDIES = "plan.json", "designs", "studies.parquet"


@dataclass(frozen=True, eq=False, repr=False)
class Plan(Result):
    """A plan carried out.

    Attributes:
        about: the content of ``run.json``.
        content: that of ``plan.json``: the plan as it was resolved, what was found, and a SHA-256 of all.
        designs: a row for each design and goal: ``designs.csv``.
        studies: a row for each study: ``studies.parquet``, from which a longer plan goes on.
    """

    command = "plan"
    files = ("designs.csv", "report.html")
    table_names = (DESIGNS,)
    about: dict[str, Any]
    content: dict[str, Any]
    designs: pd.DataFrame
    studies: pd.DataFrame

    def _outline(self) -> tuple[str, Rows]:
        plan, count = self.content["plan"], len(self.content["designs"])
        rows = [
            ("answer", short(self.answer, 300)),
            ("designs", f"{count}, of {plan['goal']['studies']} studies"),
            ("more in", ".answer, .paragraph, .designs, .content, .report(path)"),
        ]
        return f"Plan {short(plan['name'])}", rows

    @property
    def answer(self) -> str:
        """The cheapest design that answers, in a sentence."""
        return str(self.content["answer"])

    @property
    def paragraph(self) -> str:
        """The same for a grant application or a preregistration."""
        return str(self.content["paragraph"])

    def page(self) -> str:
        """The HTML of the page."""
        return page_of(self.content, self.designs, self.about)

    def write(self, folder: Path) -> None:
        """Write every file of a plan, but for the page that is drawn of them."""
        super().write(folder)
        self.studies.to_parquet(folder / STUDIES, index=False)
        write_json(self.content, folder / PLAN)


def plan(
    file: str | Path | None = None,
    *,
    people: int | Sequence[int] = (),
    masses_kg: Sequence[float] | Sequence[Sequence[float]] = (),
    ask: str | Sequence[str] | Mapping[str, str] = (),
    repeats: int | Sequence[int] = 1,
    velocities_m_s: float | Sequence[float] | Sequence[Sequence[float]] = 1.5,
    within: Mapping[str, Sequence[str]] | None = None,
    groups: Mapping[str, Sequence[str]] | None = None,
    model: str | None = None,
    K: str | None = None,
    C: str | None = None,
    after: str | Path | None = None,
    dataset: str | Path | None = None,
    studies: int | None = None,
    seed: int | None = None,
    say: Say | None = None,
) -> Plan:
    """How many people, masses and impacts a study needs to answer its questions, before anyone is hit.

    Thousands of studies are drawn from what is believed of people and tissue, each is analysed as `fit` would
    analyse it, and its questions are asked. Assurance is the share of studies that answer them.

    Args:
        file: a plan file; everything but ``after``, ``dataset``, ``studies``, ``seed``, ``say`` is in it.
        people: how many are recruited; several are candidates.
        masses_kg: the masses that every person is hit by; several lists are candidates.
        ask: claims to be decided, such as "mass_exponent_K < 0.5"; a dict names them.
        repeats: impacts of each person in each condition; several are candidates.
        velocities_m_s: velocities at contact.
        within: factors at whose every level each person is hit, such as {"side": ["left", "right"]}. Left
            out with ``groups``, they are those that questions name.
        groups: groups that each person belongs to, such as {"sex": ["f", "m"]}.
        model: the analysis, as `fit` takes it; "impact" unless given.
        K: what log K depends on; as the model has it unless given.
        C: the same of log C; that of ``K`` unless given.
        after: the folder of the fit of a study that has begun: what is planned is still to come.
        dataset: the recordings that were fitted.
        studies: of each design; a multiple of 100.
        seed: same seed, same machine: same numbers.
        say: told the stage, how much of it is done, and its total.

    Returns:
        The plan: ``.answer`` and ``.paragraph`` in words, ``.designs`` (a row a design and goal),
        ``.content``, and the method ``.report(folder)``.

    Raises:
        InputError: the plan is wrong, or asks for what its designs can't tell.

    Example:
        >>> plan = bt.plan(people=[10, 20, 30], masses_kg=[0.5, 1.0, 1.5], ask="mass_exponent_K < 0.5")
        >>> print(plan.answer)
        >>> plan.report("plans/exponent")
    """
    lists: dict[str, Any] = {"people": people, "masses_kg": masses_kg, "repeats": repeats}
    lists |= {"velocities_m_s": velocities_m_s}
    others: dict[str, Any] = {"within": within, "groups": groups, "model": model, "K": K, "C": C}
    if file is not None:
        stated, defaults = {**lists, "ask": ask, **others}, plan.__kwdefaults__ or {}
        if named := [name for name, value in stated.items() if not np.array_equal(value, defaults[name])]:
            raise InputError.stated("impossible-plan.both", "arguments", None, named[0], option=named[0])
        specification, source = read_plan(path_argument("file", file, "the path of a plan file")), str(file)
    else:
        specification, source = plan_of(content_of(lists, ask, **others), "arguments"), "arguments"
    specification = with_changes(specification, source, "after", run=after, dataset=dataset)
    specification = with_changes(specification, source, "goal", studies=studies, seed=seed)
    runtime.release_compiled()
    with runtime.compiled_kept():
        return carry_out(study_of(specification, source), say=say)


def content_of(
    candidates: Mapping[str, Any],
    ask: Questions,
    *,
    within: Mapping[str, Sequence[str]] | None = None,
    groups: Mapping[str, Sequence[str]] | None = None,
    model: str | None = None,
    K: str | None = None,
    C: str | None = None,
) -> dict[str, Any]:
    """What a plan file of the commonest kind would hold; arguments as of `plan`."""
    texts = named_questions(ask)
    factors = factors_named(texts.values()) if within is None and groups is None else []
    for further, named in (({}, within), ({"of_people": True}, groups)):
        factors += [
            {"name": name, "levels": list(levels), **further} for name, levels in (named or {}).items()
        ]
    lists = {name: _plain(value) for name, value in candidates.items()}
    formulas = formulas_of(K, C or None)
    content = {"candidates": {**lists, "factors": factors}, "questions": dict(texts), "formula": formulas}
    return content if model is None else {**content, "model": model}


def _plain(value: Any) -> Any:
    """Numbers and lists as a file has them, also of arrays and ranges."""
    if isinstance(value, Iterable) and not isinstance(value, str):
        return [_plain(inner) for inner in value]
    return value.item() if isinstance(value, np.generic) else value


def with_changes(plan: PlanSpecification, source: str, table: str, **changed: Any) -> PlanSpecification:
    """The plan with other settings of one of its tables, such as "goal", where they are given.

    Raises:
        InputError: a setting has a wrong value, or another one that it needs is missing.
    """
    settings = {k: str(v) if isinstance(v, Path) else v for k, v in changed.items() if v is not None}
    if not settings:
        return plan
    content = plan.model_dump(mode="json", exclude_unset=True)
    return plan_of({**content, table: {**content.get(table, {}), **settings}}, source)


def carry_out(
    study: PlannedStudy,
    *,
    say: Say | None = None,
    known: pd.DataFrame | None = None,
    parts: Path | None = None,
) -> Plan:
    """Assess every design, choose the cheapest that answers, and see what more of anything would add.

    Args:
        study: the plan, found possible.
        say: told the stage, how much of it is done, and its total.
        known: studies of an earlier plan, from which this goes on.
        parts: a folder in which finished studies are kept meanwhile.
    """
    start = runtime.CommandStart()
    aim = study.plan.goal
    ledger, cases = Ledger(study.goals, aim, say or silent, known, parts), study.cases
    assessments = ledger.assess(cases, aim.studies)
    minutes = [case.design.minutes(study.plan.cost) for case in cases]
    # The least assurance of all goals as a fraction of what is wanted.
    reached = [min(one.answered for one in of_goals) / aim.assurance for of_goals in assessments]
    # The cheapest that answers; where none does, the one that answers most.
    chosen = max(range(len(cases)), key=lambda number: (min(reached[number], 1), -minutes[number]))
    reaching = reached[chosen] >= 1
    variants, limits = _variants(cases[chosen], reaches=reaching), _limits(cases[chosen])
    fewer = min(aim.studies, SETTINGS.fewer_studies)
    normal = bool(ledger.table()["normal"].all())
    # Not many people too: designs that are assessed together cost as much as the largest of them.
    together = [case for name, case in variants.items() if name != "many people"]
    ledger.assess([*together, *limits.values()], fewer)
    (base,) = ledger.assess([cases[chosen]], fewer)

    def numbers(case: Case) -> dict[str, Any]:
        (assessed,) = ledger.assess([case], fewer)
        return _of_case(case, study.plan, assessed, base)

    content: dict[str, Any] = {
        "program": "bayestissue",
        "version": runtime.versions()["bayestissue"],
        "plan": study.plan.model_dump(mode="json", exclude_none=True),
        "analyses": [
            {
                "designs": [number for number, case in enumerate(cases, start=1) if case.model is model],
                "model": model.model_dump(mode="json"),
            }
            for model in {id(case.model): case.model for case in cases}.values()
        ],
        "designs": [
            {"design": number, **_of_case(case, study.plan, of_goals)}
            for number, (case, of_goals) in enumerate(zip(cases, assessments, strict=True), start=1)
        ],
        "normal_traces": normal,
        "chosen": chosen + 1,
        "reaches": reaching,
        "held_open": {} if reaching else _held_open(cases[chosen], study.goals),
        "variants": {name: numbers(case) for name, case in variants.items()},
        "limits": {
            key: {
                "words": SENTENCES["plan_limits"].get(key, f"no differences of {key.replace('_', ' ')}"),
                **numbers(case),
            }
            for key, case in limits.items()
        },
        **({"words": dict(study.words)} if study.words else {}),
    }
    # Of all that was assumed and found, and then come the same in words, with the study's own nouns.
    content["sha256"] = sha256_of(content)
    gains, nouns = _gains(content), nouns_of_plan(content)
    content |= {
        "answer": nouns(worded("plan", "answer", content, gains)),
        "paragraph": nouns(worded("plan", "paragraph", content, cases[chosen].model)),
        "warning": "" if normal else Coded.stated("traces-not-normal"),
        "limiting": [nouns(text) for text in written("plan", "limiting", content, gains)],
        "limits": {
            key: {**limit, "words": nouns(limit["words"])} for key, limit in content["limits"].items()
        },
    }
    stated = {"plan": study.plan.name, "seed": aim.seed, "studies": aim.studies, "sha256": content["sha256"]}
    record = start.record("plan", "plan", **stated)
    return Plan(record, content, _designs(content), ledger.table())


def known_studies(folder: Path) -> pd.DataFrame | None:
    """The studies of an earlier plan in a folder; None where there are none that can be read."""
    try:
        return pd.read_parquet(folder / STUDIES)
    except (OSError, ValueError):
        return None


def _variants(case: Case, *, reaches: bool) -> dict[str, Case]:
    """The chosen design with more people, and at one assumed truth or as it stands."""
    design = case.design
    if case.running.started:
        further = {"as it stands": _with_people(case, 0)}
    else:
        further = {"one truth": replace(case, prior=replace(case.prior, at_median=True))}
    if not reaches:
        many = max(2 * design.people, min(SETTINGS.many_times * design.people, MOST_PEOPLE))
        further["many people"] = _with_people(case, many)
    return {"more people": _with_people(case, design.people + SETTINGS.more_people), **further}


def _with_people(case: Case, people: int) -> Case:
    """The same with another number of people."""
    return replace(case, design=replace(case.design, people=people))


def _limits(case: Case) -> dict[str, Case]:
    """The chosen design, each time less limited in one respect; see `limit_words`."""
    design, simulation = case.design, case.simulation
    chain, formula = simulation.recording, case.model.formula
    limits = {
        "people": _with_people(case, 2 * design.people),
        "impacts": replace(case, design=replace(design, repeats=2 * design.repeats)),
    }
    terms = dict.fromkeys(term for q in RESPONSES for term in terms_of(getattr(formula, q)).groups)
    for stem in (term.stem for term in terms if term != SUBJECT):
        limits[stem] = replace(case, prior=replace(case.prior, without=f"sd_{stem}"))
    errors = [name for name in Recording.model_fields if "_sd" in name or name.startswith("noise_")]
    for key, share in (("noise", SETTINGS.better_noise), ("chain", 0.0)):
        of_key = [name for name in errors if name.startswith("noise_") == (key == "noise")]
        better = chain.model_copy(update={name: share * getattr(chain, name) for name in of_key})
        if better != chain:
            limits[key] = replace(case, simulation=simulation.model_copy(update={"recording": better}))
    return limits


def _held_open(case: Case, goals: Sequence[Goal]) -> dict[str, list[dict[str, Any]]]:
    """Of each goal, the group terms that people do not tell from it however many there are, with levels."""
    rows = case.design.rows()
    rows = case.running.followed_by(rows)[list(rows)]
    reference = case.model.reference_mass_kg
    recorded = build_design(
        case.model.formula, rows, reference_mass_kg=reference, source=case.model.name
    ).recorded
    return {
        goal.name: [
            {"term": str(term), "levels": len(grouping_of(rows, term.factors).levels), "of": term.grouping}
            for term in confounded(goal.node, recorded)
        ]
        for goal in goals
    }


def _of_case(
    case: Case, plan: PlanSpecification, assessed: Sequence[Assessment], base: Sequence[Assessment] = ()
) -> dict[str, Any]:
    """The numbers of a design by goal, and what they gained over those of the same studies in ``base``."""
    goals = {assessment.goal.name: assessment.numbers() for assessment in assessed}
    for before, more in zip(base, assessed, strict=False):
        goals[more.goal.name] |= _gain(before, more)
    return {**case.design.columns(), "minutes": case.design.minutes(plan.cost), "goals": goals}


def _gain(before: Assessment, more: Assessment) -> dict[str, float]:
    """How many more of the studies answer, which have the same truths and people."""
    gained = (more.yes | more.no).astype(float) - (before.yes | before.no)
    # Where no study changes, the error is that of one more which does.
    error = np.sqrt(max(gained.var(), 1 / (len(gained) + 2)) / len(gained))
    return {"gain": float(gained.mean()), "gain_se": float(error)}


def _gains(content: Mapping[str, Any]) -> list[dict[str, Any]]:
    """What each limit gains for each goal, the most first, and whether it ``shows`` apart from chance."""
    gains = [
        {"limit": key, "words": limit["words"], "goal": name, "gain": goal["gain"], "se": goal["gain_se"]}
        for key, limit in content["limits"].items()
        for name, goal in limit["goals"].items()
    ]
    gains.sort(key=lambda one: one["gain"], reverse=True)
    return [one | {"shows": one["gain"] > SETTINGS.shows * one["se"]} for one in gains]


def _designs(content: Mapping[str, Any]) -> pd.DataFrame:
    """A row for each design and goal: ``designs.csv``."""
    plan = content["plan"]
    texts = plan["questions"] | {name: number["of"] for name, number in plan.get("precision", {}).items()}
    rows = []
    for design in content["designs"]:
        of_design = {name: value for name, value in design.items() if name != "goals"}
        for name, numbers in design["goals"].items():
            rows.append({**of_design, "goal": name, "question": texts[name], **numbers})
    return typed(DESIGNS, table_of_rows(DESIGNS, rows))
