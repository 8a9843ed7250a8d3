"""The numbers by which causes are compared, each with what it was chosen by."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class CausesSettings:
    """How the probability of a cause is learned, and how strange campaigns are among those of a cause.

    Attributes:
        folds: of the cross-validation by which the classifier's probabilities are calibrated.
        networks: of one fold; each has its own start, which matters where few campaigns are.
        parts: of the campaigns on which the probabilities are learned anew, to see how much they depend on
            the draw.
        hidden: units of the layers of a network.
        passes: over the campaigns in its training.
        least_probability: added to a probability before its logarithm is taken: no finite number of campaigns
            tells a probability from 0.
        neighbours: campaigns to which the mean distance is a campaign's strangeness.
        farthest: standard deviations at which a statistic is cut off there.
        nearest: share of the campaigns, the nearest to what was observed, whose strengths are stated.
    """

    folds: int = 5
    networks: int = 3
    parts: int = 5
    hidden: tuple[int, ...] = (64, 64)
    passes: int = 60
    least_probability: float = 1e-4
    neighbours: int = 10
    farthest: float = 6.0
    nearest: float = 0.02

    @property
    def fewest_complete(self) -> int:
        """Campaigns with all statistics that strangeness needs more than: as many neighbours in each half."""
        return 2 * self.neighbours

    @property
    def fewest_campaigns(self) -> int:
        """Campaigns of a cause, at least: half of them may lack a statistic."""
        return 2 * self.fewest_complete


SETTINGS = CausesSettings()
