"""The numbers that plans are made with, each with what it was chosen by."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class PlanSettings:
    """How many studies a plan draws beside its designs, and what it takes as telling.

    Attributes:
        block: studies that have random numbers of their own, so that more studies leave the first as they
            are.
        kept_blocks: blocks of studies that are assessed before they are kept: what an interrupted plan loses.
        fewer_studies: of each case beside the chosen design; a gain of 0.1 then has an error of about 0.02.
        more_people: of the case that says what a few more would add.
        many_times: the people of the case that says whether any number would do.
        better_noise: of a recorder that is better; without any noise a trace would tell all.
        shows: standard errors of a gain that is more than chance.
        people: who are simulated in each condition to see what a trace tells.
        calibrated: least and greatest mean of half the squared distance of sites' centres from the truth, by
            their own precision, which is 1 if Gaussian sites can stand for the traces.
        draws: of the posterior of a running study; no question of a plan tells them from more.
    """

    block: int = 100
    kept_blocks: int = 10
    fewer_studies: int = 200
    more_people: int = 10
    many_times: int = 4
    better_noise: float = 0.1
    shows: float = 2.0
    people: int = 12
    calibrated: tuple[float, float] = (0.4, 1.7)
    draws: int = 4000


@dataclass(frozen=True)
class IntegrationSettings:
    """How a study's posterior is integrated: about its mode, by importance sampling.

    Attributes:
        points: of the hyperparameters.
        effects: draws of the effects at each.
        tails: degrees of freedom of the proposal, a multivariate t.
        step: of differences of slopes, by which the curvature is made.
        rounds: of the search for the mode, at most.
        enough: what a step must promise of the log density for another round.
        farthest: from 0 that the search begins, in coordinates whose priors are about 1 wide.
        longest: step of the search along a coordinate.
        least_curved: of the curvature; a direction in which the data tell nothing has its prior's, about 1.
        looked_at: standard deviations from the mode at which the density's sides are looked at.
        most_split: how many times longer or shorter than a normal's a side is taken as.
        wide_every: of the points, one in so many is of the wide part of the proposal.
        wide: how much wider that is: it bounds the weights where the density is longer than it looks.
        studies_at_once: what is made of so many stays in a processor's cache.
        points_at_once: of each of these studies.
    """

    points: int = 128
    effects: int = 4
    tails: float = 7.0
    step: float = 1e-3
    rounds: int = 12
    enough: float = 1e-3
    farthest: float = 4.0
    longest: float = 2.0
    least_curved: float = 0.3
    looked_at: tuple[float, float] = (1.0, 2.2)
    most_split: float = 3.0
    wide_every: int = 4
    wide: float = 2.0
    studies_at_once: int = 5
    points_at_once: int = 16


@dataclass(frozen=True)
class TabulationSettings:
    """How outcomes are tabulated over log K and log C where each would be a motion to solve.

    Attributes:
        side: of a tile of the table: a factor of 55 in K or C.
        points: on each side: as many motions in all as are solved at once.
        tiles: that are held; a motion that is asked about needs a few.
    """

    side: float = 4.0
    points: int = 64
    tiles: int = 256


PLAN, INTEGRATION, TABULATION = PlanSettings(), IntegrationSettings(), TabulationSettings()
