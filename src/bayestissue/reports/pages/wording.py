"""Numbers in words: as many digits as the interval deserves, and no more."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import islice
from typing import Any, Self

import pandas as pd

from bayestissue.base.declarations import declared, general, sentences
from bayestissue.base.outcome_table import DECLARED, HEADFORM_COLUMNS
from bayestissue.base.words import NOUNS, Words
from bayestissue.inference.results.meanings import COLUMNS, UNITS

# What is predicted of a new impact, by column: its name, the unit it is shown in, and how many per SI unit.
# A console has room for the first of them, a page for all.
PREDICTED = {COLUMNS[q]: (q, UNITS[q], 1.0) for q in UNITS} | {
    column: DECLARED[name].shown for name, column in HEADFORM_COLUMNS.items()
}
FIRST_PREDICTED = dict(islice(PREDICTED.items(), 5))

_LARGE, _NARROW = 1e7, 1e-5

SENTENCES = declared(__package__, "sentences.toml")
said = sentences(__package__)


def nouns_of(record: Mapping[str, Any], unchanged: Iterable[str] = ()) -> Words:
    """What a run's dataset calls people, conditions and impacts; its name and ``unchanged`` stay."""
    return Words(record.get("words", {}), {str(record.get("dataset", "")), *map(str, unchanged)})


def names_in(table: pd.DataFrame, notes: Sequence[str] = ("note",)) -> set[str]:
    """The user's own texts in a table, such as questions, names and levels; ``notes`` are the program's."""
    texts = table.select_dtypes(["object", "string", "category"]).drop(columns=list(notes), errors="ignore")
    return {str(text) for name in texts for text in texts[name].unique()}


def nouns_of_plan(content: Mapping[str, Any]) -> Words:
    """What a plan calls people, conditions and impacts, by the content of ``plan.json``; its names stay."""
    plan = content["plan"]
    named = [plan["name"], plan.get("description", ""), *plan.get("questions", {}).values()]
    named += [name.replace("_", " ") for key in ("questions", "precision") for name in plan.get(key, {})]
    for factor in plan["candidates"].get("factors", []):
        named += [factor["name"], *factor["levels"]]
    named += [recorder["name"] for recorder in plan["candidates"].get("recorders", [])]
    # A goal that is called as the program's noun is called by the plan's: its sentences are full of it.
    nouns = {noun for pair in NOUNS.values() for noun in pair}
    return Words(content.get("words", {}), {name for name in named if name.casefold() not in nouns})


def decimals_of(width: float) -> int:
    """The decimals at which an interval of this ``width`` shows two significant digits; −1 is tens."""
    if not math.isfinite(width) or width <= 0:
        return 3
    return min(1 - math.floor(math.log10(width)), 6)


def number(value: float, decimals: int) -> str:
    """``value`` with ``decimals`` and a true minus sign; "not known" for what isn't a finite number."""
    if not math.isfinite(value):
        return "not known"
    text = f"{round(value, decimals):.0f}" if decimals < 0 else f"{value:.{decimals}f}"
    return text.lstrip("-") if float(text) == 0 else text.replace("-", "−")


def with_error(value: float, error: float, decimals: int = 2) -> str:
    """``value ± error``, its standard error."""
    return f"{number(value, decimals)} ± {number(error, decimals)}"


def half_width(precision: Mapping[str, Any]) -> str:
    """How near a number is to be known: "10 %" of a ``relative`` width, else the ``half_width``."""
    return percent(precision["relative"]) if precision.get("relative") else f"{precision['half_width']:g}"


def significant(value: float, digits: int = 3) -> str:
    """``value`` to ``digits`` significant digits, without an exponent where one can be avoided."""
    if not math.isfinite(value):
        return "not known"
    if value == 0:
        return "0"
    size = math.floor(math.log10(abs(value)))
    if -5 < size < 7:
        return number(value, digits - 1 - size)
    return f"{value:.{digits - 1}e}".replace("-", "−")


def interval(low: float, high: float, decimals: int | None = None) -> str:
    """``low to high`` with digits that suit the interval's width."""
    decimals = decimals_of(high - low) if decimals is None else decimals
    return f"{number(low, decimals)} to {number(high, decimals)}"


