"""Which way a fit's draws were made, and why: by sites and a correction, or by the exact path."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from bayestissue.inference.posterior.correction import Correction
from bayestissue.inference.samplers.diagnostics import Check


@dataclass(frozen=True)
class Route:
    """The way of a fit.

    Attributes:
        asked: ``sampler.path`` of the model file: "automatic", "summary" or "exact".
        correction: of the draws made with sites; None where there are none.
    """

    asked: str
    correction: Correction | None = None

    @property
    def exact(self) -> bool:
        """Whether every trace is in every step: as asked for, or where the correction can't be trusted.

        Weights that are good but leave few effective draws are no reason: the diagnostics say how few.
        """
        if self.asked == "automatic" and self.correction is not None:
            return not (self.correction.trusted or self.correction.lacks_only_draws)
        return self.asked == "exact"

    @property
    def why(self) -> str:
        """The reason, as a clause."""
        if self.correction is None or self.asked == "exact":
            return "as the model file asks"
        failed = ", ".join(check.name for check in self.correction.checks() if not check.passed)
        found = self.correction.words
        if not failed:
            return f"since the correction can be trusted: {found}"
        if not self.exact and self.asked == "automatic":
            return f"since the correction's weights are good, though few draws are effective: {found}"
        if not self.exact:
            return f"as the model file asks, though the correction can't be trusted ({failed}): {found}"
        count = len(self.correction.attempts)
        best = f"; the best of {count} attempts has {found}" if count > 1 else f": {found}"
        return f"since the correction of the short way can't be trusted ({failed}){best}"

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
        return () if self.exact or self.correction is None else self.correction.checks()

    def record(self) -> dict[str, Any]:
        """As it stands in ``run.json`` and ``diagnostics.json``."""
        attempts = () if self.correction is None else self.correction.attempts
        path = "exact" if self.exact else "summary"
        return {"path": path, "asked": self.asked, "words": self.words, "attempts": list(attempts)}


def duration(seconds: float) -> str:
    """In seconds, minutes or hours, as many digits as an estimate deserves."""
    for unit, name in ((3600, "h"), (60, "min")):
        if seconds >= 2 * unit:
            return f"{seconds / unit:.0f} {name}"
    return f"{seconds:.0f} s"
