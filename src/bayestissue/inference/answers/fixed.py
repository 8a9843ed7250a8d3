"""Comparisons that a formula fixes, and those that group terms hold open: found by moving its parameters.

Without a term group:side the ratio of ratios over sides is 1 in every draw, but for rounding. A comparison is
evaluated at parameters drawn at random, of which no two are related: with more than one outcome it is open
(but for a set of parameters of probability 0), and with one it is fixed.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
import xarray as xr
from jaxtyping import Float
from scipy.linalg import null_space

from bayestissue.base.declarations import general
from bayestissue.inference.answers.evaluation import draws_of
from bayestissue.inference.answers.grammar import (
    Choice,
    Critical,
    Node,
    Operation,
    Quantity,
    QuestionError,
)
from bayestissue.inference.answers.integration import SETTINGS
from bayestissue.inference.answers.law import Law, Values
from bayestissue.inference.answers.meaning import (
    alternatives,
    is_response,
    responses_of,
)
from bayestissue.inference.answers.study import Study
from bayestissue.model.hierarchy.formulas.formula import resolve
from bayestissue.model.hierarchy.formulas.group_terms import (
    MASS_TERM,
    GroupTerm,
    common_coefficient,
    grouping_of,
    quoted,
)
from bayestissue.model.hierarchy.formulas.identifiability import PRECISION
from bayestissue.model.hierarchy.levels import design_at
from bayestissue.model.hierarchy.recorded import Recorded
from bayestissue.model.hierarchy.responses import intercept, parameter_of


@dataclass(frozen=True)
class _AnyLaw(Law):
    """In place of the law of force: a function of the parameters and the motion without symmetries."""

    gravity: float = 1.0
    of: tuple[str, ...] = ()

    @property
    def parameters(self) -> tuple[str, ...]:
        """K, C and what else has a formula."""
        return self.of

    def outcomes(self, parameters: Values, motion: Values, names: Iterable[str] = ()) -> Values:
        """K^0.37 C^0.21 and likewise of further parameters, times mass^0.3 velocity."""
        powers = 0.37 * 0.57 ** np.arange(len(self.of))
        logs = [power * np.log(parameters[q]) for q, power in zip(self.of, powers, strict=True)]
        value = np.exp(sum(logs)) * motion["mass_kg"] ** 0.3 * motion["velocity_m_s"]
        return dict.fromkeys(names, value)


def fixed_parts(node: Node, study: Study) -> Iterator[QuestionError]:
    """The comparisons of a question, or the expression that it is, that no parameter moves.

    Args:
        node: a question without mistakes.
        study: of which; before it has draws only responses can be judged.
    """
    node = _without_search(node)
    compared = list(_comparisons(node))
    if isinstance(node, Choice) and compared:
        levels = tuple(alternatives(node, study).values())
        ends = (Operation(end, levels, node.position, node.depth + 1) for end in ("max", "min"))
        compared = [tuple(ends)]
    for sides in compared:
        value = _value_if_fixed(sides, study)
        if value is None:
            continue
        position = min(quantity.position for quantity in _quantities(sides))
        actual = f"{general(value)}, whatever K and C are"
        missing = _missing_terms(sides, study.recorded)
        if not missing:
            yield QuestionError(position, actual, "a quantity that data can change")
            continue
        response, *_ = missing.values()
        expected = f"a quantity that the formula of {response} leaves open; it has no {' or '.join(missing)}"
        yield QuestionError(position, actual, expected)


def confounded(node: Node, recorded: Recorded) -> tuple[GroupTerm, ...]:
    """The group terms, of levels that are not of people, that rows do not tell from what a question is of.

    With X of the covariates and Z of a term's levels, what the question compares changes along a direction in
    which X beta + Z b stays as it is in all rows. However many people are hit in these rows, only the prior
    N(0, s²) of b then tells of it.

    Args:
        node: a question without mistakes.
        recorded: the rows and formulas.
    """
    draws = _any_parameters(recorded, list(recorded.formulas))
    terms = []
    for q in recorded.formulas:
        covariates, groups = recorded.response(q).at(recorded.rows)
        X = np.column_stack([np.ones(len(recorded.rows)), *covariates.values()])
        names = [intercept(parameter_of(q)), *(common_coefficient(name, q) for name in covariates)]
        for term, x in groups.items():
            if "subject" in term.factors:
                continue
            grouping = grouping_of(recorded.rows, term.factors)
            Z = (grouping.code[:, None] == np.arange(len(grouping.levels))) * x[:, None]
            for direction in null_space(np.unique(np.hstack([X, Z]), axis=0), rcond=PRECISION).T:
                shift = dict(zip(names, direction, strict=False))
                moved = _moved(draws, q, shift, groups, {term: direction[len(names) :]})
                if _changes(node, draws, moved, recorded):
                    terms.append(term)
                    break
    return tuple(dict.fromkeys(terms))


def _moved(
    draws: xr.Dataset,
    q: str,
    shift: Mapping[str, float],
    terms: Iterable[GroupTerm],
    levels: Mapping[GroupTerm, Float[np.ndarray, " level"]],
) -> xr.Dataset:
    """Draws with other coefficients of covariates, of which levels' own have a part, and other effects."""
    moved = {name: draws[name] + by for name, by in shift.items()}
    for term in terms:
        name = term.variable(q)
        shared = shift.get(common_coefficient(term.slope, q), 0.0) if term.slope else 0.0
        moved[name] = draws[name] + shared + levels.get(term, 0.0)
    return draws.assign(moved)


