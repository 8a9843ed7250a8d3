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

from collections import defaultdict
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property
from itertools import combinations, product
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from jaxtyping import Float

from bayestissue.base.results.tables import columns_of, joined
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

Weighted = Sequence[tuple[Condition, float]]


@dataclass(frozen=True)
class Contrast:
    """A weighted sum of the log at levels.

    Attributes:
        factors: the columns that name it.
        compared: of these the one that differs, of an interaction both: column, level and against.
        weighted: conditions and their weights, which add up to 0.
        shared: the level of each other column, of a combination or of an interaction of three columns.
    """

    factors: tuple[str, ...]
    compared: tuple[tuple[str, str, str], ...]
    weighted: Weighted
    shared: Mapping[str, str] = field(default_factory=dict)

    @property
    def kind(self) -> str:
        """`LEVELS`, `COMBINATIONS` or `INTERACTION`."""
        if len(self.compared) > 1:
            return INTERACTION
        return COMBINATIONS if self.shared else LEVELS

    @property
    def names(self) -> tuple[str, str, str]:
        """Factor, level and against: ``side``, left, right; ``group:session``, treated:after/before, ..."""
        if self.kind == INTERACTION:
            (_, level, against), (_, upper, lower) = self.compared
            ratio = ":".join([f"{upper}/{lower}", *self.shared.values()])
            return ":".join(self.factors), f"{level}:{ratio}", f"{against}:{ratio}"
        ((column, level, against),) = self.compared
        one, reference = (
            ":".join({**self.shared, column: value}[name] for name in self.factors)
            for value in (level, against)
        )
        return ":".join(self.factors), one, reference


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
        for compared in self.of_responses.values():
            for contrast in compared:
                by_name.setdefault((contrast.kind, *contrast.names), contrast)
        return list(by_name.values())

    @cached_property
    def factors(self) -> dict[str, list[Condition]]:
        """The levels of each column of which a level is one condition, neither people nor what hits."""
        levels: dict[str, dict[Any, Condition]] = defaultdict(dict)
        for contrast in self.all:
            name = contrast.factors[0]
            single = all(list(at) == [name] for at, _ in contrast.weighted)
            if contrast.kind == LEVELS and single and name not in ("trial", *MOTION):
                levels[name] |= {_key(at): at for at, _ in contrast.weighted}
        # In the order of their recordings.
        by_label = {name: {label_of(at[name]): at for at in known.values()} for name, known in levels.items()}
        return {
            name: [known[label] for label in self.study.recorded.levels(name) if label in known]
            for name, known in by_label.items()
        }

    @cached_property
    def in_outcomes(self) -> InOutcomes:
        """All levels' motions in one go."""
        compared = self.all
        if not self.study.law.in_closed_form:
            compared = _within(compared, SETTINGS.simulated // SETTINGS.of_a_condition)
        conditions, weights = _weights(compared)
        return InOutcomes(compared, conditions, weights, self.study.of_reference_impact(conditions))


@dataclass(frozen=True, eq=False)
class InOutcomes:
    """Outcomes of the reference impact on every level that is compared.

    Attributes:
        compared: the contrasts that they serve.
        conditions: those of the contrasts.
        weights: what each adds to the log of each ratio.
        outcomes: [chain, draw, condition]; none where there is no law, no velocity or nothing to compare.
    """

    compared: list[Contrast]
    conditions: list[Condition]
    weights: Float[np.ndarray, "condition ratio"]
    outcomes: xr.Dataset

    def at(self, levels: Sequence[Condition]) -> xr.Dataset:
        """Those of some levels; none where some were not simulated."""
        row_of = {_key(at): row for row, at in enumerate(self.conditions)} if self.outcomes else {}
        keys = [_key(at) for at in levels]
        if not all(key in row_of for key in keys):
            return xr.Dataset()
        return self.outcomes.isel(condition=[row_of[key] for key in keys])


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
            conditions, weights = _weights(compared)
            values = study.at([response], conditions)[response]
            notes = _notes(study.recorded, compared)
            tables.append(_rows(compared, notes, ratio_summary(values, weights, equivalence), response))
    table = _by_contrast(tables)
    if study.element_alone:
        of_K = table["quantity"] == "K"
        table.loc[of_K, "note"] = (table["note"] + f"; {ELEMENT_ALONE}").str.removeprefix("; ")[of_K]
    outcomes = _by_contrast(_outcome_rows(contrasts, equivalence))
    return pd.concat([table, outcomes], ignore_index=True) if len(outcomes) else table


def _rows(
    compared: Sequence[Contrast], notes: Sequence[str], summary: Mapping[str, Any], quantity: str
) -> pd.DataFrame:
    texts = [(*c.names, c.kind, note) for c, note in zip(compared, notes, strict=True)]
    table = pd.DataFrame(texts, columns=_TEXT).assign(quantity=quantity, **summary)
    return table.reindex(columns=columns_of("contrasts"))


def _by_contrast(tables: Sequence[pd.DataFrame]) -> pd.DataFrame:
    """The quantities of a contrast one below the other."""
    table = joined("contrasts", tables)
    order = table.groupby(_TEXT, sort=False).ngroup()
    return table.iloc[np.argsort(order, kind="stable")].reset_index(drop=True)


def _outcome_rows(contrasts: Contrasts, equivalence: float) -> list[pd.DataFrame]:
    """Rows of each of `REFERENCE_OUTCOMES`."""
    study, here = contrasts.study, contrasts.in_outcomes
    if not here.outcomes:
        return []
    simulated = study.simulated_words(here.outcomes)
    notes = ["; ".join(filter(None, [note, simulated])) for note in _notes(study.recorded, here.compared)]
    motion = study.motion(here.conditions)
    shared = {name: _shared(motion[name], here.weights) for name in ("mass_kg", "velocity_m_s")}
    return [
        _rows(here.compared, notes, ratio_summary(values, here.weights, equivalence) | shared, str(name))
        for name, values in here.outcomes.items()
    ]


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


def _within(compared: Sequence[Contrast], most: int) -> list[Contrast]:
    """The first contrasts that so many conditions serve."""
    known: set[Any] = set()
    within = []
    for contrast in compared:
        needed = known | {_key(at) for at, _ in contrast.weighted}
        if len(needed) <= most:
            known = needed
            within.append(contrast)
    return within


def _weights(compared: Sequence[Contrast]) -> tuple[list[Condition], Float[np.ndarray, "condition ratio"]]:
    """The conditions of contrasts, each once, and what each adds to the log of each ratio."""
    conditions = {_key(at): at for contrast in compared for at, _ in contrast.weighted}
    row = {key: number for number, key in enumerate(conditions)}
    weights = np.zeros((len(conditions), len(compared)))
    for column, contrast in enumerate(compared):
        for at, weight in contrast.weighted:
            weights[row[_key(at)], column] += weight
    return list(conditions.values()), weights


def _key(condition: Condition) -> tuple[tuple[str, str | float], ...]:
    return tuple(sorted(condition.items()))


def contrasts_of(recorded: Recorded, response: str) -> list[Contrast]:
    """What a response's formula lets one compare, covariates first."""
    formula = recorded.response(response)
    named = [name for name in formula.covariates if _is_factor(recorded, name)]
    factors = {name: _values(recorded, name) for name in named}
    compared = [one for name, known in factors.items() for one in _of_levels(name, known)]
    for names in sorted(interactions(formula.formula), key=len, reverse=True):
        if set(names) <= set(factors):
            compared += _of_interaction(recorded, names, factors)
    for term in formula.terms.groups:
        if term.slope or term.grouping == "subject":
            continue
        if len(term.factors) > 1:
            compared += _of_combinations(recorded, term.factors, known=factors)
        elif term.grouping not in factors:
            comparable = [recorded.levels(term.grouping)]
            if term.grouping == "trial" and "mass_kg" in formula.covariates:
                comparable = _of_equal_mass(recorded, term.grouping)
            for levels in comparable:
                if len(levels) <= SETTINGS.compared:
                    compared += _of_levels(term.grouping, {level: level for level in levels})
    return compared


def _is_factor(recorded: Recorded, name: str) -> bool:
    two_numbers = name not in _PHYSICAL and recorded.rows[name].nunique() == 2
    return two_numbers or recorded.is_category(name)


def _of_levels(name: str, levels: Mapping[str, str | float]) -> Iterator[Contrast]:
    for level, against in _pairs(list(levels)):
        yield Contrast((name,), ((name, level, against),), _weighted(name, level, against, levels))


def _weighted(name: str, level: str, against: str, levels: Mapping[str, str | float]) -> Weighted:
    """A level less another, or less the mean of all."""
    others = list(levels) if against == ALL else [against]
    return [
        ({name: levels[level]}, 1.0),
        *(({name: levels[reference]}, -1 / len(others)) for reference in others),
    ]


def _times(first: Weighted, second: Weighted) -> Weighted:
    """Conditions of which each has what one of the first and one of the second gives."""
    return [({**at, **further}, w * v) for (at, w), (further, v) in product(first, second)]


def _of_interaction(
    recorded: Recorded, names: Sequence[str], factors: Mapping[str, Mapping[str, str | float]]
) -> Iterator[Contrast]:
    """Ratios of the ratios between levels of one column at the levels of another, at each of a third."""
    third = max(names, key=lambda name: _stays(recorded, name)) if len(names) > 2 else ""
    names = [name for name in names if name != third]
    levels = [factors[name] for name in names]
    at = {label: {third: factors[third][label]} for label in _ordered(list(factors[third]))} if third else {}
    pairs = [list(_pairs(list(known))) for known in levels]
    if len(pairs[0]) * len(pairs[1]) > SETTINGS.compared:
        pairs = [[(level, ALL) for level in _ordered(list(known))] for known in levels]
    if len(pairs[0]) * len(pairs[1]) * max(len(at), 1) > SETTINGS.compared:
        return
    for chosen in product(*pairs):
        first, second = (
            _weighted(name, *pair, known) for name, pair, known in zip(names, chosen, levels, strict=True)
        )
        weighted = _times(first, second)
        compared = tuple((name, *pair) for name, pair in zip(names, chosen, strict=True))
        if not third:
            yield Contrast(tuple(names), compared, weighted)
        for label, level in at.items():
            of_level = _times(weighted, [(level, 1.0)])
            yield Contrast((*names, third), compared, of_level, {third: label})


def _stays(recorded: Recorded, name: str) -> tuple[bool, bool, bool]:
    """How likely a column is where one looks, such as the side, and not what is compared.

    What is compared are people, what has a reference level, and sessions, in this order.
    """
    reference = any(level.casefold() in _REFERENCES for level in recorded.levels(name))
    return name not in recorded.followers("subject"), name.lower() not in SESSIONS, not reference


def _of_equal_mass(recorded: Recorded, name: str) -> list[list[str]]:
    """Levels in which the impactor has one mass, those of the same mass together."""
    logs = np.log(recorded.rows["mass_kg"]).groupby(recorded.labels(name), sort=False)
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
    if len(combos) > SETTINGS.compared:
        return
    for position, name in enumerate(factors):
        if name == "subject":
            continue
        levels_at: dict[tuple[str, ...], list[str]] = defaultdict(list)
        for combo in combos:
            levels_at[(*combo[:position], *combo[position + 1 :])].append(combo[position])
        single: dict[tuple[str, str], list[Contrast]] = defaultdict(list)
        for others, levels in levels_at.items():
            shared = dict(zip([n for n in factors if n != name], others, strict=True))
            for level, against in combinations(_ordered(levels), 2):
                pair = _weighted(name, level, against, {one: one for one in (level, against)})
                weighted = _times([(shared, 1.0)], pair)
                single[(level, against)].append(
                    Contrast(factors, ((name, level, against),), weighted, shared)
                )
        for (level, against), pairs in single.items():
            if len(pairs) > 1 and name not in known:
                averaged = [(at, weight / len(pairs)) for pair in pairs for at, weight in pair.weighted]
                yield Contrast((name,), ((name, level, against),), averaged)
        yield from (pair for pairs in single.values() for pair in pairs)


def _values(recorded: Recorded, name: str) -> dict[str, str | float]:
    """The values of a column by what they are called."""
    kind = float if recorded.is_number(name) else str
    return dict(zip(recorded.labels(name), map(kind, recorded.rows[name]), strict=True))


def _pairs(levels: Sequence[str]) -> Iterator[tuple[str, str]]:
    """Each with each; of many each with all."""
    if len(levels) <= SETTINGS.in_pairs:
        return combinations(_ordered(levels), 2)
    return ((level, ALL) for level in _ordered(levels))


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
    def goes_with(condition: tuple[tuple[str, str | float], ...]) -> dict[str, str]:
        """What follows from a condition by the formulas, and what else is one thing in all of its impacts."""
        at = dict(condition)
        follows = {name: value for name, value in recorded.completed(at).items() if name not in at}
        rows = recorded.matching(at)
        values = {name: set(recorded.labels(name)[rows]) for name in columns if name not in at}
        return {name: label_of(value) for name, value in follows.items() if name in recorded.needed} | {
            name: min(labels) for name, labels in values.items() if len(labels) == 1
        }

    def note(contrast: Contrast) -> str:
        if contrast.kind == INTERACTION or contrast.compared[0][2] == ALL:
            return ""
        upper, lower = (
            [goes_with(tuple(at.items())) for at, weight in contrast.weighted if weight * sign > 0]
            for sign in (1, -1)
        )
        words = []
        for name in upper[0]:
            values = ([labels.get(name) for labels in side] for side in (upper, lower))
            pairs = set(zip(*values, strict=True))
            if any(None in pair or pair[0] == pair[1] for pair in pairs):
                continue
            level, against = min(pairs)
            words.append(f"{name} ({level} against {against})" if len(pairs) == 1 else name)
        return f"{ALSO}{', '.join(words)}" if words else ""

    return [note(contrast) for contrast in compared]
