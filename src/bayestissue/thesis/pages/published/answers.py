"""What the first screen says of the published figures, in words that follow from the numbers."""

from __future__ import annotations

import re

import numpy as np

from bayestissue.report.posterior import CONSTANT, FIXED, SURE, exponent, hypothesis_probability
from bayestissue.report.wording import (
    relative,
    significant,
)
from bayestissue.thesis.pages.published.run import PublishedRun


def natural_frequencies(run: PublishedRun) -> np.ndarray:
    """sqrt(K / M) of a typical person in each condition, posterior median [trial], rad/s."""
    return np.sqrt(np.median(run.draws("K_trial"), axis=0) / run.constant("mass_kg"))


def mass_conclusion(run: PublishedRun) -> str:
    """What the exponent of K says about where its dependence on mass comes from."""
    beta = exponent(run, "K")
    if beta is None:
        return "This model has no mass exponent, so it can't tell where a dependence on mass comes from."
    constant = hypothesis_probability(run, "K", CONSTANT)
    fixed = hypothesis_probability(run, "K", FIXED)
    if constant > SURE and constant_frequency_finding(run) is not None:
        omega = natural_frequencies(run)
        same = relative(np.sqrt(omega.max() / omega.min()) - 1)
        return (
            f"Made by the method: ωₙ is the same to {same} at every mass, so K = Mωₙ² is only the mass "
            "rescaled. A constant ωₙ means that the fit carried no information on the tissue."
        )
    if constant > SURE:
        return (
            "K grows in proportion to mass: that is what a method gives whose ωₙ carries no information on "
            "the tissue, since K = Mωₙ²."
        )
    if fixed > SURE:
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