def _changes(node: Node, draws: xr.Dataset, moved: xr.Dataset, recorded: Recorded) -> bool:
    """Whether what a question compares is another in ``moved``, as a difference and as a ratio."""
    for sides in _comparisons(node):
        try:
            before, after = (_values(sides, parameters, recorded) for parameters in (draws, moved))
        except (KeyError, QuestionError):  # of what is no parameter, such as coefficients of reliability
            continue
        pairs = zip(_comparable(before), _comparable(after), strict=False)
        if not any(np.allclose(*pair, rtol=SETTINGS.changed) for pair in pairs):
            return True
    return False


def _comparable(values: Sequence[np.ndarray]) -> list[np.ndarray]:
    """What is compared, and of two sides their difference and ratio."""
    left, *others = values
    return [left - right for right in others] + [left / right for right in others if right.all()] or [left]


def _without_search(node: Node) -> Node:
    """With the difference of a claim's sides in place of where it ends to hold: one moves as the other."""
    if isinstance(node, Critical):
        (claim,) = node.operands
        node = Operation("-", claim.operands, claim.position, claim.depth)
    return node.changed(_without_search)


def _comparisons(node: Node) -> Iterator[tuple[Node, ...]]:
    """The two sides of each comparison that names a quantity; an expression alone."""
    if node.symbol in ("and", "or", "not"):
        for operand in node.operands:
            yield from _comparisons(operand)
        return
    first, *others = node.operands if node.claims else (node,)
    pairs: list[tuple[Node, ...]] = [(first, second) for second in others]
    for sides in pairs or [(first,)]:
        # What is largest or least may be the same in draws that are near each other.
        several = any(part.symbol in ("max", "min") for side in sides for part in side.parts())
        if not several and _quantities(sides):
            yield sides


def _quantities(sides: Sequence[Node]) -> list[Quantity]:
    return [quantity for side in sides for quantity in side.quantities()]


