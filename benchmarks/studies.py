"""What simulated studies share: they are fitted, their intervals held against the truth, their rows kept."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import xarray as xr
from evidence import measure
from evidence.families.outcomes import LEVEL, shares
from evidence.simulations import tables

import bayestissue as bt
from bayestissue.base import runtime
from bayestissue.inference.fit import sample
from bayestissue.inference.quantities.quantity_draws import Draws, posterior_draws, predicted, quantities
from bayestissue.inference.results.labels import design_variables, labelled
from bayestissue.inference.single.phantoms import prepare_without_phantoms
from bayestissue.model.hierarchy.specification import (
    SIDE_BY_SIDE,
    ModelSpecification,
    Sampler,
    read_specification,
)
from bayestissue.model.hierarchy.trace_data import Prepared, assemble, prepare
from bayestissue.recordings.dataset import Dataset
from bayestissue.recordings.signal import displacements
from bayestissue.recordings.signal.displacement import Displacements
from bayestissue.studies.fitting import resolve

ROOT = Path(__file__).parents[1]
CHAIN, SAMPLER = tables(__file__)["chain"], tables(__file__)["sampler"]
# Of each chain: about as many as are effective, whose quantities are made sooner than those of all.
KEPT = SAMPLER["draws"]
# Know an end of an interval to one or two hundredths of probability.
FEW_DRAWS = Sampler(draws=KEPT, effective=SAMPLER["effective"])
LENGTHS = (64, 96, 128, 192, 256, 384, 512, 768)
# Of K and C, as names of columns end.
UNITS = {"K": "N_per_m", "C": "N_s_per_m"}
QUANTILES = {"q05": 0.05, "q25": 0.25, "q50": 0.5, "q75": 0.75, "q95": 0.95}


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


def model_of(name: str) -> ModelSpecification:
    """The model file of a likelihood or of an element."""
    file = "impact" if name == SIDE_BY_SIDE else name
    return read_specification(ROOT / "models" / f"{file}.toml")


def fitted(dataset: bt.Dataset, seed: int, model: Mapping[str, Any] | None = None) -> Fitted:
    """The posterior of a study by a model, or by that of what was recorded."""
    specification, source = resolve(model, dataset.quantity)
    sampler = specification.sampler.model_copy(update=SAMPLER)
    _, prepared = prepare_without_phantoms(dataset, specification, source=source)
    chains = sample(prepared, sampler, seed)
    draws = posterior_draws(prepared, chains.thinned(sampler.draws), seed)
    return Fitted(prepared, of_draws(prepared, draws, seed), chains.verdict.passed)


class Fits:
    """The fits of one model file to data sets of one design, their traces filled up to ``least`` samples."""

    def __init__(self, specification: ModelSpecification, dataset: Dataset, least: int = 0) -> None:
        self._specification, self._least = specification, least
        self._design = prepare(dataset, specification, source="the model file").design

    def prepared(self, dataset: Dataset) -> Prepared:
        """Its data, be its traces as short as they may."""
        signal = filled_up(displacements(dataset, self._specification.signal), self._least)
        return assemble(dataset, self._specification, self._design, signal)

    def fit(self, prepared: Prepared, seed: int) -> tuple[Draws, bool]:
        """Draws of everything, and whether the chains passed."""
        # What is compiled for many shapes takes more mapped memory than a process may have.
        runtime.release_compiled()
        sampler = self._specification.sampler
        chains = sample(prepared, sampler, seed)
        kept = chains.thinned(min(KEPT, sampler.draws))
        return posterior_draws(prepared, kept, seed), chains.verdict.passed


def filled_up(signal: Displacements, least: int = 0) -> Displacements:
    """The same with zeros past the ends, up to one of a few lengths: what is compiled serves most of them."""
    samples = signal.x.shape[1]
    more = next((length for length in LENGTHS if length >= max(samples, least)), samples) - samples
    by_sample = ("x", "v", "value", "sample_number", "clipped")
    rows = {name: np.pad(getattr(signal, name), ((0, 0), (0, more))) for name in by_sample}
    return replace(signal, **rows)


def of_draws(prepared: Prepared, draws: Draws, seed: int) -> xr.Dataset:
    """All quantities of a posterior or a prior, labelled."""
    values = quantities(prepared, draws, np.random.default_rng(seed))
    names = {"impact": prepared.impacts["impact"].tolist(), **prepared.design.levels()}
    return labelled(values, names, design_variables(prepared.design))


def decelerations(prepared: Prepared) -> np.ndarray:
    """Recorded decelerations [impact, sample], NaN outside the contact."""
    signal = prepared.signal
    inside = np.arange(signal.x.shape[1]) < signal.n_samples[:, None]
    return np.where(inside, signal.deceleration, np.nan)


def residuals_of(prepared: Prepared, draws: Draws, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """`decelerations`, and replicated ones [draw, ...]."""
    recorded, replicated = decelerations(prepared), predicted(prepared, draws, seed)["deceleration"]
    return recorded, replicated.astype(float).reshape(-1, *recorded.shape)


def rows_of(quantities: Mapping[str, tuple[np.ndarray, Any]]) -> pd.DataFrame:
    """A row a quantity and impact, of draws [chain, draw, impact] or [chain, draw] and the truth [impact]."""
    parts = []
    for name, (draws, truth) in quantities.items():
        flat = draws.reshape(draws.shape[0] * draws.shape[1], -1).astype(float)
        quantiles = np.quantile(flat, list(QUANTILES.values()), axis=0)
        columns = {"truth": truth, "mean": flat.mean(0), "sd": flat.std(0, ddof=1)}
        columns |= dict(zip(QUANTILES, quantiles, strict=True))
        parts.append(pd.DataFrame({"quantity": name} | columns))
    return pd.concat(parts, ignore_index=True)


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


def held(truth: pd.DataFrame, found: pd.DataFrame, q: str) -> np.ndarray:
    """Of each impact whether its interval by `estimate` holds K or C."""
    low, high = (found[f"{q}_{end}_{UNITS[q]}"].to_numpy() for end in ("low", "high"))
    return truth[f"{q}_{UNITS[q]}"].between(low, high).to_numpy()


def counted(name: str, row_of: Callable[[int], dict[str, Any]], studies: int) -> pd.DataFrame:
    """Do studies that the piece ``name`` of the evidence lacks, and print the shares so far.

    Args:
        name: of the piece.
        row_of: of a study's number what is kept of it.
        studies: in all, unless the command line says how many after the first word.
    """

    def released(number: int) -> dict[str, Any]:
        # What is compiled for many shapes takes more mapped memory than a process may have.
        runtime.release_compiled()
        return row_of(number)

    rows = measure(name, range(int(sys.argv[2]) if len(sys.argv) > 2 else studies), released)
    print(shares(rows).to_string(float_format="{:.3f}".format))
    others = rows.loc[:, [column for column in rows if "|" not in column and column != "unit"]]
    print(others.mean(numeric_only=True).to_string(float_format="{:.3f}".format))  # type: ignore[attr-defined]
    return rows