@dataclass(frozen=True)
class Spread:
    """A median with its 90 % equal-tailed interval."""

    median: float
    low: float
    high: float

    @classmethod
    def of(cls, row: Mapping[Any, Any], middle: str = "median", factor: float = 1.0) -> Self:
        """That of a row with ``low`` and ``high``, times ``factor``."""
        return cls(*(factor * float(row[name]) for name in (middle, "low", "high")))

    @property
    def decimals(self) -> int:
        """The decimals at which the interval shows two digits of its width."""
        return decimals_of(self.high - self.low)

    @property
    def manifold(self) -> bool:
        """Whether the interval is positive and its ends differ tenfold: each then has digits of its own."""
        return 0 < 10 * self.low < self.high

    @property
    def value(self) -> str:
        """The median in words."""
        return significant(self.median, 2) if self.manifold else number(self.median, self.decimals)

    @property
    def range(self) -> str:
        """The interval in words."""
        if self.manifold:
            return f"{significant(self.low, 2)} to {significant(self.high, 2)}"
        return interval(self.low, self.high, self.decimals)

    @property
    def words(self) -> str:
        """The median, and the interval in brackets."""
        return f"{self.value} ({self.range})"

    @property
    def factor(self) -> float:
        """Half the interval's width on the log scale, as a ratio: 0.1 says "to within 10 %"."""
        return math.sqrt(self.high / self.low) - 1

    def holds(self, value: float) -> bool:
        """Whether ``value`` lies in the interval as it is printed."""
        low, high = (round(end, self.decimals) for end in (self.low, self.high))
        return low <= value <= high


def estimated(median: float, low: float, high: float) -> tuple[str, str, str]:
    """A median and the ends of its interval, as digits that suit the interval's width, without exponents.

    Numbers that are very large, or very near to each other, have four significant digits.
    """
    numbers = (median, low, high)
    finite = [abs(value) for value in numbers if math.isfinite(value)]
    usual = len(finite) == len(numbers) and max(finite) < _LARGE and high - low > _NARROW
    form = partial(number, decimals=decimals_of(high - low)) if usual else partial(significant, digits=4)
    first, second, third = (form(value) if math.isfinite(value) else f"{value:g}" for value in numbers)
    return first, second, third


def percent(ratio: float) -> str:
    """A ratio as a percentage with two significant digits, or none after the point from 10 % on."""
    value = 100 * ratio
    if not math.isfinite(value):
        return "not known"
    if abs(value) < 0.1:
        return "below 0.1\N{NO-BREAK SPACE}%"
    return f"{number(value, 0 if abs(value) >= 9.95 else 1)}\N{NO-BREAK SPACE}%"


def relative(ratio: float) -> str:
    """A relative spread: "±6.3 %", or from a half on, where plus and minus differ, "a factor of 2.7"."""
    if ratio < 0.5:
        return f"±{percent(ratio)}"
    return f"a factor of {significant(1 + ratio, 2)}" if math.isfinite(ratio) else "not known"


def probability(value: float) -> str:
    """A probability estimated from a few thousand draws: nothing finer than a thousandth is claimed."""
    if not math.isfinite(value):
        return "not known"
    if value < 0.001:
        return "below 0.001"
    if value > 0.999:
        return "above 0.999"
    return f"{value:.3f}" if value < 0.01 or value > 0.99 else f"{value:.2f}"


def likelihood_words(value: float) -> str:
    """A probability as a word that ordinary readers take the same way."""
    bounds: dict[str, float] = SENTENCES["likelihood"]
    return next((words for words, bound in bounds.items() if value >= bound), "almost certainly not")


def listed(words: list[str]) -> str:
    """``a``, ``a and b``, or ``a, b and c``."""
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}" if words else ""


def predicted_words(row: Mapping[Any, Any], name: str) -> list[str]:
    """The median of a quantity of `PREDICTED` in a row of predictions, and its interval; empty without."""
    factor = PREDICTED[name][2]
    median, low, high = (
        "never" if math.isinf(value := row[f"{name}{end}"]) else significant(factor * value)
        for end in ("", "_low", "_high")
    )
    return [] if math.isnan(row[name]) else [median, f"{low} to {high}"]


def covariate_words(row: Mapping[Any, Any]) -> str:
    """What a row of predictions was given, such as "subject s01, mass_kg 1.2"."""
    excluded = ("new", "draws", "simulated", "note")
    covariates = {
        name: general(value) if isinstance(value, float) else str(value)
        for name, value in row.items()
        if name not in excluded and not str(name).startswith(tuple(PREDICTED))
    }
    return ", ".join(f"{name} {text}" for name, text in covariates.items() if text != "nan")
