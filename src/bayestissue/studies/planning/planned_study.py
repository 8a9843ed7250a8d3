"""How each candidate design will be analysed, and what of a plan it can't tell: refused before any work."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import xarray as xr

from bayestissue.base.errors import InputError, Problem, collected, refuse
from bayestissue.inference.answers.grammar import Choice, Quantity, QuestionError, parse
from bayestissue.inference.answers.law import MOTION, Law
from bayestissue.inference.answers.meaning import outcomes_in, searched
from bayestissue.inference.answers.questions import (
    Question,
    problem_of,
    require_outcomes,
    require_readable,
)
from bayestissue.inference.answers.reliability import as_variables, coefficients
from bayestissue.inference.answers.study import Study
from bayestissue.mechanics.elements import element
from bayestissue.model.hierarchy.design import Design, build_design
from bayestissue.model.hierarchy.formulas.formula import DEFAULT_FORMULA
from bayestissue.model.hierarchy.formulas.formula import resolve as resolve_formula
from bayestissue.model.hierarchy.formulas.group_terms import quoted
from bayestissue.model.hierarchy.priors import term_of_group, term_of_slope
from bayestissue.model.hierarchy.responses import RESPONSES
from bayestissue.model.hierarchy.specification import ModelSpecification
from bayestissue.recordings.dataset.cells import ignoring_case
from bayestissue.studies.finished import read_run
from bayestissue.studies.fitting import resolve
from bayestissue.studies.planning.assurance import Goal
from bayestissue.studies.planning.candidates import Candidate, Conditions, grid, largest_of_each
from bayestissue.studies.planning.design_prior import DesignPrior
from bayestissue.studies.planning.information import simulation_of
from bayestissue.studies.planning.ledger import Case
from bayestissue.studies.planning.plan_file import PlanSpecification
from bayestissue.studies.planning.running import Background, begun_study, draws_of_fit
from bayestissue.studies.planning.study_posterior import planned_model
from bayestissue.studies.planning.tabulated_law import planned_law

# The mass that K and C of the population are at, where neither plan nor model says.
REFERENCE_MASS_KG = 0.7
# Numbers that may be 0 or below, of which no relative width is.
_SIGNED = ("mass_exponent_", "effect_of_", "intercept_", "residual_correlation")


@dataclass(frozen=True, eq=False)
class PlannedStudy:
    """A plan that can be carried out.

    Attributes:
        plan: its file.
        cases: the designs, each with the model that analyses it; designs with the same formulas share it.
        goals: what the study shall find out.
        words: what people, conditions and impacts are called, by the keys of ``[words]``.
    """

    plan: PlanSpecification
    cases: tuple[Case, ...]
    goals: tuple[Goal, ...]
    words: Mapping[str, str]


def study_of(plan: PlanSpecification, source: str) -> PlannedStudy:
    """The plan with its designs and their analyses.

    Args:
        plan: its file.
        source: what messages call that.

    Raises:
        InputError: a question or a belief is about what a design can't tell, a formula asks for it, or the
            model or the pilot does not suit: all that is wrong at once.
    """
    problems: list[Problem] = []
    known = _background(plan, source, problems)
    model, designs = known.model, known.named(grid(plan.candidates, tuple(plan.recordings)))
    if model.likelihood != "impact":
        where = source, None, "model", model.likelihood
        problems.append(Problem.stated("impossible-plan.likelihood", *where))
    law, goals = planned_law(model, plan.gravity), _goals(plan)
    unreadable = {goal: problem for goal in goals if (problem := _unreadable(goal, source))}
    problems += unreadable.values()
    readable = [goal for goal in goals if goal not in unreadable]
    open_formulas: dict[Conditions, dict[str, str]] = {}
    judged: list[Design] = []
    for conditions, candidate in largest_of_each(designs).items():
        open_formulas[conditions] = _open_formulas(model, candidate, readable, plan)
        formulas = model.formula.model_copy(update=open_formulas[conditions])
        rows = known.running.followed_by(candidate.rows())
        named = source if plan.formula else known.source
        with collected(problems):
            design = build_design(formulas, rows, reference_mass_kg=model.reference_mass_kg, source=named)
            judged.append(design)
            problems += _unanswerable(design, readable, model, law, source)
    problems += _unknown_beliefs(plan, judged, source)
    refuse({str(problem): problem for problem in problems}.values())
    simulations = {
        name: simulation_of(recording, recorder=plan.recorder, gravity=plan.gravity)
        for name, recording in plan.recordings.items()
    }
    # Designs with the same formulas share a model.
    models = {tuple(further.items()): model for further in open_formulas.values()}
    for further in filter(None, models):
        resolved, _ = resolve(plan.model, formulas={**plan.formula, **dict(further)})
        models[further] = resolved.model_copy(update={"reference_mass_kg": model.reference_mass_kg})
    cases = (
        Case(
            design,
            models[tuple(open_formulas[design.conditions].items())],
            known.prior,
            simulations[design.recorder],
            known.running,
        )
        for design in designs
    )
    return PlannedStudy(plan, tuple(cases), goals, known.words if plan.words is None else plan.words.values())


def _background(plan: PlanSpecification, source: str, problems: list[Problem]) -> Background:
    """What the plan starts from; what is wrong with a pilot goes to ``problems``."""
    if plan.after is not None:
        known = begun_study(plan.after, plan.population, source)
    else:
        known = Background(*resolve(plan.model, formulas=plan.formula), DesignPrior(plan.population))
    if plan.after is None and plan.pilot is not None:
        with collected(problems):
            pilot, where = read_run(plan.pilot), (source, None, "pilot")
            if (element := pilot.specification.element) != known.model.element:
                raise InputError.stated("impossible-plan.pilot", *where, element, element=known.model.element)
            prior = DesignPrior(plan.population, draws_of_fit(pilot, (*where, plan.pilot)))
            known = replace(known, prior=prior, words=pilot.about.get("words", {}))
    stated = plan.reference_mass_kg if plan.after is None else None
    reference = stated or known.model.reference_mass_kg or REFERENCE_MASS_KG
    return replace(known, model=known.model.model_copy(update={"reference_mass_kg": reference}))


def factors_named(questions: Iterable[str]) -> list[dict[str, Any]]:
    """The factors that questions name by two levels or more, as [[candidates.factors]] has them."""
    levels: dict[str, dict[str, None]] = {}
    for text in questions:
        try:
            named = [level for quantity in parse(text).quantities() for level in quantity.levels]
        except QuestionError:
            continue
        for level in named:
            if level.value is not None and level.column not in _STANDARD:
                levels.setdefault(ignoring_case(level.column, levels), {})[level.value] = None
    return [{"name": name, "levels": list(values)} for name, values in levels.items() if len(values) > 1]


_STANDARD = ("impact", "subject", "trial", "energy_J", *MOTION)


def _open_formulas(
    model: ModelSpecification, design: Candidate, goals: Sequence[Goal], plan: PlanSpecification
) -> dict[str, str]:
    """The default formula with the factors that are asked for, less what the design can't tell.

    By the responses that have no formula by plan or model.
    """
    missing = [q for q in RESPONSES if getattr(model.formula, q) is None]
    if not missing:
        return {}
    factors = [factor.name for factor in plan.candidates.factors]
    named = {
        ignoring_case(level.column, factors)
        for goal in goals
        for quantity in goal.node.quantities()
        for level in quantity.levels
    }
    wanted = DEFAULT_FORMULA
    for factor in plan.candidates.factors:
        if factor.name in named:
            name = quoted([factor.name])
            wanted += f" + {name}" + (f" + (1|subject:{name})" if factor.within else "")
    resolved = resolve_formula(wanted, design.rows(), model.reference_mass_kg or REFERENCE_MASS_KG)
    return dict.fromkeys(missing, str(resolved.terms))


def _key(goal: Goal) -> str:
    """Where the plan has its text."""
    return f"questions.{goal.name}" if goal.width is None else f"precision.{goal.name}.of"


def _question(goal: Goal, source: str) -> Question:
    return Question(goal.text, f"{source}, {_key(goal)}", goal.name)


def _unreadable(goal: Goal, source: str) -> Problem | None:
    """A slip of form, a claim where a number belongs, or a number where a claim does."""
    try:
        node = goal.node
    except QuestionError as slip:
        return problem_of(slip, _question(goal, source))
    is_question, is_claim = goal.width is None, node.claims
    where = source, None, _key(goal), goal.text
    if is_question and not is_claim:
        return Problem.stated("impossible-plan.claim", *where)
    if (is_claim or isinstance(node, Choice)) and not is_question:
        return Problem.stated("impossible-plan.number", *where)
    if searched(node):
        return Problem.stated("impossible-plan.critical", *where)
    if goal.relative and isinstance(node, Quantity) and node.name.startswith(_SIGNED):
        key = f"precision.{goal.name}.relative"
        return Problem.stated("impossible-plan.relative", source, None, key, goal.text)
    return None


def _unanswerable(
    design: Design,
    goals: Sequence[Goal],
    model: ModelSpecification,
    law: Law,
    source: str,
) -> list[Problem]:
    """Goals about what this design does not have."""
    problems: list[Problem] = []
    draws, masses_kg = _example(design, model), sorted(set(design.recorded.rows["mass_kg"]))
    further = [parameter.name for parameter in element(model.element).extra]
    words: dict[str, Any] = {"element": model.element, "parameters": ", ".join(further)}
    for goal in goals:
        exponents = [q.name for q in goal.node.quantities() if q.name.startswith("mass_exponent_")]
        if exponents and len(masses_kg) == 1:
            where = source, None, "candidates.masses_kg", masses_kg[0]
            names: dict[str, Any] = {"exponent": exponents[0], "name": goal.name}
            problems.append(Problem.stated("impossible-plan.one-mass", *where, **names))
            continue
        with collected(problems):
            question, study = _question(goal, source), Study(draws, design.recorded, law)
            require_readable([question], study)
            if outcomes_in(goal.node, design.recorded) and further:
                raise InputError.stated(
                    "impossible-plan.outcome", *(source, None, "model", model.name), **words
                )
            require_outcomes([question], study)
    return problems


def _example(design: Design, model: ModelSpecification) -> xr.Dataset:
    """Two draws of everything that a question may name, of which no value counts."""
    planned, _ = planned_model(model.model_copy(update={"formula": design.formulas}), design)
    values = {name: np.array([[0.1, 0.2]]) for name in planned.hyperparameters}
    b = np.broadcast_to(np.array([[[0.1], [0.2]]]), (1, 2, planned.locations.size))
    draws = planned.draws(design, values, b)
    known = coefficients(draws, design.recorded, dict.fromkeys(RESPONSES, 0.01))
    return draws.merge(as_variables(known))


def _unknown_beliefs(plan: PlanSpecification, designs: Sequence[Design], source: str) -> Iterator[Problem]:
    """Beliefs about effects and groups that no design has."""

    def unknown(table: str, key: str, known: Iterable[object]) -> Problem:
        column, allowed = f'population.{table}."{key}"', ", ".join(sorted(map(str, known))) or "nothing"
        return Problem.stated("impossible-plan.belief", source, None, column, None, allowed=allowed)

    terms = {term for design in designs for term in design.terms}
    for table, read in (("sd_group", term_of_group), ("sd_slope", term_of_slope)):
        terms_of_table = [term for term in terms if bool(term.slope) == (table == "sd_slope")]
        for key in getattr(plan.population, table):
            if read(key) not in terms:
                yield unknown(table, key, terms_of_table)
    for q, effects in plan.population.effects.items():
        names = {n for design in designs if q in design.responses for n in design.responses[q].names}
        yield from (unknown(f"effects.{q}", key, names) for key in effects if key not in names)


def _goals(plan: PlanSpecification) -> tuple[Goal, ...]:
    claimed = [Goal(name, text) for name, text in plan.questions.items()]
    numbers = [
        Goal(name, number.of, number.half_width or number.relative, number.relative is not None)
        for name, number in plan.precision.items()
    ]
    return (*claimed, *numbers)
