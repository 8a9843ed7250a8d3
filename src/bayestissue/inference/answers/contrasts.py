"""Ratios of K and of C between levels: left over right, women over men, one operator over another.

With the expected log of a response at two levels, all else equal, the ratio is

    r = exp(log q(level) - log q(against)),

its probability of direction that of the likelier of r > 1 and r < 1 (Makowski et al. 2019,
doi:10.3389/fpsyg.2019.02767), and its probability of practical equivalence that of |log r| < log(1 + e)
(Kruschke 2018, doi:10.1177/2515245918771304), e being 0.1 unless the model file has another.

Compared are, of each response, by its own formula:

- the levels of each category, of numbers in ``C()``, and of each number with two values, averaged over what
  interacts with it;
- the levels of each group but people, who have a table of their own (`people_compared`);
- of combinations such as ``subject:side`` those that differ in one column but the person, within each person
  and averaged over the people recorded;
- conditions at one mass. Where the formula has the mass, effects of conditions that stand for masses are what
  the mass exponent leaves over, and a ratio of two of them would be read as one of masses.

Of more than twelve levels each stands against the mean of all. Of two levels the one goes over the other
that a question has first; else a category goes over those that follow it in the alphabet, left over right,
after over before, and a greater number over a smaller one.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from itertools import combinations
from typing import NamedTuple

import numpy as np
import pandas as pd
import xarray as xr
from jaxtyping import Float

from bayestissue.hierarchy.formulas.formula import group_terms, variables_of_terms
from bayestissue.hierarchy.formulas.group_terms import SUBJECT, labels_of
from bayestissue.hierarchy.levels import Condition, Recorded, log_at_levels
from bayestissue.inference.answers.grammar import Node, Number, Quantity, QuestionError, parse
from bayestissue.inference.answers.meaning import quantities
from bayestissue.results.tables import joined

ALL = "mean of all"
_COMPARED = ["factor", "level", "against"]
_MOST_IN_PAIRS = 12
_MOST_LEVELS = 400
_MOST_AVERAGED = 200
# Numbers that are measured or set, two of which make no factor.
_PHYSICAL = ("mass_kg", "velocity_m_s", "energy_J", "diameter_m")
_SAME_MASS = 0.01
# What holds its two sides against each other.
_AGAINST = ("/", "-", "<", "<=", ">", ">=")


class Contrast(NamedTuple):
    """A level against another; each is the mean of the log over its conditions."""

    factor: str
    level: str
    against: str
    upper: tuple[Condition, ...]
    lower: tuple[Condition, ...]


def contrasts(
    draws: xr.Dataset,
    recorded: Recorded,
    responses: Sequence[str],
    equivalence: float,
    questions: Iterable[str] = (),
) -> pd.DataFrame:
    """Every contrast that the formulas have, a row each: ``contrasts.csv``.

    Args:
        draws: the group posterior.
        recorded: what was measured.
        responses: K, C and the further parameters that have a formula.
        equivalence: e, the relative difference that counts as none in practice.
        questions: of the model, whose directions are taken.

    Returns:
        ``ratio`` is the median, ``low`` and ``high`` the ends of the 90 % equal-tailed interval.
    """
    tables, directions = [], asked_directions(questions)
    for response in responses:
        directed = [_directed(contrast, directions) for contrast in contrasts_of(recorded, response)]
        if directed:
            logs = log_ratios(draws, recorded, response, directed)
            names = pd.DataFrame([contrast[:3] for contrast in directed], columns=_COMPARED)
            tables.append(names.assign(quantity=response, **ratio_summary(logs, equivalence)))
    # K and C of a contrast one below the other.
    table = joined("contrasts", tables)
    order = table.groupby(_COMPARED, sort=False).ngroup()
    return table.iloc[np.argsort(order, kind="stable")].reset_index(drop=True)


def asked_directions(questions: Iterable[str]) -> frozenset[tuple[str, str, str]]:
    """Column, first and second level of each pair of levels that a question holds against each other.

    As "K[side=left] / K[side=right] > 1.1" does, or "K[side=left] > K[side=right]"; questions that can't be
    read have none.
    """
    directions: dict[tuple[str, str, str], None] = {}
    for text in questions:
        with suppress(QuestionError):
            for first, second in _held_against(parse(text)):
                levels = [
                    {level.column: level.value for level in quantity.levels} for quantity in (first, second)
                ]
                differ = [name for name in levels[0] if levels[0][name] != levels[1].get(name)]
                if len(differ) == 1 and levels[0].keys() == levels[1].keys():
                    column = differ[0]
                    pair = column, str(levels[0][column]), str(levels[1][column])
                    if (column, pair[2], pair[1]) not in directions:
                        directions[pair] = None
    return frozenset(directions)


def _held_against(node: Node) -> Iterator[tuple[Quantity, Quantity]]:
    """Pairs of quantities on either side of a ratio, a difference or a comparison, outermost first."""
    if isinstance(node, Number | Quantity):
        return
    if len(node.operands) == 2 and node.symbol in _AGAINST:
        sides = [list(quantities(operand)) for operand in node.operands]
        if [len(side) for side in sides] == [1, 1]:
            yield sides[0][0], sides[1][0]
    for operand in node.operands:
        yield from _held_against(operand)


def _directed(contrast: Contrast, directions: frozenset[tuple[str, str, str]]) -> Contrast:
    """The contrast, or its reciprocal where a question asks for that."""
    parts = (contrast.factor.split(":"), contrast.level.split(":"), contrast.against.split(":"))
    if len({len(part) for part in parts}) == 1:
        differ = [triple for triple in zip(*parts, strict=True) if triple[1] != triple[2]]
        if any((name, against, level) in directions for name, level, against in differ):
            return Contrast(contrast.factor, contrast.against, contrast.level, contrast.lower, contrast.upper)
    return contrast


def ratio_summary(logs: Float[np.ndarray, "draw ratio"], equivalence: float) -> dict[str, np.ndarray]:
    """Median, 90 % interval, probabilities of direction and of practical equivalence of ratios."""
    low, median, high = np.exp(np.percentile(logs, [5, 50, 95], axis=0))
    return {
        "ratio": median,
        "low": low,
        "high": high,
        "p_direction": np.maximum((logs > 0).mean(axis=0), (logs < 0).mean(axis=0)),
        "p_equivalent": (np.abs(logs) < np.log1p(equivalence)).mean(axis=0),
    }


def log_ratios(
    draws: xr.Dataset, recorded: Recorded, response: str, compared: Sequence[Contrast]
) -> Float[np.ndarray, "draw ratio"]:
    """The log of each ratio, for each draw."""
    conditions = {
        _key(condition): condition
        for contrast in compared
        for condition in (*contrast.upper, *contrast.lower)
    }
    row = {key: number for number, key in enumerate(conditions)}
    weights = np.zeros((len(conditions), len(compared)))
    for column, contrast in enumerate(compared):
        for sign, side in ((1, contrast.upper), (-1, contrast.lower)):
            for condition in side:
                weights[row[_key(condition)], column] += sign / len(side)
    # All else equal: with a session comes nothing of what else was so in it.
    logs = log_at_levels(draws, recorded, response, list(conditions.values()), follow=False)
    return logs.reshape(-1, len(conditions)) @ weights


def _key(condition: Condition) -> tuple[tuple[str, str | float], ...]:
    return tuple(sorted(condition.items()))


def contrasts_of(recorded: Recorded, response: str) -> list[Contrast]:
    """What a response's formula lets one compare, covariates first."""
    formula = recorded.formulas.get(response, "1")
    variables = variables_of_terms(formula)
    named = dict.fromkeys(name for columns in variables for name in sorted(columns))
    factors = [name for name in named if _is_factor(recorded, name)]
    compared = [contrast for name in factors for contrast in _of_covariate(recorded, name, variables)]
    for term in group_terms(formula):
        if term.slope or term.grouping == "subject":
            continue
        if len(term.factors) > 1:
            compared += _of_combinations(recorded, term.factors, known=factors)
        elif term.grouping not in factors:
            with_mass = term.grouping == "trial" and any("mass_kg" in columns for columns in variables)
            compared += _of_group(recorded, term.grouping, at_one_mass=with_mass)
    return compared


