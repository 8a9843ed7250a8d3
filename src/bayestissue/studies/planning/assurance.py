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
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from jaxtyping import Bool, Float

from bayestissue.base.outcome_table import OUTCOMES
from bayestissue.base.result import Say, silent
from bayestissue.base.runtime import in_threads
from bayestissue.inference.answers.evaluation import draws_of
from bayestissue.inference.answers.grammar import Node, parse
from bayestissue.inference.answers.law import Law
from bayestissue.inference.answers.reliability import coefficients
from bayestissue.inference.answers.study import Study
from bayestissue.inference.samplers.sampling import weighted_quantiles
from bayestissue.mechanics.elements import element
from bayestissue.model.hierarchy.design import Design
from bayestissue.model.hierarchy.recorded import Recorded
from bayestissue.model.hierarchy.responses import RESPONSES
from bayestissue.model.hierarchy.specification import ModelSpecification
from bayestissue.studies.planning.design_prior import DesignPrior, Streams, Truths
from bayestissue.studies.planning.information import Information, information
from bayestissue.studies.planning.running import Running
from bayestissue.studies.planning.studies import Arrangement, arrangements, draw_studies
from bayestissue.studies.planning.study_posterior import PlannedSites, Posteriors, posteriors
from bayestissue.studies.planning.tabulated_law import planned_law
from bayestissue.studies.simulation.simulation_file import Simulation, Tissue

PER_STUDY = ("p", "true", "width", "effective")


@dataclass(frozen=True)
class Goal:
    """What a study shall find out.

    Attributes:
        name: what tables call it.
        text: a claim, or an expression, as questions of a finished fit are written.
        width: of an expression, the half width of its 90 % interval that is wanted.
        relative: whether that is of a ratio: (high / low)^1/2 - 1.
    """

    name: str
    text: str
    width: float | None = None
    relative: bool = False

    @cached_property
    def node(self) -> Node:
        """The text as it was read."""
        return parse(self.text)

    @cached_property
    def over_levels(self) -> bool:
        """Whether it is of all levels of something, which are those of each design."""
        return any(quantity.free for quantity in self.node.quantities())


@dataclass(frozen=True, eq=False)
class Assessment:
    """What studies of one design say of one goal.

    Attributes:
        goal: the goal.
        probability: a claim is answered above it, or below one less it.
        table: a row a study: ``p``, the posterior probability of the claim, NaN of an expression; ``true``,
            whether the claim is true of the study's truth; ``width``, half that of the interval, NaN of a
            claim; ``effective``, of the points that the posterior was integrated by, how many count.
    """

    goal: Goal
    probability: float
    table: pd.DataFrame

    @property
    def yes(self) -> Bool[np.ndarray, " study"]:
        """Of each study, whether the claim is answered by yes, or the width reached."""
        if self.goal.width is None:
            return self.table["p"].to_numpy() > self.probability
        return self.table["width"].to_numpy() <= self.goal.width

    @property
    def no(self) -> Bool[np.ndarray, " study"]:
        """Of each study, whether the claim is answered by no."""
        return self.table["p"].to_numpy() < 1 - self.probability

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
        answered, is_width, studies = self.answered, self.goal.width is not None, len(self.table)
        p, true, width = (self.table[name].to_numpy() for name in ("p", "true", "width"))
        # Where all studies agree, the error is that of one more which does not.
        least = 1 / (studies + 2)
        share = float(np.clip(answered, least, 1 - least))
        wrong, p = (self.yes & ~true) | (self.no & true), np.clip(p, 1e-12, 1 - 1e-12)
        bits = -(p * np.log2(p) + (1 - p) * np.log2(1 - p))
        return {
            "studies": studies,
            "answered": answered,
            "se": float(np.sqrt(share * (1 - share) / studies)),
            "yes": float(self.yes.mean()),
            "no": None if is_width else float(self.no.mean()),
            "undecided": 1 - answered,
            "misleads": None if is_width else float(wrong.mean()),
            "true": None if is_width else float(true.mean()),
            "undecided_bits": None if is_width else float(bits.mean()),
            # A time that may never come has no width in some studies.
            "width": _mean(width) if is_width else None,
            "width_q80": _mean(np.quantile(width, [0.8])) if is_width else None,
        }


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
        done, total = 0, len(blocks) * sum(len(arrangement.numbers) for arrangement in self.arranged)
        tables: dict[int, list[list[pd.DataFrame]]] = {}
        progress("assessing designs", 0, total)
        of_blocks = in_threads(lambda item: self._block(*item, goals), work)
        for (arrangement, _), of_designs in zip(work, of_blocks, strict=True):
            for number, of_goals in zip(arrangement.numbers, of_designs, strict=True):
                tables.setdefault(number, []).append(of_goals)
            done += len(arrangement.numbers)
            progress("assessing designs", done, total)
        return [
            [
                Assessment(goal, probability, pd.concat(of_goal, ignore_index=True))
                for goal, of_goal in zip(goals, zip(*tables[number], strict=True), strict=True)
            ]
            for number in sorted(tables)
        ]

    def _block(self, arrangement: Arrangement, block: int, goals: Sequence[Goal]) -> list[list[pd.DataFrame]]:
        """One block of studies of each design of an arrangement, by goal: see `Assessment`."""
        model, design, streams = arrangement.model, arrangement.design, Streams(self.seed, block)
        truths = self.prior.truths(model, design, streams)
        studies = draw_studies(arrangement, truths, streams)
        single = {name: values[:, None] for name, values in truths.hyperparameters.items()}
        start, assessed = model.unconstrained(truths.hyperparameters), []
        for has in arrangement.present:
            present = np.broadcast_to(has, studies.centre.shape[:2])
            sites = PlannedSites(model, arrangement.columns, arrangement.precision, studies.centre, present)
            drawn = posteriors(sites, start)
            # The same people with more or fewer impacts have their mode near.
            start = drawn.mode
            rows = arrangement.rows[has].reset_index(drop=True)
            recorded = replace(design.recorded, rows=rows)
            posterior, truth = (
                self._values(goals, model.draws(design, *drawn_from), recorded, design)
                for drawn_from in ((drawn.hyperparameters, drawn.b), (single, studies.b[:, None]))
            )
            assessed.append(
                [
                    _assessed(goal, drawn, *of_goal)
                    for goal, *of_goal in zip(goals, posterior, truth, strict=True)
                ]
            )
        return assessed

    def _values(
        self, goals: Sequence[Goal], draws: xr.Dataset, recorded: Recorded, design: Design
    ) -> list[Float[np.ndarray, "study draw"]]:
        """The values of each goal, 1 or 0 of a claim.

        Args:
            goals: of which.
            draws: a study in the place of a chain.
            recorded: by this design.
            design: over the rows of all that are like it.
        """
        names = {quantity.name for goal in goals for quantity in goal.node.quantities()}
        if lacking := names - {*map(str, draws.data_vars), *RESPONSES, *OUTCOMES}:
            of_responses = coefficients(draws, recorded, self.information.measurement_sd)
            added = {f"{c.name}_{c.quantity}": c.drawn for c in of_responses}
            draws = draws.assign({name: (("chain", "draw"), added[name]) for name in lacking & set(added)})
        of_design, of_all = (Study(draws, rows, self.law) for rows in (recorded, design.recorded))
        values = (draws_of(goal.node, of_design if goal.over_levels else of_all) for goal in goals)
        return [one.transpose("chain", "draw").to_numpy().astype(float) for one in values]


