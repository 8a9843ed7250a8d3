"""Ratios of K, C and outcomes between levels: left over right, women over men, one operator over another.

With the expected log of a response at levels (see `bayestissue.model.hierarchy.levels`), the ratio of two is

    r = exp(log q(level) - log q(against)),

and an interaction is a ratio of two such ratios, the difference of differences of the log,

    r = exp((log q(a, b) - log q(a', b)) - (log q(a, b') - log q(a', b'))).

The probability of direction is that of the likelier of r > 1 and r < 1 (Makowski et al. 2019,
doi:10.3389/fpsyg.2019.02767), and the probability of practical equivalence that of |log r| < log(1 + e)
(Kruschke 2018, doi:10.1177/2515245918771304), e being 0.1 unless the model file has another.

Compared are, of each response, by its own formula:

- the levels of each category, of numbers in ``C()``, and of each number with two values;
- two such columns whose interaction ``a:b`` the formula has, and of ``a:b:c`` two at each level of the third:
  the change of the treated over that of the controls, on each side;
- the levels of each group but people, of whom there are many: a question may ask of two;
- of combinations such as ``subject:side`` those that differ in one column but the person, within each person
  and averaged over the people recorded;
- conditions at one mass. Where the formula has the mass, effects of conditions that stand for masses are what
  the mass exponent leaves over, and a ratio of two of them would be read as one of masses.

What any formula compares is compared too in outcomes of the reference impact: peak force, peak depth and
energy absorbed of an impact of reference mass and mean velocity on the K and C of the levels, by the law of
force that was fitted. These three are positive and finite in every draw, so that they have ratios. Where the
law has no closed form, draws are evenly left out as of predictions, which ``note`` says, and comparisons
that would need too many motions, those within people first, have no outcomes: a question may ask of them.

Of more than twelve levels each stands against the mean of all. Of two levels one that is called a reference
(control, placebo, before) stands below; else a category goes over those that follow it in the alphabet, left
over right, and a greater number over a smaller one. What else was one thing in all impacts of the one level
and another in all of the other stands in ``note``: no ratio tells them apart unless the formula has it.
"""

from __future__ import annotations

import math
from collections import ChainMap, defaultdict
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import chain, combinations, product
from typing import NamedTuple

import numpy as np
import pandas as pd
import xarray as xr
from jaxtyping import Float

from bayestissue.base.results.tables import joined
from bayestissue.inference.answers.integration import SETTINGS
from bayestissue.inference.answers.law import MOTION
from bayestissue.inference.answers.study import DRAWN, Study
from bayestissue.inference.checking.findings import ELEMENT_ALONE
from bayestissue.inference.samplers.sampling import interval
from bayestissue.model.hierarchy.columns import not_used
from bayestissue.model.hierarchy.formulas.formula import interactions
from bayestissue.model.hierarchy.recorded import Condition, Recorded, label_of
from bayestissue.recordings.dataset.impact_table import SESSIONS

ALL = "mean of all"
ALSO = "also differs: "
LEVELS, COMBINATIONS, INTERACTION = "levels", "combinations", "interaction"
_TEXT = ["factor", "level", "against", "kind", "note"]
# Numbers that are measured or set, two of which make no factor.
_PHYSICAL = ("mass_kg", "velocity_m_s", "energy_J", "diameter_m")
# What others are held against, whatever the alphabet has.
_REFERENCES = (
    *("control", "controls", "placebo", "sham", "untreated", "healthy", "reference"),
    *("baseline", "before", "pre", "none"),
)

# A condition that can be looked up: its columns and levels.
At = tuple[tuple[str, str], ...]


class LevelPair(NamedTuple):
    """A level of a column over another, or over the mean of all ``others``."""

    column: str
    level: str
    against: str
    others: tuple[str, ...]

    @property
    def weighted(self) -> list[tuple[dict[str, str], float]]:
        """What is given on either side, and its weight."""
        others = [({self.column: against}, -1 / len(self.others)) for against in self.others]
        return [({self.column: self.level}, 1.0), *others]


