"""Whether draws of the approximate marginal posterior, weighted by importance ratios, can be used.

And the route of a fit that follows from it: by sites and a correction, or by the exact path, and why.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float

from bayestissue.inference.samplers.diagnostics import Check
from bayestissue.inference.samplers.psis import effective_size, k_threshold, pareto_smoothed

# The greatest of some dozen R-hats stays below 1.01 with so many effective draws: four chains, split in two,
# have R-hat^2 = 1 + 8 x / n with 7 x chi-squared of 7 degrees of freedom, beyond 24.3 in one of 1000.
NEEDED = 1400
# Of runs that keep few draws a share is asked for: their R-hat fails with any weights.
_NEEDED_SHARE = 1 / 3
# In fits of each element to data of its own kind it was 0.73 to 1; it was 0.02 where a ridge of the
# likelihood was taken for a peak.
_LEAST_OF_POINTS = 0.25
# Of fewer one has more than half of anything too often.
_FEW_IMPACTS = 4


def needed_size(number: int) -> float:
    """The effective number of weighted draws from which so many can be kept."""
    return min(NEEDED, _NEEDED_SHARE * number)


@dataclass(frozen=True)
class Correction:
    """Importance weights of draws of the approximate marginal posterior, and whether they can be trusted.

    Attributes:
        weight: Pareto-smoothed, up to a constant.
        pareto_k: of all chains' weights together.
        needed: effective number of draws that the run asks for; see `needed_size`.
        varies: relative variance of each impact's likelihood over its site, where these were compared.
        of_impacts: log of each impact's evidence over its site's, at the draws that were kept.
        attempts: what was tried, this among it, in order: see `Correction.row`.
        steps: of the recipe, in order, and of each why it was refused, if it was.
    """

    weight: Float[np.ndarray, "chain transition"]
    pareto_k: float
    needed: float
    varies: Float[np.ndarray, " impact"] | None = None
    of_impacts: Float[np.ndarray, "draw impact"] | None = None
    attempts: tuple[dict[str, float | None], ...] = ()
    steps: tuple[dict[str, str], ...] = ()

    @classmethod
    def from_log_weights(
        cls,
        log_weight: Float[np.ndarray, "chain transition"],
        number: int,
        varies: Float[np.ndarray, " impact"] | None = None,
    ) -> Correction:
        """From log weights, of which so many draws are to be kept.

        A log weight is minus infinity, or no number, for a draw without weight.
        """
        smoothed, k = pareto_smoothed(log_weight.ravel())
        return cls(np.exp(smoothed).reshape(log_weight.shape), k, needed_size(number), varies)

    @property
    def effective(self) -> float:
        """Effective number of the weighted draws, m^2 / sum 1 / n_c over m chains.

        n_c is a chain's own effective number. Every chain is resampled to as many draws, so that one with
        few effective draws spoils the mean of all.
        """
        sizes = effective_size(self.weight.T)
        return float(len(sizes) ** 2 / (1 / sizes).sum()) if sizes.all() else 0.0

    @property
    def relative(self) -> float:
        """Relative effective sample size: the effective number of weighted draws over their number."""
        return self.effective / self.weight.size

    @property
    def relative_of_points(self) -> float:
        """That of the points at which likelihood and site were compared, the median over the impacts.

        Where it is next to nothing the ratio's mean is that of a point or two, the same for all draws, whose
        weights then do not vary as they should.
        """
        return 1.0 if self.varies is None else float(np.median(1 / (1 + self.varies)))

    @property
    def trusted(self) -> bool:
        """Whether the corrected draws can be used."""
        return all(check.passed for check in self.checks())

    @property
    def rank(self) -> tuple[int, float]:
        """The least of several is the best: how many checks fail, and minus the effective number of draws."""
        return sum(not check.passed for check in self.checks()), -self.effective

    @property
    def lacks_only_draws(self) -> bool:
        """Whether longer chains would pass: each check holds but the one of the effective number."""
        failed = [check for check in self.checks() if not check.passed]
        return len(failed) == 1 and self.effective <= self.needed and self.effective > 0

    @property
    def stands_out(self) -> int | None:
        """The impact that more of the log weights' scatter is of than of all others together, if one is.

        Of two impacts one always is.
        """
        if self.of_impacts is None or self.of_impacts.shape[1] < _FEW_IMPACTS:
            return None
        scatter = np.var(self.of_impacts, axis=0)
        most = int(np.argmax(scatter))
        return most if scatter[most] > 0.5 * scatter.sum() else None

    def row(self) -> dict[str, float | None]:
        """The figures that it is judged by, for the record of a run."""
        return {
            "pareto_k": round(self.pareto_k, 3) if np.isfinite(self.pareto_k) else None,
            "relative_effective_sample_size": round(self.relative, 4),
            "effective_draws": round(self.effective),
            "relative_effective_sample_size_of_points": round(self.relative_of_points, 4),
            "passed": self.trusted,
        }

    @property
    def words(self) -> str:
        """What it leaves, in half a sentence."""
        k = f"{self.pareto_k:.2f}" if np.isfinite(self.pareto_k) else "infinite"
        return (
            f"{self.effective:.0f} effective draws of {self.weight.size} (relative effective sample size "
            f"{self.relative:.1%}), Pareto k {k}"
        )

    def checks(self) -> tuple[Check, ...]:
        """As some of a run's diagnostics."""
        limit, of_points = k_threshold(self.weight.size), self.relative_of_points
        checks = (
            Check.stated("correction", self.pareto_k, limit, part="tail"),
            Check.stated("correction", self.effective, self.needed, part="draws", relative=self.relative),
        )
        if self.varies is None:
            return checks
        return (*checks, Check.stated("correction", of_points, _LEAST_OF_POINTS, part="points"))


