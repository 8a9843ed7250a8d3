"""How much a page shows, and from when on its sentences say something."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Limits:
    """What fits on a page that loads at once and can be read.

    Attributes:
        samples: of all curves of a page of recordings together: some 2 MB of it.
        panels: recordings in one figure, four rows of three.
        impacts_drawn: points of a figure of impacts; more hide each other.
        impacts_tested: impacts whose residuals are held against replicates, of which each has all draws.
        curve: points of a curve over the mass, which then looks smooth.
        comparisons: on the first screen, where a third leaves no room for the other answers.
        sides: levels of a factor in a figure of pairs.
        categories: levels whose K and C a card lists.
        lines: of a figure of designs; of more the eye finds none again.
        loops: of recorded impacts in a figure; more make one grey of them.
        loop_samples: of each of these, which then looks smooth.
        same_motion: difference of the log of mass or velocity up to which an impact belongs to a motion.
        rows: of a table; the file has all.
        steps: of a recording's median, above 0 and below, and of what is beside it, finer than a pixel.
    """

    samples: int = 60_000
    panels: int = 12
    impacts_drawn: int = 1000
    impacts_tested: int = 250
    curve: int = 60
    comparisons: int = 2
    sides: int = 6
    categories: int = 4
    lines: int = 6
    loops: int = 60
    loop_samples: int = 60
    same_motion: float = 0.05
    rows: int = 300
    steps: tuple[int, int] = (1_000, 150)


@dataclass(frozen=True)
class Worth:
    """When something is worth a word.

    Attributes:
        masses: ratio of the greatest to the least mass from which on mass varies: balances differ by less.
        slope: of point estimates, off zero, from which on a trend of theirs is called the method's making.
        correction: of an error, in its standard deviations before the fit: the greatest of even 10,000 normal
            errors is seldom beyond.
        source: share of the variance from which on a source of an interval is named.
        share: of a variance below which a part makes nothing of the interval that is worth a number.
        approximation: of the draws' variance, how far off the sum of the sources may be.
    """

    masses: float = 1.01
    slope: float = 0.1
    correction: float = 4.5
    source: float = 0.1
    share: float = 0.01
    approximation: tuple[float, float] = (0.7, 1.4)


LIMITS, WORTH = Limits(), Worth()
