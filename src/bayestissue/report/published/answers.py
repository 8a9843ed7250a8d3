"""The three answers of the first screen, in words that follow from the numbers."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from bayestissue.report.published.run import PublishedRun
from bayestissue.report.wording import (
    UNITS,
    decimals_of,
    interval,
    likelihood_words,
    number,
    probability,
    relative,
    significant,
)
from bayestissue.reproduction.conditions import Quantity

QUANTITIES: tuple[Quantity, ...] = ("K", "C")
FIXED, CONSTANT = "fixed stiffness", "constant natural frequency"
# Above this a hypothesis is spoken of as what the data say; below one minus this, as what they rule out.
_SURE = 0.9


@dataclass(frozen=True)
class Spread:
    """A median with its 90 % equal-tailed interval, and the draws they come from."""

    median: float
    low: float
    high: float

    @property
    def decimals(self) -> int:
        """The decimals at which the interval shows two digits of its width."""
        return decimals_of(self.high - self.low)

    @property
    def value(self) -> str:
        """The median in words."""
        return number(self.median, self.decimals)

    @property
    def range(self) -> str:
        """The interval in words."""
        return interval(self.low, self.high, self.decimals)

    @property
    def factor(self) -> float:
        """Half the interval's width on the log scale, as a ratio: 0.1 says "to within 10 %"."""
        return float(np.sqrt(self.high / self.low) - 1)

    def holds(self, value: float) -> bool:
        """Whether ``value`` lies in the interval."""
        return self.low <= value <= self.high


def spread(draws: np.ndarray) -> Spread:
    """Median and 90 % equal-tailed interval of ``draws`` [draw]."""
    low, median, high = np.percentile(draws, [5, 50, 95])
    return Spread(float(median), float(low), float(high))


def typical(run: PublishedRun, quantity: str) -> Spread:
    """``exp(intercept)``: K or C of a typical person at the reference mass, in N/m or N s/m."""
    return spread(np.exp(run.draws(f"intercept_{quantity}")))


def new_person(run: PublishedRun, quantity: str) -> Spread:
    """K or C of a new impact on a new person at the reference mass, in N/m or N s/m."""
    return spread(run.draws(f"{quantity}_new"))


def exponent(run: PublishedRun, quantity: str) -> Spread | None:
    """The slope of log K (or log C) on log mass, or None if the model has none."""
    name = f"mass_exponent_{quantity}"
    return spread(run.draws(name)) if run.has(name) else None


def hypothesis_probability(run: PublishedRun, quantity: str, hypothesis: str) -> float:
    """The posterior probability of one row of `hypotheses.csv`; NaN if it has no such row."""
    table = run.hypotheses
    chosen = table.loc[(table["quantity"] == quantity) & (table["hypothesis"] == hypothesis), "probability"]
    return float(chosen.iloc[0]) if len(chosen) else float("nan")


def natural_frequencies(run: PublishedRun) -> np.ndarray:
    """sqrt(K / M) of a typical person in each condition, posterior median [trial], rad/s."""
    return np.sqrt(np.median(run.draws("K_trial"), axis=0) / run.constant("mass_kg"))


def exponent_words(quantity: str, beta: Spread) -> str:
    """Where the interval of a mass exponent lies among 0 (fixed) and 1 (constant natural frequency)."""
    fixed = "0 (fixed stiffness)" if quantity == "K" else "0 (fixed damping)"
    constant = "1 (constant natural frequency)" if quantity == "K" else "1 (in proportion to mass)"
    holds_fixed, holds_constant = beta.holds(0), beta.holds(1)
    if holds_fixed and holds_constant:
        return f"includes both {fixed} and {constant}"
    if holds_fixed:
        return f"includes {fixed} and excludes {constant}"
    if holds_constant:
        return f"excludes {fixed} and includes {constant}"
    where = "below both" if beta.high < 0 else "above both" if beta.low > 1 else "between"
    return f"excludes {fixed} and {constant}: it lies {where}"