@dataclass(frozen=True)
class Route:
    """The way of a fit.

    Attributes:
        asked: ``sampler.path`` of the model file: "automatic", "summary" or "exact".
        correction: of the draws made with sites; None where there are none.
        spoilt: the impact that `Correction.stands_out` is of, by its name; empty where none does.
    """

    requested: str
    correction: Correction | None = None
    spoilt: str = ""

    @property
    def exact(self) -> bool:
        """Whether every trace is in every step: as asked for, or where the correction can't be trusted.

        Weights that are good but leave few effective draws are no reason: the diagnostics say how few.
        """
        if self.requested == "automatic" and self.correction is not None:
            return not (self.correction.trusted or self.correction.lacks_only_draws)
        return self.requested == "exact"

    @property
    def why(self) -> str:
        """The reason, as a clause."""
        if self.correction is None or self.requested == "exact":
            return "as the model file asks"
        failed = ", ".join(check.name for check in self.correction.checks() if not check.passed)
        words = self.correction.words
        if not failed:
            return f"since the correction can be trusted: {words}"
        if not self.exact and self.requested == "automatic":
            return f"since the correction's weights are good, though few draws are effective: {words}"
        if not self.exact:
            return f"as the model file asks, though the correction can't be trusted ({failed}): {words}"
        count = len(self.correction.attempts)
        best = f"; the best of {count} attempts has {words}" if count > 1 else f": {words}"
        named = f". {spoilt_words(self.spoilt)}" if self.spoilt else ""
        return f"since the correction of the short way can't be trusted ({failed}){best}{named}"

    @property
    def words(self) -> str:
        """One sentence for whoever reads the results."""
        if self.exact:
            return f"Sampled by the exact path, every trace in every step, {self.why}."
        attempts = 0 if self.correction is None else len(self.correction.attempts)
        again = f" ({attempts} attempts)" if attempts > 1 else ""
        return (
            f"Sampled with a normal approximation of each trace's likelihood and corrected by importance "
            f"weights{again}, {self.why}."
        )

    def checks(self) -> tuple[Check, ...]:
        """Of the correction, where the draws depend on it."""
        if self.exact or self.correction is None:
            return ()
        checks = self.correction.checks()
        if not self.spoilt:
            return checks
        first = spoilt_words(self.spoilt)
        return tuple(
            check if check.passed else replace(check, next_step=f"{first} {check.next_step}")
            for check in checks
        )

    def record(self) -> dict[str, Any]:
        """As it stands in ``run.json`` and ``diagnostics.json``."""
        tried = self.correction
        return {
            "path": "exact" if self.exact else "summary",
            "asked": self.requested,
            "words": self.words,
            "attempts": [] if tried is None else list(tried.attempts),
            "steps": [] if tried is None else list(tried.steps),
        }


def spoilt_words(impact: str) -> str:
    """What to look at where one impact spoils the weights of all."""
    return (
        f"Most of the weights' scatter is of one impact, {impact}: look at its recording, and leave it out "
        "if it is spoilt."
    )


def duration(seconds: float) -> str:
    """In seconds, minutes or hours, as many digits as an estimate deserves."""
    for unit, name in ((3600, "h"), (60, "min")):
        if seconds >= 2 * unit:
            return f"{seconds / unit:.0f} {name}"
    return f"{seconds:.0f} s"