def _is_factor(recorded: Recorded, name: str) -> bool:
    if recorded.is_category(name):
        return True
    return name not in _PHYSICAL and recorded.rows[name].nunique() == 2


def _of_covariate(recorded: Recorded, name: str, variables: Iterable[frozenset[str]]) -> Iterator[Contrast]:
    """Levels of a covariate at the reference, or over the recorded values of what interacts with it."""
    levels = {str(label): value for value, label in _values(recorded, name)}
    interacting = sorted({column for columns in variables if name in columns for column in columns} - {name})
    at: list[Condition] = [{}]
    if interacting:
        rows = recorded.rows[interacting].drop_duplicates()
        chosen = np.unique(np.linspace(0, len(rows) - 1, min(len(rows), _MOST_AVERAGED)).astype(int))
        at = [{str(k): v for k, v in row.items()} for row in rows.iloc[chosen].to_dict("records")]
    for level, against in _pairs(list(levels)):
        yield Contrast(
            name,
            level,
            against,
            tuple({**condition, name: levels[level]} for condition in at),
            tuple(
                {**condition, name: levels[other_level]}
                for other_level in _meant(against, levels)
                for condition in at
            ),
        )


def _of_group(recorded: Recorded, name: str, *, at_one_mass: bool) -> Iterator[Contrast]:
    levels = recorded.levels(name)
    for comparable in _of_equal_mass(recorded, name) if at_one_mass else [levels]:
        for level, against in _pairs(comparable) if len(comparable) <= _MOST_LEVELS else ():
            others = tuple({name: other_level} for other_level in _meant(against, comparable))
            yield Contrast(name, level, against, ({name: level},), others)