def mass_conclusion(run: PublishedRun) -> str:
    """What the exponent of K says about where its dependence on mass comes from."""
    beta = exponent(run, "K")
    if beta is None:
        return "This model has no mass exponent, so it can't tell where a dependence on mass comes from."
    constant = hypothesis_probability(run, "K", CONSTANT)
    fixed = hypothesis_probability(run, "K", FIXED)
    if constant > _SURE and constant_frequency_finding(run) is not None:
        omega = natural_frequencies(run)
        same = relative(np.sqrt(omega.max() / omega.min()) - 1)
        return (
            f"Made by the method: ωₙ is the same to {same} at every mass, so K = Mωₙ² is only the mass "
            "rescaled. A constant ωₙ means that the fit carried no information on the tissue."
        )
    if constant > _SURE:
        return (
            "K grows in proportion to mass: that is what a method gives whose ωₙ carries no information on "
            "the tissue, since K = Mωₙ²."
        )
    if fixed > _SURE:
        return "K does not depend on mass in practice: the estimates behave as a tissue of fixed stiffness."
    if beta.holds(0) or beta.holds(1):
        return "The data do not decide between a fixed stiffness and a constant natural frequency."
    if beta.high < 0:
        return "K falls as mass grows, which neither a fixed stiffness nor a constant ωₙ explains."
    if beta.low > 1:
        return "K grows faster than the mass, which neither a fixed stiffness nor a constant ωₙ explains."
    return (
        "K grows with mass, but more slowly than K = Mωₙ² with a constant ωₙ would: "
        "neither explanation suffices alone."
    )


def constant_frequency_finding(run: PublishedRun) -> int | None:
    """The row of the audit that finds K/M (or ωₙ) constant, or None if the audit doesn't say so."""
    text = run.audit["what"] + " " + run.audit["explanation"]
    about_ratio = text.str.contains(r"K\s*/\s*M\b|ω_?n|ωₙ|omega_n|natural frequency", flags=re.IGNORECASE)
    says_constant = text.str.contains(
        r"constant|hardly|no information|does not vary|one curve|same", flags=re.IGNORECASE
    )
    found = run.audit.index[about_ratio & says_constant & (run.audit["severity"] == "major")]
    return int(found[0]) if len(found) else None


def doubt_words(run: PublishedRun) -> str:
    """What the audit says of the published figures, to stand after "which the audit"."""
    majors = int((run.audit["severity"] == "major").sum())
    return "doubts" if majors else "has nothing major against"


def frequency_sentence(run: PublishedRun) -> str:
    """How much ωₙ varies over the conditions, beside how much the mass does."""
    omega, mass = natural_frequencies(run), run.constant("mass_kg")
    return (
        f"Over the {len(mass)} conditions the mass varies by a factor of "
        f"{significant(mass.max() / mass.min(), 2)}, ωₙ = √(K/M) of a typical person by one of "
        f"{significant(omega.max() / omega.min(), 3)}, from {significant(omega.min())} to "
        f"{significant(omega.max())} rad/s."
    )


def level_rows(run: PublishedRun) -> list[dict[str, str]]:
    """For K and for C: the typical person's value and interval, and a new person's, as text."""
    return [
        {
            "quantity": quantity,
            "unit": UNITS[quantity],
            "value": typical(run, quantity).value,
            "range": typical(run, quantity).range,
            "new_value": new_person(run, quantity).value,
            "new_range": new_person(run, quantity).range,
        }
        for quantity in QUANTITIES
    ]


def sureness(run: PublishedRun) -> list[dict[str, str]]:
    """For K and for C: the relative half-widths of the intervals and the spreads, as text."""
    return [
        {
            "quantity": quantity,
            "typical": relative(typical(run, quantity).factor),
            "new": relative(new_person(run, quantity).factor),
            **{
                level: relative(np.expm1(np.median(run.draws(f"sd_{level}_{quantity}"))))
                for level in ("subject", "trial", "impact")
                if run.has(f"sd_{level}_{quantity}")
            },
        }
        for quantity in QUANTITIES
    ]


def exponent_rows(run: PublishedRun) -> list[dict[str, str]]:
    """For K and for C: the mass exponent, its interval and what the interval holds, as text."""
    rows = []
    for quantity in QUANTITIES:
        beta = exponent(run, quantity)
        if beta is not None:
            fixed = hypothesis_probability(run, quantity, FIXED)
            constant = hypothesis_probability(run, quantity, CONSTANT)
            rows.append(
                {
                    "quantity": quantity,
                    "value": beta.value,
                    "range": beta.range,
                    "words": exponent_words(quantity, beta),
                    "fixed": probability(fixed),
                    "constant": probability(constant),
                    "fixed_words": likelihood_words(fixed),
                    "constant_words": likelihood_words(constant),
                }
            )
    return rows