@dataclass(frozen=True)
class Contrast:
    """A weighted sum of the log at levels.

    Attributes:
        factors: the columns that name it.
        compared: of these the one that differs, of an interaction both.
        shared: the level of each other column, of a combination or of an interaction of three columns; of a
            mean over combinations those of each.
    """

    factors: tuple[str, ...]
    compared: tuple[LevelPair, ...]
    shared: Sequence[Mapping[str, str]] = ({},)

    @property
    def kind(self) -> str:
        """`LEVELS`, `COMBINATIONS` or `INTERACTION`."""
        if len(self.compared) > 1:
            return INTERACTION
        return COMBINATIONS if len(self.factors) > 1 else LEVELS

    @property
    def names(self) -> tuple[str, str, str]:
        """Factor, level and against: ``side``, left, right; ``group:session``, treated:after/before, ..."""
        first, *further = self.compared
        if further:
            ratio = ":".join([f"{further[0].level}/{further[0].against}", *self.shared[0].values()])
            level, against = (f"{one}:{ratio}" for one in (first.level, first.against))
        else:
            sides = ({**self.shared[0], first.column: one} for one in (first.level, first.against))
            level, against = (":".join(side[name] for name in self.factors) for side in sides)
        return ":".join(self.factors), level, against

    @cached_property
    def weighted(self) -> dict[At, float]:
        """Conditions and their weights, which add up to 0."""
        weights: dict[At, float] = defaultdict(float)
        shared = [(at, 1 / len(self.shared)) for at in self.shared]
        for parts in product(shared, *(pair.weighted for pair in self.compared)):
            at = dict(ChainMap(*(dict(part) for part, _ in parts)))
            weights[tuple(sorted(at.items()))] += math.prod(weight for _, weight in parts)
        return dict(weights)


