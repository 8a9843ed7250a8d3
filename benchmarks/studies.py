"""Simulated studies one after the other: fitted, their intervals held against the truth, their rows kept.

A script that was stopped goes on.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from evidence import recorded
from evidence.families.outcomes import shares

import bayestissue as bt
from bayestissue.base import runtime
from bayestissue.inference.fit import draws_of_chain, sample
from bayestissue.inference.quantities.quantity_draws import Draws, quantities
from bayestissue.inference.results.labels import labelled
from bayestissue.inference.results.tree import dimensions
from bayestissue.inference.single.phantoms import prepare_without_phantoms
from bayestissue.model.hierarchy.trace_data import Prepared
from bayestissue.studies.fitting import resolve

LEVEL = 0.9
# Of the chains: four of so many draws know an end of an interval to a hundredth of probability.
SAMPLER = {"draws": 250, "effective": 200, "transitions": 4000}


class Fitted(NamedTuple):
    """A fit without the tables and checks of a run, which take as long again.

    Attributes:
        prepared: model and data.
        posterior: all quantities, labelled as in posterior.nc.
        passed: whether the chains did.
    """

    prepared: Prepared
    posterior: xr.Dataset
    passed: bool


class Interval(NamedTuple):
    """Ends and truth of intervals of one kind: ``of`` what, and of which quantity."""

    of: str
    quantity: str
    ends: Any
    truth: Any


def fitted(dataset: bt.Dataset, seed: int, model: Mapping[str, Any] | None = None) -> Fitted:
    """The posterior of a study by a model, or by that of what was recorded."""
    specification, source = resolve(model, dataset.recorded)
    sampler = specification.sampler.model_copy(update=SAMPLER)
    _, prepared = prepare_without_phantoms(dataset, specification, source=source)
    chains = sample(prepared, sampler, seed)
    draws = draws_of_chain(prepared, chains.thinned(sampler.draws), seed)
    return Fitted(prepared, of_draws(prepared, draws, seed), chains.verdict.passed)


def of_draws(prepared: Prepared, draws: Draws, seed: int) -> xr.Dataset:
    """All quantities of a posterior or a prior, labelled."""
    values = quantities(prepared, draws, np.random.default_rng(seed))
    names = {"impact": prepared.impacts["impact"].tolist(), **prepared.design.levels()}
    return labelled(values, dimensions(prepared.design, prepared.data.record.errors), names)


def ends(values: xr.DataArray) -> np.ndarray:
    """The ends [2, ...] of 90 % intervals."""
    tails = [(1 - LEVEL) / 2, (1 + LEVEL) / 2]
    return values.quantile(tails, ("chain", "draw")).transpose("quantile", ...).to_numpy()


def sides(intervals: Iterable[Interval]) -> dict[str, float]:
    """Of each kind and quantity the shares of intervals that lie below and above the truth.

    As `evidence.families.outcomes.shares` takes them.
    """
    row = {}
    for of, quantity, (low, high), truth in intervals:
        row[f"{of}|{quantity}|below"] = float(np.mean(high < truth))
        row[f"{of}|{quantity}|above"] = float(np.mean(low > truth))
    return row


def counted(name: str, row_of: Callable[[int], dict[str, Any]], studies: int) -> None:
    """Do studies that the piece ``name`` of the evidence lacks, and print the shares so far.

    Args:
        name: of the piece.
        row_of: of a study's number what is kept of it.
        studies: in all, unless the command line says how many.
    """
    runtime.configure()
    with recorded(name) as record:
        for number in record.missing(range(int(sys.argv[1]) if len(sys.argv) > 1 else studies)):
            # What is compiled for many shapes takes more mapped memory than a process may have.
            runtime.release_compiled()
            record.add(number, [row_of(number)])
        rows = record.piece.rows()
    print(shares(rows).to_string(float_format="{:.3f}".format))
    others = rows.loc[:, [column for column in rows if "|" not in column and column != "unit"]]
    print(others.mean(numeric_only=True).to_string(float_format="{:.3f}".format))