def _value_if_fixed(sides: Sequence[Node], study: Study) -> float | None:
    """What is compared, if it is the same whatever the parameters are."""
    recorded, named = study.recorded, _quantities(sides)
    if all(is_response(quantity, recorded) for quantity in named):
        draws = _any_parameters(recorded, _responses(named, recorded))
    elif study.draws and len(named) > 1:
        draws = study.draws
    else:
        return None
    try:
        values = _values(sides, draws, recorded)
    except QuestionError:  # a number that is none in some draws
        return None
    left, right = values[0], values[1] if len(values) > 1 else np.zeros(1)
    ratio, difference = left / right if right.all() else right, left - right
    if all(np.ptp(side) <= SETTINGS.rounding * np.abs(side).max() for side in (left, right)):
        return float(left.mean())
    if ratio.all() and np.ptp(ratio) <= SETTINGS.rounding * np.abs(ratio).max():
        return float(ratio.mean())
    greatest = max(np.abs(left).max(), np.abs(right).max())
    return float(difference.mean()) if np.ptp(difference) <= SETTINGS.rounding * greatest else None


def _values(sides: Sequence[Node], draws: xr.Dataset, recorded: Recorded) -> list[np.ndarray]:
    study = Study(draws, recorded, _AnyLaw(of=tuple(recorded.formulas)))
    return [draws_of(side, study).to_numpy() for side in sides]


def _responses(named: Sequence[Quantity], recorded: Recorded) -> list[str]:
    """The responses that these are made of, each once."""
    return list(dict.fromkeys(q for quantity in named for q in responses_of(quantity.name, recorded)))


def _any_parameters(recorded: Recorded, responses: Sequence[str], count: int = 5) -> xr.Dataset:
    """So many draws of all parameters of some responses, each by itself."""
    rng, shape = np.random.default_rng(0), (1, count)
    drawn: dict[str, tuple[tuple[str, ...], np.ndarray]] = {}
    coords: dict[str, object] = {"chain": [0], "draw": np.arange(count)}
    for q in responses:
        at = design_at(recorded, q, [{}])
        names = [intercept(parameter_of(q)), *(common_coefficient(name, q) for name in at.covariates)]
        drawn |= {name: (("chain", "draw"), 0.3 * rng.standard_normal(shape)) for name in names}
        for term in at.levels:
            levels = list(grouping_of(recorded.rows, term.factors).levels)
            coords[term.grouping] = levels
            effects = 0.3 * rng.standard_normal((*shape, len(levels)))
            drawn[term.variable(q)] = ("chain", "draw", term.grouping), effects
            drawn[term.sd(q)] = ("chain", "draw"), rng.uniform(0.1, 0.3, shape)
    return xr.Dataset(drawn, coords)


def _missing_terms(sides: Sequence[Node], recorded: Recorded) -> dict[str, str]:
    """The terms of fewest columns that would move a comparison, and the response whose formula lacks each."""
    named = _quantities(sides)
    columns = dict.fromkeys(level.column for quantity in named for level in quantity.levels)
    followers = (name for column in columns for name in recorded.followers(column))
    usable = [name for name in dict.fromkeys([*columns, *followers]) if name in recorded.rows]
    missing: dict[str, str] = {}
    for size in range(1, 1 + min(len(usable), 3)):
        for chosen in combinations(usable[: SETTINGS.columns_tried], size):
            term = _term(chosen, recorded)
            for q in _responses([one for one in named if is_response(one, recorded)], recorded):
                formula = f"{recorded.formulas[q]} + {term}"
                wider = Study(xr.Dataset(), replace(recorded, formulas={**recorded.formulas, q: formula}))
                faults = resolve(formula, recorded.rows, recorded.reference_mass_kg).faults
                if not faults and _value_if_fixed(sides, wider) is None:
                    missing.setdefault(term, q)
        if missing:
            return missing
    return missing


def _term(columns: Sequence[str], recorded: Recorded) -> str:
    """A product of columns: effects of levels where one of them is what a group term is of."""
    if any(map(recorded.may_be_new, columns)):
        return f"(1|{quoted(columns)})"
    return ":".join(MASS_TERM if name == "mass_kg" else quoted([name]) for name in columns)
