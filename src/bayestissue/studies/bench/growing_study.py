"""The study so far: the posterior of every person's K and C given all drops, anew with each drop.

A drop is its Gaussian site of log K and log C, as a fit begins with; the population is that of a planned
study, log K = intercept + exponent x log mass + deviation of the person (and side, or whatever text tells
drops of a person apart) + deviation of the impact, and so of log C. It is integrated as a plan integrates it
(`bayestissue.studies.planning.study_posterior`), over a table of people, masses and repeats that is larger
than the study, so that a drop more compiles nothing anew. It is no fit: sites stand for the traces.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from jaxtyping import Float
from scipy.special import stdtr

from bayestissue.base.errors import InputError
from bayestissue.inference.points.notes import PHANTOM
from bayestissue.inference.samplers.sampling import weighted_quantiles
from bayestissue.model.hierarchy.design import build_design
from bayestissue.model.hierarchy.gaussian.arrangement import expected
from bayestissue.model.hierarchy.responses import RESPONSES
from bayestissue.model.hierarchy.trace_data import prepare
from bayestissue.recordings.dataset.impact_table import REFERENCE, RESERVED
from bayestissue.recordings.intake.facts import Cells
from bayestissue.reports.pages.wording import estimated
from bayestissue.studies.bench.campaign_file import WatchedCampaign
from bayestissue.studies.bench.drops import Drop
from bayestissue.studies.fitting import resolve
from bayestissue.studies.init import COUNTS
from bayestissue.studies.one_impact import Impact
from bayestissue.studies.planning.information import told_of_tissue
from bayestissue.studies.planning.study_posterior import PlannedSites, planned_model, posteriors

_FORMULA = "log(mass_kg) + (1|subject)"
# Of people, masses and repeats of each: the table has room for so many, and doubles where they are more.
_ROOM = (32, 4, 4)
# A sound drop is called unlike its person's others once in a hundred.
_ALARM = 0.01
# What is supposed of log K and log C before other people were measured: the scatter of one person's drops,
# which counts as much as so many drops, and the slope on log mass: 0 to 1 where force is a power of depth.
_SCATTER, _WORTH = (0.1, 0.2), 8
_SLOPE, _SLOPE_SD = 0.5, 0.3
_ENDS = (0.05, 0.5, 0.95)


class StudyEstimates(NamedTuple):
    """What the study so far says of a drop and of its person, medians and ends of 90 % intervals.

    Attributes:
        impact: K and C of the drop.
        person: K and C of its person (and side) by this mass.
        width: of the person's K: (high / low)^1/2 - 1.
    """

    impact: dict[str, list[float]]
    person: dict[str, list[float]]
    width: float


@dataclass(frozen=True, eq=False)
class _Posterior:
    """Draws of X b of every level and mass, and of the covariance of an impact about it.

    Attributes:
        cells: which cell each person has with each mass, hit by it or not.
        mean: of log K and log C [draw, cell, 2].
        covariance: of an impact about it.
        weight: of each draw.
    """

    cells: dict[tuple[tuple[str, ...], float], int]
    mean: Float[np.ndarray, "draw cell 2"]
    covariance: Float[np.ndarray, "draw 2 2"]
    weight: Float[np.ndarray, " draw"]

    def expected(self, cells: Cells) -> Float[np.ndarray, "draw 2"] | None:
        """X b of a drop's person and mass; None of those that the study did not have."""
        cell = self.cells.get((level(cells), float(cells["mass_kg"])))
        return None if cell is None else self.mean[:, cell]


def level(cells: Cells) -> tuple[str, ...]:
    """The person of a drop, with the side and whatever other text tells drops of a person apart."""
    others = (str(v) for k, v in cells.items() if k not in (*RESERVED, *COUNTS) and isinstance(v, str))
    return str(cells["subject"]), *others


