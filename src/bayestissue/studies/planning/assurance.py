"""Assurance: how probable it is that a study answers its questions, over all that is believed of the tissue.

Of each study that is drawn the posterior is asked. A claim is answered where its posterior probability is
above ``probability``, yes, or below one less that, no; the answer misleads where the truth that the study was
drawn from is another. An expression is answered where its interval is as narrow as is wanted. Assurance
is the share of studies that are answered (O'Hagan and Stevens 2001, doi:10.1177/0272989X0102100307).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self

import numpy as np
import pandas as pd
import xarray as xr
from jaxtyping import Bool, Float

from bayestissue.base.result import Say, silent
from bayestissue.base.runtime import in_threads
from bayestissue.inference.answers.grammar import Node, parse
from bayestissue.inference.answers.law import Law
from bayestissue.inference.answers.meaning import draws_of
from bayestissue.inference.answers.reliability import coefficients, variances
from bayestissue.inference.answers.study import Study
from bayestissue.inference.samplers.sampling import weighted_quantiles
from bayestissue.mechanics.elements.outcomes import OUTCOMES
from bayestissue.model.hierarchy.recorded import Recorded
from bayestissue.model.hierarchy.responses import RESPONSES
from bayestissue.model.hierarchy.specification import ModelSpecification
from bayestissue.studies.planning.information import Information, TypicalTissue, information
from bayestissue.studies.planning.planned_population import DesignPrior, Streams, Truths
from bayestissue.studies.planning.running import Running
from bayestissue.studies.planning.studies import Arrangement, arrangements, draw_studies
from bayestissue.studies.planning.study_posterior import PlannedSites, Posteriors, posteriors
from bayestissue.studies.planning.tabulated_law import planned_law
from bayestissue.studies.simulation.simulation_file import Simulation

PER_STUDY = {"p": float, "true": bool, "width": float, "effective": float}


@dataclass(frozen=True)
class Goal:
    """What a study shall find out.

    Attributes:
        name: what tables call it.
        text: a claim, or an expression, as questions of a finished fit are written.
        width: of an expression, the half width of its interval that is wanted.
        relative: whether that is of a ratio: (high / low)^1/2 - 1.
        level: of the interval.
    """

    name: str
    text: str
    width: float | None = None
    relative: bool = False
    level: float = 0.9

    @cached_property
    def node(self) -> Node:
        """The text as it was read."""
        return parse(self.text)


@dataclass(frozen=True, eq=False)
class Assessment:
    """What studies of one design say of one goal.

    Attributes:
        goal: the goal.
        probability: a claim is answered above it, or below one less it.
        p: of each study, the posterior probability of the claim; NaN of an expression.
        true: whether the claim is true of the study's truth.
        width: half width of the interval; NaN of a claim.
        effective: of the points that each posterior was integrated by, how many count.
    """

    goal: Goal
    probability: float
    p: Float[np.ndarray, " study"]
    true: Bool[np.ndarray, " study"]
    width: Float[np.ndarray, " study"]
    effective: Float[np.ndarray, " study"]

    @property
    def studies(self) -> int:
        """How many there were."""
        return len(self.p)

    @property
    def yes(self) -> Bool[np.ndarray, " study"]:
        """Of each study, whether the claim is answered by yes, or the width reached."""
        return self.p > self.probability if self.goal.width is None else self.width <= self.goal.width

    @property
    def no(self) -> Bool[np.ndarray, " study"]:
        """Of each study, whether the claim is answered by no."""
        return self.p < 1 - self.probability

    @property
    def answered(self) -> float:
        """The assurance: share of studies that answer."""
        return float((self.yes | self.no).mean())

    def numbers(self) -> dict[str, Any]:
        """What tables say of it; None of what a claim, or an expression, has none of.

        ``answered`` with the Monte Carlo standard error ``se``; ``misleads``, the share of studies with an
        answer that is not true; ``undecided_bits``, the expected entropy of the claim after the study: the
        less, the more the study tells.
        """
        answered, is_width = self.answered, self.goal.width is not None
        # Where all studies agree, the error is that of one more which does not.
        least = 1 / (self.studies + 2)
        share = float(np.clip(answered, least, 1 - least))
        wrong, p = (self.yes & ~self.true) | (self.no & self.true), np.clip(self.p, 1e-12, 1 - 1e-12)
        bits = -(p * np.log2(p) + (1 - p) * np.log2(1 - p))
        return {
            "studies": self.studies,
            "answered": answered,
            "se": float(np.sqrt(share * (1 - share) / self.studies)),
            "yes": float(self.yes.mean()),
            "no": None if is_width else float(self.no.mean()),
            "undecided": 1 - answered,
            "misleads": None if is_width else float(wrong.mean()),
            "true": None if is_width else float(self.true.mean()),
            "undecided_bits": None if is_width else float(bits.mean()),
            # A time that may never come has no width in some studies.
            "width": _mean(self.width) if is_width else None,
            "width_q80": _mean(np.quantile(self.width, [0.8])) if is_width else None,
        }

    @classmethod
    def from_table(cls, goal: Goal, probability: float, table: pd.DataFrame) -> Self:
        """Of a row for each study, as `table` has them."""
        return cls(goal, probability, *(table[name].to_numpy(kind) for name, kind in PER_STUDY.items()))

    def table(self) -> pd.DataFrame:
        """A row for each study, of the columns `PER_STUDY`."""
        return pd.DataFrame({name: getattr(self, name) for name in PER_STUDY})


def _mean(values: Float[np.ndarray, " number"]) -> float | None:
    """The mean; None of what has none."""
    return float(values.mean()) if np.isfinite(values).all() else None


@dataclass(frozen=True, eq=False)
class Planner:
    """Designs that are ready to be assessed.

    Attributes:
        arranged: the designs, those of the same conditions together.
        information: what a trace tells in each condition.
        prior: where each study's truth comes from.
        seed: of all studies.
        law: what outcomes follow.
    """

    arranged: Sequence[Arrangement]
    information: Information
    prior: DesignPrior
    seed: int
    law: Law

    def assess(
        self,
        goals: Sequence[Goal],
        blocks: range,
        *,
        probability: float = 0.95,
        progress: Say = silent,
    ) -> list[list[Assessment]]:
        """Assess every design by every goal.

        Args:
            goals: what the study shall find out.
            blocks: which blocks of `BLOCK` studies; further ones add studies to those that there are.
            probability: a claim is answered above it, or below one less it.
            progress: told how many of all designs and blocks are done.

        Returns:
            By design, in the order in which they were given, and goal.
        """
        work = [(arrangement, block) for arrangement in self.arranged for block in blocks]
        designs = sum(len(arrangement.numbers) for arrangement in self.arranged)
        done, total = 0, designs * len(blocks)
        tables: dict[tuple[int, int], list[pd.DataFrame]] = {}
        progress("assessing designs", 0, total)
        blocks_of = in_threads(lambda item: self._block(*item, goals, probability), work)
        for (arrangement, _), by_design in zip(work, blocks_of, strict=True):
            for number, assessed in zip(arrangement.numbers, by_design, strict=True):
                for goal, one in enumerate(assessed):
                    tables.setdefault((number, goal), []).append(one.table())
                done += 1
            progress("assessing designs", done, total)
        return [
            [
                Assessment.from_table(goal, probability, pd.concat(tables[number, position]))
                for position, goal in enumerate(goals)
            ]
            for number in range(designs)
        ]

    def _block(
        self, arrangement: Arrangement, block: int, goals: Sequence[Goal], probability: float
    ) -> list[list[Assessment]]:
        """One block of studies of each design of an arrangement."""
        model, streams = arrangement.model, Streams(self.seed, block)
        truths = self.prior.truths(model, arrangement.design, streams)
        studies = draw_studies(arrangement, truths, streams)
        single = {name: values[:, None] for name, values in truths.hyperparameters.items()}
        start, assessed = model.unconstrained(truths.hyperparameters), []
        for position in range(len(arrangement.numbers)):
            present = np.broadcast_to(arrangement.present[position], studies.centre.shape[:2])
            sites = PlannedSites(model, arrangement.columns, arrangement.precision, studies.centre, present)
            drawn = posteriors(sites, start)
            # The same people with more or fewer impacts have their mode near.
            start = drawn.mode
            answers = _Answers(arrangement, position, self.information, goals, self.law)
            posterior = answers.dataset(drawn.hyperparameters, drawn.b)
            truth = answers.dataset(single, studies.b[:, None])
            assessed.append(
                [
                    _assessment(
                        goal,
                        probability,
                        drawn,
                        answers.values(goal.node, posterior),
                        answers.values(goal.node, truth),
                    )
                    for goal in goals
                ]
            )
        return assessed


def _assessment(
    goal: Goal,
    probability: float,
    posterior: Posteriors,
    values: Float[np.ndarray, "study draw"],
    true: Float[np.ndarray, "study draw"],
) -> Assessment:
    """Of the values of a goal by the posterior and in truth, which has one draw."""
    none = np.full(len(values), np.nan)
    # A time that never comes in some draws has no mean, nor need it have a width.
    with np.errstate(invalid="ignore"):
        if goal.width is None:
            p, width = (values * posterior.weight).sum(axis=1), none
        else:
            ends = [(1 - goal.level) / 2, (1 + goal.level) / 2]
            low, high = weighted_quantiles(values, posterior.weight, ends)
            p, width = none, np.sqrt(high / low) - 1 if goal.relative else (high - low) / 2
    return Assessment(goal, probability, p, true[:, 0] > 0.5, width, posterior.effective)


@dataclass(frozen=True, eq=False)
class _Answers:
    """One design's draws as questions read them, a study in the place of a chain."""

    arrangement: Arrangement
    position: int
    information: Information
    goals: Sequence[Goal]
    law: Law

    @cached_property
    def _recorded(self) -> Recorded:
        """The rows of this design."""
        rows = self.arrangement.rows[self.arrangement.present[self.position]].reset_index(drop=True)
        return replace(self.arrangement.design.recorded, rows=rows)

    def dataset(
        self, values: dict[str, np.ndarray], b: Float[np.ndarray, "study draw location"]
    ) -> xr.Dataset:
        """What the questions are of, from draws of the hyperparameters and effects."""
        draws = self.arrangement.model.draws(self.arrangement.design, values, b)
        names = {quantity.name for goal in self.goals for quantity in goal.node.quantities()}
        lacking = names - {*map(str, draws.data_vars), *RESPONSES, *OUTCOMES}
        return draws.merge(self._reliability(draws, lacking)) if lacking else draws

    def _reliability(self, draws: xr.Dataset, names: set[str]) -> xr.Dataset:
        """Those of the coefficients of reliability that are named."""
        sd, recorded = self.information.measurement_sd, self._recorded
        of_responses = {q: variances(draws, recorded, q, measurement_sd=sd[q]) for q in RESPONSES}
        of_names = {f"{c.name}_{c.quantity}": c.drawn for c in coefficients(of_responses, draws)}
        return xr.Dataset({name: (("chain", "draw"), of_names[name]) for name in names & set(of_names)})

    def values(self, node: Node, draws: xr.Dataset) -> Float[np.ndarray, "study draw"]:
        """The values of a question in each draw, 1 or 0 of a claim."""
        over_levels = any(quantity.free for quantity in node.quantities())
        recorded = self._recorded if over_levels else self.arrangement.design.recorded
        values = draws_of(node, Study(draws, recorded, self.law))
        return values.transpose("chain", "draw").to_numpy().astype(float)


