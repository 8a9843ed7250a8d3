"""What a fit of many impacts needs before its chains; `trace_start` for fewer.

The same steps with the same results up to rounding, but block by block over the impacts, and with the people
eliminated one by one from the hierarchy.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import jax.numpy as jnp
import numpy as np

from bayestissue.hierarchy.gaussian.cells import Cells, arrange
from bayestissue.hierarchy.gaussian.conditional import Sites
from bayestissue.hierarchy.trace_data import Prepared
from bayestissue.hierarchy.traces import TraceData, TraceModel, with_normal_errors
from bayestissue.inference.execution.chunks import in_blocks
from bayestissue.inference.factors.grid import (
    LikelihoodGrid,
    cleared_of_last,
    flat_grid,
    integrated_likelihood_grid,
)
from bayestissue.inference.factors.laplace import ConditionalPrior, laplace_sites, weak_prior
from bayestissue.inference.factors.moments import compare, refine, standard_points
from bayestissue.inference.many.correction import expand, rows_of
from bayestissue.inference.many.grid_sum import GridSum, grid_sum_around
from bayestissue.inference.many.population import MarginalMode
from bayestissue.inference.posterior.approximate import FEW, REFINEMENTS, first_guess
from bayestissue.inference.samplers.independence import Spreads
from bayestissue.inference.samplers.sampling import Progress, silent

# Steps from the point estimates, and from where those ended.
ITERATIONS = (30, 15)
EXPANSIONS = 2


@dataclass(frozen=True)
class ManySummarised:
    """All that the sampler needs to know of the traces beforehand.

    Attributes:
        summaries: of the traces.
        cells: the same, laid out for the population, with what they leave out expanded.
        spreads: their posterior mode and covariance.
        profile: what the traces say of theta1, where the model leaves it free.
        surface: what that says of the population.
    """

    summaries: Sites
    cells: Cells
    spreads: Spreads
    profile: LikelihoodGrid | None
    surface: GridSum | None


def summarise_many(prepared: Prepared, *, say: Progress = silent) -> ManySummarised:
    """Sites of the traces and of the population; ``say`` is told how many passes are done."""
    model, data = prepared.model, prepared.data
    passes = 2 + REFINEMENTS + (model.kind == "arma") + EXPANSIONS

    def told(number: int) -> Progress:
        return lambda done, total: say(number * total + done, passes * total)

    layout = arrange(model.locations, data.design, "subject" if model.mass_error == "subject" else None)
    start = first_guess(prepared)
    loose = weak_prior(start)
    summaries = _expanded(model, data, start, loose, ITERATIONS[0], told(0))
    where = MarginalMode.of(model, layout, summaries)
    centre = np.asarray(summaries.centre)
    summaries = _expanded(model, data, centre, where.anchor(), ITERATIONS[1], told(1))
    standard = standard_points(start.shape[1])
    for number in range(REFINEMENTS):
        where = where.given(summaries)
        summaries = _refined(model, data, summaries, where.anchor(), standard, told(2 + number))
    where = where.given(summaries)
    profile, own = None, summaries
    if model.kind == "arma":
        summaries = cleared_of_last(summaries)
        few = standard_points(start.shape[1], FEW)
        profile = _profiled(model, data, summaries, where.anchor(), few, told(2 + REFINEMENTS))
        own = _without_last(summaries)
        where = where.given(own)
        surface = grid_sum_around(profile, where.of_last, where.guess_of_last())
        where = replace(where, surface=surface).given(own)
    for number in range(passes - EXPANSIONS, passes):
        draws = where.draws(len(standard))
        found = expand(
            model, data, summaries, profile, where.cells, where.spread, draws, progress=told(number)
        )
        where = where.corrected(found, own, again=number < passes - 1)
    return ManySummarised(summaries, where.cells, where.spreads(), profile, where.surface)


def _without_last(cleared: Sites) -> Sites:
    return Sites(
        cleared.centre[:, :-1], cleared.slope[:, :-1], cleared.precision[:, :-1, :-1], cleared.log_likelihood
    )


def _expanded(
    model: TraceModel,
    data: TraceData,
    start: np.ndarray,
    anchor: ConditionalPrior,
    iterations: int,
    say: Progress,
) -> Sites:
    def one(part: TraceData, rows: np.ndarray) -> Sites:
        return laplace_sites(model, part, start[rows], _of_rows(anchor, rows), iterations)

    # A uniform error leaves its likelihood flat on top, which no expansion can describe.
    return in_blocks(with_normal_errors(data), one, progress=say)


def _refined(
    model: TraceModel,
    data: TraceData,
    summaries: Sites,
    anchor: ConditionalPrior,
    standard: np.ndarray,
    say: Progress,
) -> Sites:
    def one(part: TraceData, rows: np.ndarray) -> Sites:
        own, given = rows_of(summaries, rows), _of_rows(anchor, rows)
        return refine(own, given, compare(model, part, own, given, standard))

    return in_blocks(data, one, progress=say)


def _profiled(
    model: TraceModel,
    data: TraceData,
    cleared: Sites,
    anchor: ConditionalPrior,
    few: np.ndarray,
    say: Progress,
) -> LikelihoodGrid:
    def one(part: TraceData, rows: np.ndarray) -> np.ndarray:
        own = integrated_likelihood_grid(model, part, rows_of(cleared, rows), _of_rows(anchor, rows), few)
        return np.asarray(own.log_likelihood).T

    table = in_blocks(data, one, progress=say)
    return flat_grid(1)._replace(log_likelihood=jnp.asarray(np.ascontiguousarray(table.T)))


def _of_rows(anchor: ConditionalPrior, rows: np.ndarray) -> ConditionalPrior:
    """That of some impacts, the precision being one of all."""
    return anchor._replace(mean=anchor.mean[rows])