class GrowingStudy:
    """The study so far.

    Attributes:
        drops: how many drops it is of; those of springs and phantoms of known stiffness are in no study.
    """

    def __init__(self, campaign: WatchedCampaign) -> None:
        self.drops = 0
        self._wanted = campaign.wanted.relative_width
        self._mass_sd = campaign.settings.uncertainty.relative_mass_sd
        model, _ = resolve("impact", formulas={"K": _FORMULA, "C": _FORMULA})
        self._model = model
        self._alone = model.alone()
        self._posterior: _Posterior | None = None
        self._compiled: set[tuple[int, ...]] = set()
        self._latest: Callable[[], None] | None = None
        self._lock = threading.Lock()

    def site(self, impact: Impact) -> dict[str, Any]:
        """Centre and precision of log K and log C of a drop; None where its recording tells neither."""
        try:
            prepared = prepare(impact.dataset, self._alone, source="watch")
        except InputError:
            return {"centre": None, "precision": None}
        centre, precision = told_of_tissue(prepared)
        if not (np.isfinite(centre).all() and np.isfinite(precision).all()):
            return {"centre": None, "precision": None}
        return {"centre": centre[0].tolist(), "precision": precision[0].tolist()}

    def update(self, drops: Sequence[Drop], *, wait: bool = False) -> None:
        """Take these drops for the study.

        Where the table has no room for them, a larger one is compiled meanwhile, for some ten seconds, and
        the study stays as it was; or that is waited for.
        """
        drops = [drop for drop in drops if not drop.of_phantom]
        usable = [drop for drop in drops if drop.precision is not None]
        names = ["level", "mass_kg"]
        hit = pd.DataFrame(
            [(level(drop.cells), float(drop.cells["mass_kg"])) for drop in usable], columns=names
        )
        # Of each drop its person, its mass, and how many of both came before.
        numbers = [hit.groupby(name, sort=False).ngroup() for name in names]
        numbers.append(hit.groupby(names, sort=False).cumcount())
        needed = [int(codes.max()) + 1 if len(hit) else 0 for codes in numbers]
        room = tuple(_doubled(least, number) for least, number in zip(_ROOM, needed, strict=True))
        sites = [(drop.centre, drop.precision) for drop in usable]

        def work() -> None:
            with self._lock:
                if self._latest is not work:
                    # A later one has these drops too: none waits for what nobody will see.
                    return
                self._posterior = self._integrated(hit, np.array(numbers, int), room, sites)
                self.drops = len(drops)
                self._compiled.add(room)

        self._latest = work
        if wait or room in self._compiled:
            work()
        else:
            threading.Thread(target=work, daemon=True).start()

    def _integrated(
        self, hit: pd.DataFrame, codes: np.ndarray, room: tuple[int, ...], sites: Sequence[tuple[Any, Any]]
    ) -> _Posterior:
        people, masses = (hit[name].unique().tolist() for name in hit)
        reference = float(np.exp(np.mean(np.log(masses or [1.0]))))
        # Masses that nobody was hit by have rows without a drop.
        spare = reference * (2.0 + np.arange(room[1]))
        of_slot = [*masses, *[m for m in spare if m not in masses][: room[1] - len(masses)]]
        table = pd.DataFrame(
            [(f"p{p}", f"t{m}", of_slot[m]) for p, m, _ in product(*map(range, room))],
            columns=["subject", "trial", "mass_kg"],
        ).assign(velocity_m_s=1.0)
        design = build_design(self._model.formula, table, reference_mass_kg=reference, source="watch")
        model, columns = planned_model(self._model, design, self._mass_sd)
        at = np.ravel_multi_index(codes, room)
        centre, precision = np.zeros((1, len(table), 2)), np.tile(np.eye(2), (len(table), 1, 1))
        present = np.zeros((1, len(table)), bool)
        if len(at):
            centre[0, at], precision[at] = (np.array(part) for part in zip(*sites, strict=True))
        present[0, at] = True
        start = {name: np.array([0.0 if "correlation" in name else 0.1]) for name in model.hyperparameters}
        drawn = posteriors(
            PlannedSites(model, columns, precision, centre, present), model.unconstrained(start)
        )
        values = {name: array[0] for name, array in drawn.hyperparameters.items()}
        pairs = jax.vmap(lambda one: jnp.stack(model.covariances(one).pair))(values)
        KK, KC, CC = np.asarray(pairs).T
        covariance = np.moveaxis(np.array([[KK, KC], [KC, CC]]), -1, 0)
        mean = np.moveaxis(np.asarray(expected(columns, drawn.b[0])), 0, -1)[:, :: room[2]]
        grid = product(enumerate(people), enumerate(masses))
        cells = {(person, mass): p * room[1] + m for (p, person), (m, mass) in grid}
        return _Posterior(cells, mean, covariance, drawn.weight[0])

    def estimates(self, drop: Drop) -> StudyEstimates | None:
        """What the study so far says of a drop; None without its person and mass, or of a phantom."""
        posterior = self._posterior
        mean = None if posterior is None else posterior.expected(drop.cells)
        if posterior is None or mean is None or drop.precision is None or drop.of_phantom:
            return None
        P, D = np.array(drop.precision), np.linalg.inv(posterior.covariance)
        V = np.linalg.inv(P + D)
        at = np.array(drop.centre)
        # u given X b is N(m + V D (X b - m), V): see `bayestissue.model.hierarchy.gaussian.factor`.
        middle = at + np.matvec(V @ D, mean - at)
        standard = np.random.default_rng(3).standard_normal(mean.shape)
        u = middle + np.matvec(np.linalg.cholesky(V), standard)
        impact, person = (
            {q: _quantiles(values[:, k], posterior.weight) for k, q in enumerate(RESPONSES)}
            for values in (u, mean)
        )
        _, low, high = person["K"]
        return StudyEstimates(impact, person, float(np.sqrt(high / low) - 1))

    @staticmethod
    def unlike(cells: Cells, site: dict[str, Any], others: Sequence[Drop]) -> str:
        """In which way a drop is unlike what its person's others let expect, in words; empty if it is not.

        Log K and log C each are held to a Student t about the mean of the person's other drops, put to the
        mass of this one. Their scatter is that of other people's drops, with a prior; the person's own can
        make it smaller and not larger, so that wrong drops do not hide each other.
        """
        known = [drop for drop in others if drop.precision is not None and not drop.of_phantom]
        peers = [drop for drop in known if level(drop.cells) == level(cells)]
        if not peers or site["precision"] is None or cells.get(REFERENCE[0]):
            return ""
        people = [drop for drop in known if drop.cells["subject"] != cells["subject"]]
        variance = np.diagonal(np.linalg.inv(np.array(site["precision"])))
        worst = 1.0, ""
        for k, name in enumerate(RESPONSES):
            fits = (_scatter(people, k), _scatter(people + peers, k))
            sd, degrees, exponent, exponent_sd = min(fits)
            y, v, x, _ = _measured(peers, k)
            dx = np.log(float(cells["mass_kg"])) - x
            weight = 1 / (sd**2 + v)
            expected, distance = (np.average(part, weights=weight) for part in (y + exponent * dx, dx))
            total = np.sqrt(sd**2 + variance[k] + 1 / weight.sum() + (exponent_sd * distance) ** 2)
            deviation = site["centre"][k] - expected
            chance = 2 * stdtr(degrees, -abs(deviation) / total)
            direction = "higher" if deviation > 0 else "lower"
            share = abs(np.expm1(deviation))
            said = f"{name} is {share:.0%} {direction} than this person's other drops let expect"
            worst = min(worst, (float(chance), said))
        return worst[1] if worst[0] < _ALARM / len(RESPONSES) else ""

    def words(self, drop: Drop) -> list[str]:
        """What the study so far says of a drop, in words."""
        if drop.of_phantom:
            return [PHANTOM]
        estimates = self.estimates(drop)
        if estimates is None:
            return []
        middle, low, high = estimated(*estimates.impact["K"])
        words = [f"in the study so far K {middle} ({low} to {high}) N/m"]
        wanted = f", wanted {self._wanted:.1%}" if self._wanted else ""
        return [*words, f"its person's K known to {estimates.width:.1%}{wanted}"]