def _of_equal_mass(recorded: Recorded, name: str) -> list[list[str]]:
    """Levels in which the impactor has one mass, those of the same mass together."""
    logs = np.log(recorded.rows["mass_kg"]).groupby(labels_of(recorded.rows[name]), sort=False)
    at = logs.median()[logs.max() - logs.min() < _SAME_MASS].sort_values(kind="stable")
    group = (at.diff() > _SAME_MASS).cumsum()
    # A condition with several masses stands for none.
    mixed = [str(label) for label in logs.median().index if label not in at.index]
    return [*([str(label) for label in rows.index] for _, rows in at.groupby(group)), mixed]


def _of_combinations(
    recorded: Recorded, factors: tuple[str, ...], known: Sequence[str]
) -> Iterator[Contrast]:
    """Combinations that differ in one column but the person, each, and averaged over all that are alike.

    The average is left to the covariate where the column is ``known`` as one.
    """
    labels = [labels_of(recorded.rows[name]) for name in factors]
    combos = list(dict.fromkeys(zip(*labels, strict=True)))
    if len(combos) > _MOST_LEVELS:
        return
    for position, name in enumerate(factors):
        if name == "subject":
            continue
        levels_at: dict[tuple[str, ...], list[str]] = defaultdict(list)
        for combo in combos:
            levels_at[(*combo[:position], *combo[position + 1 :])].append(combo[position])
        single: dict[tuple[str, str], list[Contrast]] = defaultdict(list)
        for others, levels in levels_at.items():
            for level, against in combinations(_ordered(levels), 2):
                a, b = ((*others[:position], value, *others[position:]) for value in (level, against))
                upper, lower = (dict(zip(factors, values, strict=True)) for values in (a, b))
                one = Contrast(":".join(factors), ":".join(a), ":".join(b), (upper,), (lower,))
                single[(level, against)].append(one)
        for (level, against), pairs in single.items():
            if len(pairs) > 1 and name not in known:
                upper_all, lower_all = (tuple(c.upper[0] for c in pairs), tuple(c.lower[0] for c in pairs))
                yield Contrast(name, level, against, upper_all, lower_all)
        yield from (pair for pairs in single.values() for pair in pairs)


def _values(recorded: Recorded, name: str) -> Iterator[tuple[str | float, str]]:
    """The values of a column with what they are called."""
    column = recorded.rows[name]
    first = ~column.duplicated()
    for value, label in zip(column[first], labels_of(column[first]), strict=True):
        yield (float(value) if recorded.is_number(name) else str(value)), label


def _pairs(levels: Sequence[str]) -> Iterator[tuple[str, str]]:
    """Each with each; of many each with all."""
    if len(levels) <= _MOST_IN_PAIRS:
        return combinations(_ordered(levels), 2)
    return ((level, ALL) for level in _ordered(levels))


def _meant(against: str, levels: Iterable[str]) -> list[str]:
    return list(levels) if against == ALL else [against]


def _ordered(levels: Sequence[str]) -> list[str]:
    """By the alphabet; numbers from the greatest on."""
    try:
        return sorted(levels, key=float, reverse=True)
    except ValueError:
        return sorted(levels)


MOST_PEOPLE = 60


def people_compared(draws: xr.Dataset, recorded: Recorded, responses: Sequence[str]) -> pd.DataFrame:
    """Each person against each other, as in ``people.csv``, two rows a pair; none of more than `MOST_PEOPLE`.

    Args:
        draws: the group posterior.
        recorded: what was measured.
        responses: K, C and the further parameters that have a formula; those with an effect of the person
            are compared.

    Returns:
        ``p_greater`` is the probability that the person's is greater, ``ratio`` the posterior median of the
        person's over the other's, ``low`` and ``high`` the ends of its 90 % interval.
    """
    people = recorded.levels("subject")
    first, second = np.triu_indices(len(people), 1)
    tables = []
    for response in responses:
        if SUBJECT not in group_terms(recorded.formulas.get(response)) or not 2 <= len(people) <= MOST_PEOPLE:
            continue
        logs = log_at_levels(draws, recorded, response, [{"subject": name} for name in people])
        logs = logs.reshape(-1, len(people))
        ratio = logs[:, first] - logs[:, second]
        low, median, high = np.exp(np.percentile(ratio, [5, 50, 95], axis=0))
        above = (ratio > 0).mean(axis=0)
        for one, another, values in (
            (first, second, (above, median, low, high)),
            (second, first, (1 - above, 1 / median, 1 / high, 1 / low)),
        ):
            names = {"person": np.array(people)[one], "against": np.array(people)[another]}
            columns = dict(zip(("p_greater", "ratio", "low", "high"), values, strict=True))
            tables.append(pd.DataFrame({"quantity": response, **names, **columns}))
    return joined("people", tables)