@dataclass(frozen=True, eq=False)
class Contrasts:
    """What the formulas let one compare, and each motion on the compared levels, simulated once."""

    study: Study

    @cached_property
    def of_responses(self) -> dict[str, list[Contrast]]:
        """The contrasts of each response's own formula."""
        recorded = self.study.recorded
        return {response: contrasts_of(recorded, response) for response in recorded.formulas}

    @cached_property
    def all(self) -> list[Contrast]:
        """The contrasts of all formulas, each once."""
        by_name: dict[tuple[str, ...], Contrast] = {}
        for contrast in chain.from_iterable(self.of_responses.values()):
            by_name.setdefault((contrast.kind, *contrast.names), contrast)
        return list(by_name.values())

    @cached_property
    def factors(self) -> dict[str, list[Condition]]:
        """The levels of each column of which a level is one condition, neither people nor what hits."""
        known: dict[str, set[str]] = defaultdict(set)
        for contrast in self.all:
            (pair, *_), single = contrast.compared, not any(contrast.shared)
            if contrast.kind == LEVELS and single and pair.column not in ("trial", *MOTION):
                known[pair.column] |= {pair.level, *pair.others}
        return {
            name: [{name: label} for label in self.study.recorded.levels(name) if label in labels]
            for name, labels in known.items()
        }

    @cached_property
    def in_outcomes(self) -> tuple[list[Contrast], xr.Dataset]:
        """Contrasts, and outcomes of the reference impact in their conditions, [chain, draw, condition].

        None where there is no law, no velocity or nothing to compare.
        """
        compared = self.all
        if not self.study.law.in_closed_form:
            compared = list(_within(compared, SETTINGS.simulated // SETTINGS.of_a_condition))
        return compared, self.study.of_reference_impact(_weights(compared)[0])

    def outcomes_at(self, levels: Sequence[Condition]) -> xr.Dataset:
        """`in_outcomes` of some levels; none where some were not simulated."""
        compared, outcomes = self.in_outcomes
        conditions, _ = _weights(compared)
        if not outcomes or not all(at in conditions for at in levels):
            return xr.Dataset()
        return outcomes.isel(condition=[conditions.index(at) for at in levels])


def contrasts_table(contrasts: Contrasts, equivalence: float) -> pd.DataFrame:
    """Every contrast that the formulas have, a row each: ``contrasts.csv``.

    Args:
        contrasts: of a fit.
        equivalence: e, the relative difference that counts as none in practice.

    Returns:
        Rows of responses, and then of outcomes. ``ratio`` is the median, ``low`` and ``high`` the
        ends of the 90 % equal-tailed interval. Beside a discrepancy ``note`` says of K that it is the
        element's own.
    """
    study, tables = contrasts.study, []
    for response, compared in contrasts.of_responses.items():
        if compared:
            values = study.at([response], _weights(compared)[0])
            tables += _rows(study, compared, values, equivalence)
    table = _by_contrast(tables)
    if study.element_alone:
        of_K = table["quantity"] == "K"
        table.loc[of_K, "note"] = (table["note"] + f"; {ELEMENT_ALONE}").str.removeprefix("; ")[of_K]
    compared, outcomes = contrasts.in_outcomes
    if not outcomes:
        return table
    conditions, weights = _weights(compared)
    motion = study.motion(conditions)
    shared = {name: _shared(motion[name], weights) for name in ("mass_kg", "velocity_m_s")}
    rows = _rows(study, compared, outcomes, equivalence, **shared)
    return pd.concat([table, _by_contrast(rows)], ignore_index=True)


def _rows(
    study: Study, compared: Sequence[Contrast], values: xr.Dataset, equivalence: float, **shared: list[float]
) -> list[pd.DataFrame]:
    """Of each quantity a row a contrast."""
    simulated, (_, weights) = study.simulated_words(values), _weights(compared)
    notes = ["; ".join(filter(None, [note, simulated])) for note in _notes(study.recorded, compared)]
    texts = [(*one.names, one.kind, note) for one, note in zip(compared, notes, strict=True)]
    table = pd.DataFrame(texts, columns=_TEXT).assign(**shared)
    return [
        table.assign(quantity=str(name), **ratio_summary(of_levels, weights, equivalence))
        for name, of_levels in values.items()
    ]


def _by_contrast(tables: Sequence[pd.DataFrame]) -> pd.DataFrame:
    """The quantities of a contrast one below the other."""
    table = joined("contrasts", tables)
    order = table.groupby(_TEXT, sort=False).ngroup()
    return table.iloc[np.argsort(order, kind="stable")].reset_index(drop=True)


def _shared(
    values: Float[np.ndarray, " condition"], weights: Float[np.ndarray, "condition ratio"]
) -> list[float]:
    """Of each contrast what all of its conditions have; NaN where it is what they differ in."""
    chosen = [values[column != 0] for column in weights.T]
    return [float(those[0]) if (those == those[0]).all() else np.nan for those in chosen]


def ratio_summary(
    values: xr.DataArray, weights: Float[np.ndarray, "condition ratio"], equivalence: float
) -> dict[str, np.ndarray]:
    """Median, 90 % interval, probabilities of direction and of practical equivalence of ratios.

    Args:
        values: positive, [chain, draw, condition].
        weights: what the log of each adds to the log of each ratio.
        equivalence: e.
    """
    logs = xr.dot(np.log(values), xr.DataArray(weights, dims=("condition", "ratio")))
    ends = interval(logs)
    directions = [(side > 0).mean(DRAWN).to_numpy() for side in (logs, -logs)]
    return {
        "ratio": np.exp(ends["median"]),
        "low": np.exp(ends["low"]),
        "high": np.exp(ends["high"]),
        "p_direction": np.maximum(*directions),
        "p_equivalent": (np.abs(logs) < np.log1p(equivalence)).mean(DRAWN).to_numpy(),
    }


def _within(compared: Sequence[Contrast], most: int) -> Iterator[Contrast]:
    """The first contrasts that so many conditions serve."""
    known: set[At] = set()
    for contrast in compared:
        needed = known | contrast.weighted.keys()
        if len(needed) <= most:
            known = needed
            yield contrast


def _weights(compared: Sequence[Contrast]) -> tuple[list[Condition], Float[np.ndarray, "condition ratio"]]:
    """The conditions of contrasts, each once, and what each adds to the log of each ratio."""
    conditions = list(dict.fromkeys(chain.from_iterable(contrast.weighted for contrast in compared)))
    row = {at: number for number, at in enumerate(conditions)}
    weights = np.zeros((len(conditions), len(compared)))
    for column, contrast in enumerate(compared):
        weights[[row[at] for at in contrast.weighted], column] = list(contrast.weighted.values())
    return [dict(at) for at in conditions], weights


def contrasts_of(recorded: Recorded, response: str) -> list[Contrast]:
    """What a response's formula lets one compare, covariates first."""
    formula = recorded.response(response)
    # Categories, and numbers with two values that are neither measured nor set.
    numbers = [name for name in formula.covariates if name not in _PHYSICAL]
    two_valued = [name for name in numbers if recorded.rows[name].nunique() == 2]
    factors = [name for name in formula.covariates if name in two_valued or recorded.is_category(name)]
    compared = [one for name in factors for one in _of_levels(name, recorded.levels(name))]
    for names in sorted(interactions(formula.formula), key=len, reverse=True):
        if set(names) <= set(factors):
            compared += _of_interaction(recorded, names)
    for term in formula.terms.groups:
        if term.slope or term.grouping == "subject":
            continue
        if len(term.factors) > 1:
            compared += _of_combinations(recorded, term.factors, known=factors)
        elif term.grouping not in factors:
            of_masses = term.grouping == "trial" and "mass_kg" in formula.covariates
            for levels in _of_equal_mass(recorded) if of_masses else [recorded.levels(term.grouping)]:
                if len(levels) <= SETTINGS.compared:
                    compared += _of_levels(term.grouping, levels)
    return compared


def _pairs(column: str, levels: Sequence[str], most: int = SETTINGS.in_pairs) -> list[LevelPair]:
    """Each level with each; of more than ``most`` each with all."""
    ordered = _ordered(levels)
    if len(ordered) > most:
        return [LevelPair(column, level, ALL, tuple(levels)) for level in ordered]
    return [LevelPair(column, level, against, (against,)) for level, against in combinations(ordered, 2)]


def _of_levels(column: str, levels: Sequence[str]) -> list[Contrast]:
    return [Contrast((column,), (pair,)) for pair in _pairs(column, levels)]


def _of_interaction(recorded: Recorded, names: Sequence[str]) -> Iterator[Contrast]:
    """Ratios of the ratios between levels of one column at the levels of another, at each of a third."""
    levels = {name: recorded.levels(name) for name in names}
    shared: list[dict[str, str]] = [{}]
    if len(names) > 2:
        third = max(names, key=lambda name: _stays(recorded, name))
        shared = [{third: label} for label in _ordered(levels.pop(third))]
    pairs = [_pairs(name, known) for name, known in levels.items()]
    if math.prod(map(len, pairs)) > SETTINGS.compared:
        pairs = [_pairs(name, known, most=0) for name, known in levels.items()]
    if math.prod(map(len, pairs)) * len(shared) <= SETTINGS.compared:
        for compared, at in product(product(*pairs), shared):
            yield Contrast((*levels, *at), compared, [at])


def _stays(recorded: Recorded, name: str) -> tuple[bool, bool, bool]:
    """How likely a column is where one looks, such as the side, and not what is compared.

    What is compared are people, what has a reference level, and sessions, in this order.
    """
    reference = any(level.casefold() in _REFERENCES for level in recorded.levels(name))
    return name not in recorded.followers("subject"), name.lower() not in SESSIONS, not reference


def _of_equal_mass(recorded: Recorded) -> list[list[str]]:
    """Conditions in which the impactor has one mass, those of the same mass together."""
    logs = np.log(recorded.rows["mass_kg"]).groupby(recorded.labels("trial"), sort=False)
    at = logs.median()[logs.max() - logs.min() < SETTINGS.same_mass].sort_values(kind="stable")
    group = (at.diff() > SETTINGS.same_mass).cumsum()
    # A condition with several masses stands for none.
    mixed = [str(label) for label in logs.median().index if label not in at.index]
    return [*([str(label) for label in rows.index] for _, rows in at.groupby(group)), mixed]


def _of_combinations(
    recorded: Recorded, factors: tuple[str, ...], known: Collection[str]
) -> Iterator[Contrast]:
    """Combinations that differ in one column but the person, each, and averaged over all that are alike.

    The average is left to the covariate where the column is ``known`` as one.
    """
    combos = list(dict.fromkeys(zip(*map(recorded.labels, factors), strict=True)))
    for name in factors if len(combos) <= SETTINGS.compared else ():
        if name == "subject":
            continue
        levels_at: dict[At, list[str]] = defaultdict(list)
        for combo in combos:
            others = dict(zip(factors, combo, strict=True))
            level = others.pop(name)
            levels_at[tuple(others.items())].append(level)
        contexts: dict[LevelPair, list[dict[str, str]]] = defaultdict(list)
        for shared, levels in levels_at.items():
            for pair in _pairs(name, levels, most=len(levels)):
                contexts[pair].append(dict(shared))
        for pair, at in contexts.items():
            if len(at) > 1 and name not in known:
                yield Contrast((name,), (pair,), at)
        yield from (Contrast(factors, (pair,), [shared]) for pair, at in contexts.items() for shared in at)


def _ordered(levels: Sequence[str]) -> list[str]:
    """By the alphabet, references last; numbers from the greatest on."""
    try:
        return sorted(levels, key=float, reverse=True)
    except ValueError:
        return sorted(levels, key=lambda level: (level.casefold() in _REFERENCES, level))


def _notes(recorded: Recorded, compared: Sequence[Contrast]) -> list[str]:
    """What else goes with the levels of each contrast; empty of interactions and of means of all."""
    columns = not_used(recorded)

    @cache
    def goes_with(condition: At) -> dict[str, str]:
        """What follows from a condition by the formulas, and what else is one thing in all of its impacts."""
        at = dict(condition)
        follows = {name: value for name, value in recorded.completed(at).items() if name not in at}
        rows = recorded.matching(at)
        values = {name: set(recorded.labels(name)[rows]) for name in columns if name not in at}
        return {name: label_of(value) for name, value in follows.items() if name in recorded.needed} | {
            name: min(labels) for name, labels in values.items() if len(labels) == 1
        }

    def note(contrast: Contrast) -> str:
        if contrast.kind == INTERACTION or contrast.compared[0].against == ALL:
            return ""
        upper, lower = (
            [goes_with(at) for at, weight in contrast.weighted.items() if weight * sign > 0]
            for sign in (1, -1)
        )
        words = []
        for name in upper[0]:
            pairs = {(one.get(name), against.get(name)) for one, against in zip(upper, lower, strict=True)}
            if all(None not in pair and pair[0] != pair[1] for pair in pairs):
                level, against = min(pairs)
                words.append(f"{name} ({level} against {against})" if len(pairs) == 1 else name)
        return f"{ALSO}{', '.join(words)}" if words else ""

    return [note(contrast) for contrast in compared]