def _measured(drops: Sequence[Drop], k: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[int]]:
    """Log K or log C of drops, its variance by the recording, the log of the mass, and its level's number."""
    number = {name: n for n, name in enumerate(dict.fromkeys(level(drop.cells) for drop in drops))}
    rows = [
        (drop.centre[k], np.linalg.inv(np.array(drop.precision))[k, k], np.log(float(drop.cells["mass_kg"])))
        for drop in drops
        if drop.centre is not None
    ]
    y, v, x = np.array(rows, float).reshape(-1, 3).T
    return y, v, x, [number[level(drop.cells)] for drop in drops]


def _scatter(drops: Sequence[Drop], k: int) -> tuple[float, int, float, float]:
    """Of log K or log C: the scatter of a level's drops about its line, the degrees of freedom, the slope.

    Lines are parallel, each level has its own intercept. The slope on log mass comes with its standard
    deviation.
    """
    y, v, x, of_level = _measured(drops, k)
    prior = _SCATTER[k] ** 2
    weight = prior / (prior + v)
    # Means of levels are taken out; what is left of log mass has the slope.
    levels = np.eye(max(of_level, default=-1) + 1)[of_level]
    averaging = weight[:, None] * levels / np.maximum((weight[:, None] * levels).sum(0), 1e-300)
    x, y = (part - levels @ (averaging.T @ part) for part in (x, y))
    precision = (weight * x**2).sum() / prior + _SLOPE_SD**-2
    slope = ((weight * x * y).sum() / prior + _SLOPE / _SLOPE_SD**2) / precision
    squares = (weight * (y - slope * x) ** 2).sum()
    degrees = _WORTH + len(drops) - levels.shape[1]
    return float(np.sqrt((_WORTH * prior + squares) / degrees)), degrees, float(slope), float(precision**-0.5)


def _quantiles(log_values: np.ndarray, weight: np.ndarray) -> list[float]:
    """Median and ends of the interval."""
    low, middle, high = (
        float(e[0]) for e in weighted_quantiles(np.exp(log_values)[None], weight[None], _ENDS)
    )
    return [middle, low, high]


def _doubled(size: int, number: int) -> int:
    while size < number:
        size *= 2
    return size