def _assessed(
    goal: Goal,
    posterior: Posteriors,
    values: Float[np.ndarray, "study draw"],
    true: Float[np.ndarray, "study draw"],
) -> pd.DataFrame:
    """Of the values of a goal by the posterior and in truth, which has one draw."""
    p = width = np.full(len(values), np.nan)
    # A time that never comes in some draws has no mean, nor need it have a width.
    with np.errstate(invalid="ignore"):
        if goal.width is None:
            p = (values * posterior.weight).sum(axis=1)
        else:
            low, high = weighted_quantiles(values, posterior.weight, [0.05, 0.95])
            width = np.sqrt(high / low) - 1 if goal.relative else (high - low) / 2
    columns = p, true[:, 0] > 0.5, width, posterior.effective
    return pd.DataFrame(dict(zip(PER_STUDY, columns, strict=True)))


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
        running: a study that has begun: each design is then what is still to come, and ``prior`` has draws of
            its fit.

    Raises:
        InputError: a formula asks for what a design can't identify, or the recorder's traces are no data
            for this analysis.
    """
    recorded = running or Running()
    designs = [recorded.followed_by(design)[list(design)] for design in designs]
    rows = pd.concat([*designs], ignore_index=True)
    reference = specification.reference_mass_kg or float(np.exp(np.log(rows["mass_kg"]).mean()))
    arranged = arrangements(
        designs,
        specification,
        reference_mass_kg=reference,
        relative_mass_sd=simulation.recording.relative_mass_sd,
    )
    truths = prior.truths(arranged[0].model, arranged[0].design, Streams(seed, 0))
    tissue = typical_tissue(truths, arranged[0].design, specification.element)
    known = information(rows, specification, tissue, simulation, seed)
    with_traces = [arrangement.with_traces(known, recorded) for arrangement in arranged]
    law = planned_law(specification, simulation.gravity)
    return Planner(with_traces, known, prior, seed, law)


def typical_tissue(truths: Truths, design: Design, of_element: str) -> Tissue:
    """A person at the median of all truths, at the reference mass; between people all that truths differ by.

    Args:
        truths: of some studies.
        design: of their formulas.
        of_element: what the impactor meets; its further parameters are typical.
    """
    stated: dict[str, Any] = {}
    for q, stem in {"K": "K_N_per_m", "C": "C_N_s_per_m"}.items():
        terms = design.recorded.response(q).terms.groups
        names = [*(term.sd(q) for term in terms if not term.slope), f"sd_impact_{q}"]
        within = np.sum([np.mean(sd**2) for name, sd in truths.hyperparameters.items() if name in names])
        level = truths.fixed[f"intercept_{q}"]
        exponent = truths.fixed.get(f"mass_exponent_{q}", np.zeros(1))
        stated |= {
            stem: np.exp(np.median(level)),
            f"sd_subject_{q}": np.sqrt(level.var() + within),
            f"mass_exponent_{q}": np.median(exponent),
        }
    parameters = {parameter.name: parameter.typical for parameter in element(of_element).extra}
    return Tissue(
        **stated, reference_mass_kg=design.reference_mass_kg, element=of_element, parameters=parameters
    )