def planner(
    designs: Sequence[pd.DataFrame],
    specification: ModelSpecification,
    prior: DesignPrior,
    simulation: Simulation,
    *,
    seed: int = 0,
    running: Running | None = None,
) -> Planner:
    """Make designs ready to be assessed.

    Args:
        designs: each one's impacts: ``subject``, ``trial``, ``mass_kg``, ``velocity_m_s`` and factors.
        specification: the analysis.
        prior: of the tissue.
        simulation: whose recording, recorder and gravity are those of the study.
        seed: of all studies.
        running: a study that has begun: each design is then what is still to come, and ``prior`` a
            `RunningPrior`.

    Raises:
        InputError: a formula asks for what a design can't identify, or the recorder's traces are no data
            for this analysis.
    """
    if running is not None:
        designs = [pd.concat([running.rows, design], ignore_index=True)[list(design)] for design in designs]
    rows = pd.concat([*designs], ignore_index=True)
    reference = specification.reference_mass_kg or float(np.exp(np.log(rows["mass_kg"]).mean()))
    arranged = arrangements(
        designs,
        specification,
        reference_mass_kg=reference,
        relative_mass_sd=simulation.recording.relative_mass_sd,
    )
    truths = prior.truths(arranged[0].model, arranged[0].design, Streams(seed, 0))
    tissue = typical_tissue(truths, arranged[0], reference)
    known = information(rows, specification, tissue, simulation, seed)
    with_traces = [arrangement.with_traces(known, running) for arrangement in arranged]
    law = planned_law(specification, simulation.gravity)
    return Planner(with_traces, known, prior, seed, law)


def typical_tissue(truths: Truths, arrangement: Arrangement, reference_mass_kg: float) -> TypicalTissue:
    """Mean and spread of log K and log C over all people of all truths, at the reference mass."""
    sds, fixed = truths.hyperparameters, truths.fixed

    def of_response(q: str) -> tuple[float, float, float]:
        terms = arrangement.design.recorded.response(q).terms.groups
        names = [*(term.sd(q) for term in terms if not term.slope), f"sd_impact_{q}"]
        within = np.sum([np.mean(sds[name] ** 2) for name in names if name in sds])
        level, exponent = fixed[f"intercept_{q}"], fixed.get(f"mass_exponent_{q}", np.zeros(1))
        return float(np.median(level)), float(np.sqrt(level.var() + within)), float(np.median(exponent))

    mean, sd, exponent = zip(*map(of_response, RESPONSES), strict=True)
    return TypicalTissue(mean, sd, exponent, reference_mass_kg)
