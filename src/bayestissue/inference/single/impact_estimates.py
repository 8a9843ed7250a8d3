"""K and C of every impact by itself as a table: `estimates.csv`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from bayestissue.base.errors import Coded, InputError
from bayestissue.base.impact_arrays import MaskPerImpact, PerImpact
from bayestissue.base.outcome_table import DECLARED, INTERVAL_COLUMNS
from bayestissue.base.resources import shared
from bayestissue.base.result import Say, silent
from bayestissue.inference.checking.findings import PEAK_MISSED
from bayestissue.inference.checking.recording_warnings import missed_peaks
from bayestissue.inference.execution.kept import some_of
from bayestissue.inference.points.notes import (
    ANOTHER_PEAK,
    AT_A_LIMIT,
    MOSTLY_UNTOLD,
    NOISELESS,
    STRUCTURED,
    UNCORRECTED,
    UNTOLD,
)
from bayestissue.inference.points.point_estimates import (
    Inspected,
    always_noted,
    another_peak,
    at_a_limit,
    in_rows,
    thesis_table,
)
from bayestissue.inference.samplers.sampling import k_threshold
from bayestissue.inference.single.impact_posterior import (
    POINTS,
    SinglePosteriors,
    single_posteriors,
)
from bayestissue.mechanics.elements.head_injury import LONGEST
from bayestissue.mechanics.oscillator import spring_damper_inverse, to_discrete
from bayestissue.model.hierarchy.design import build_design
from bayestissue.model.hierarchy.specification import read_specification, unsuited
from bayestissue.model.hierarchy.trace_data import Prepared, assemble, facts_of
from bayestissue.recordings.dataset import as_dataset
from bayestissue.recordings.dataset.impact_table import of_phantoms
from bayestissue.recordings.signal import SignalOptions, displacements
from bayestissue.recordings.signal.displacement import FEWEST_SAMPLES
from bayestissue.recordings.signal.quality import inspect

if TYPE_CHECKING:
    import pandas as pd

    from bayestissue.recordings.dataset import Dataset

Method = Literal["impact", "dds"]
# Of the peak: below it the likelihood's own approximations, to first order in the moment of contact, count;
# of displacements rounding.
_LEAST_NOISE = {"impact": 1e-5, "arma": 1e-9}
# The other columns that have a number of a posterior, and which.
_OSCILLATOR_COLUMNS = {
    f"{name}_{ending}{unit}": (name, which)
    for name, unit in (("K", "_N_per_m"), ("C", "_N_s_per_m"))
    for ending, which in (("se", "sd"), ("low", "low"), ("high", "high"))
} | {"omega_n_se_rad_s": ("omega_n", "sd"), "zeta_se": ("zeta", "sd")}
_NOISE_P, _NOISE_SD = "whiteness_p", "noise_sd_m_s2"
_FURTHER = (*_OSCILLATOR_COLUMNS, _NOISE_P, _NOISE_SD, "pareto_k", *INTERVAL_COLUMNS)
# An interval whose ends are this many times apart leaves the order of magnitude open.
_DECADE = 10.0
# A flag may be raised on one sound recording of a thousand, as in
# `bayestissue.recordings.signal.quality.inspect`.
_STRUCTURED_BY_CHANCE = 0.001


def estimate(
    dataset: Dataset | str | Path,
    *,
    method: Method = "impact",
    options: SignalOptions | None = None,
    say: Say | None = None,
) -> pd.DataFrame:
    """The table of `bayestissue.estimate`, whose arguments these are.

    Raises:
        InputError: as of that.
        ValueError: there is no such method.
    """
    if method not in ("impact", "dds"):
        raise ValueError(f'method is "impact" or "dds", not {method!r}')
    dataset = as_dataset(dataset)
    findings = inspect(dataset, options)
    if method == "impact":
        return by_impact(Inspected(dataset, displacements(dataset, options), findings), say=say)[0]
    if problems := unsuited(facts_of(dataset, method=method), "method", "estimate --method dds"):
        raise InputError(problems)
    return thesis_table(Inspected(dataset, displacements(dataset, options, "trapezoidal"), findings))


def by_impact(
    inspected: Inspected, *, say: Say | None = None
) -> tuple[pd.DataFrame, SinglePosteriors | None]:
    """The table of `estimate` by the method "impact", and the posteriors where there are samples enough.

    Impacts of fewer than eight samples have a row without numbers; without any other there are no posteriors.

    Args:
        inspected: the recordings.
        say: as of `estimate`.

    Raises:
        InputError: displacements have uneven times, or a low-pass is declared of them.
    """
    dataset, signal, _ = inspected
    file = shared("models", "arma.toml" if dataset.quantity == "displacement" else "impact.toml")
    specification = read_specification(file).alone()
    if problems := unsuited(facts_of(dataset, **specification.facts), "likelihood", "estimate"):
        raise InputError(problems)
    rows = signal.n_below_limit >= FEWEST_SAMPLES
    noted = always_noted(dataset)
    if not rows.any():
        # Nothing to ask: the same columns without numbers.
        further = [name for name in _FURTHER if dataset.headform or not name.startswith(tuple(LONGEST))]
        return inspected.table({}, {}, noted, dict.fromkeys(further, np.full(len(rows), np.nan))), None
    design = build_design(specification.formula, dataset.impacts, reference_mass_kg=None, source="estimate")
    prepared = some_of(assemble(dataset, specification, design, signal), np.flatnonzero(rows))
    posteriors = single_posteriors(prepared, say or silent)
    estimated = _Estimated(prepared, posteriors)

    def in_table(columns: Mapping[Any, np.ndarray]) -> dict[Any, np.ndarray]:
        """Of all impacts of the dataset."""
        return {name: in_rows(column, rows) for name, column in columns.items()}

    wrong, noted = in_table(estimated.wrong(dataset)), in_table({NOISELESS: estimated.noiseless}) | noted
    table = inspected.table(in_table(estimated.oscillator), wrong, noted, in_table(estimated.further()))
    return table, posteriors


@dataclass(frozen=True)
class _Estimated:
    """Impacts that have posteriors, each by itself, and what is told of them."""

    prepared: Prepared
    posteriors: SinglePosteriors

    @cached_property
    def noiseless(self) -> MaskPerImpact:
        """Whether the noise is no more than what the likelihood itself leaves out."""
        least_noise = _LEAST_NOISE[self.prepared.model.kind] * np.exp(np.asarray(self.prepared.data.log_peak))
        return self.posteriors.quantities["sigma"]["median"] < least_noise

    @cached_property
    def untold(self) -> dict[str, MaskPerImpact]:
        """Where K, or C, is not known: its interval spans a decade, or no mode was found at all.

        Of what follows from either or both likewise, by the names of the oscillator's numbers.
        """
        ends = (self.posteriors.quantities[q] for q in ("K", "C"))
        with np.errstate(all="ignore"):
            wide = (~(of_one["high"] < _DECADE * of_one["low"]) for of_one in ends)
        K, C = ((~self.posteriors.moved | here) & ~self.noiseless for here in wide)
        of_both = dict.fromkeys(("zeta", "phi1", "phi2", "theta1", "sigma_a"), K | C)
        return {"K": K, "C": C, "omega_n": K, **of_both}

    @cached_property
    def oscillator(self) -> dict[str, np.ndarray]:
        """The medians, and the sampled oscillator of this K and C: without what is not told."""
        K, C, sigma = (self.posteriors.quantities[name]["median"] for name in ("K", "C", "sigma"))
        signal = self.prepared.signal
        omega_n, zeta = (np.asarray(values) for values in spring_damper_inverse(K, C, signal.mass))
        phi1, phi2, theta1 = (np.asarray(values) for values in to_discrete(omega_n, zeta, signal.dt))
        values = {"phi1": phi1, "phi2": phi2, "theta1": theta1, "omega_n": omega_n, "zeta": zeta}
        values |= {"K": K, "C": C}
        if self.prepared.model.kind == "arma":
            values |= {"theta1": np.tanh(self.posteriors.parameters[:, 3]), "sigma_a": sigma}
        return {name: np.where(self.untold[name], np.nan, column) for name, column in values.items()}

    def further(self) -> dict[str, np.ndarray]:
        """The further columns: intervals, errors, and what the impacts came to."""
        posteriors, quantities = self.posteriors, self.posteriors.quantities

        def number(name: str, which: str) -> PerImpact:
            untold, bounded = self.untold.get(name, np.array(False)), posteriors.moved & ~self.noiseless
            # What is not told from below has the upper end of its interval as a bound.
            values = (
                np.where(untold, 0.0, quantities[name][which]) if which == "low" else quantities[name][which]
            )
            # Of what was not found, and of intervals that are none, there is no outcome either.
            known = {"sd": ~(untold | self.noiseless), "median": posteriors.moved}.get(which, bounded)
            return np.where(known, values, np.nan)

        columns = {column: number(*source) for column, source in _OSCILLATOR_COLUMNS.items()}
        if posteriors.noise_p is not None:
            columns |= {_NOISE_P: posteriors.noise_p, _NOISE_SD: quantities["sigma"]["median"]}
        columns["pareto_k"] = posteriors.pareto_k
        return columns | {
            column: number(*source) for column, source in INTERVAL_COLUMNS.items() if source[0] in quantities
        }

    def wrong(self, dataset: Dataset) -> dict[Coded, MaskPerImpact]:
        """What the posteriors say is wrong with each impact of these recordings."""
        posteriors, noiseless, oscillator = self.posteriors, self.noiseless, self.oscillator
        wrong: dict[Coded, MaskPerImpact] = {}
        with np.errstate(invalid="ignore"):
            if posteriors.noise_p is not None:
                wrong[STRUCTURED] = (posteriors.noise_p < _STRUCTURED_BY_CHANCE) & ~noiseless
            wrong[AT_A_LIMIT] = at_a_limit(oscillator["zeta"])
        # What is integrated from behind a low-pass has contact, and so its peak, elsewhere.
        another = another_peak(self.prepared.signal, oscillator["omega_n"], oscillator["zeta"])
        wrong[ANOTHER_PEAK] = another & (dataset.recorder is None)
        wrong[UNCORRECTED] = (posteriors.pareto_k > k_threshold(POINTS)) & ~noiseless
        if greatest := posteriors.quantities.get("peak_deceleration"):
            jerk = posteriors.quantities["peak_jerk"]["high"]
            missed = missed_peaks(dataset, self.prepared, greatest["low"], greatest["high"], jerk)
            wrong[PEAK_MISSED] = posteriors.moved & ~noiseless & missed
        impacts = self.prepared.impacts
        for q in ("K", "C"):
            here = self.untold[q]
            rows_of = impacts.assign(untold=here, phantom=of_phantoms(impacts))
            share = rows_of.groupby(["trial", "phantom"])["untold"].transform("mean")
            # The few of a trial that come out above the threshold are those that erred upwards.
            wrong |= {UNTOLD[q]: here, MOSTLY_UNTOLD[q]: (share.to_numpy() > 0.5) & ~here}
        return wrong


def outcomes_in(row: pd.Series) -> pd.DataFrame:
    """What the impact of a row of `estimates.csv` came to, an outcome a row.

    ``median``, ``low`` and ``high``, the ends of the 90 % interval, and ``unit``; ``never`` is the
    probability of what is infinite.
    """
    import pandas as pd

    rows: dict[str, dict[str, float | str]] = {}
    for column, (name, which) in INTERVAL_COLUMNS.items():
        if column in row:
            one = rows.setdefault(name, {"never": 0.0, "unit": DECLARED[name].unit})
            one[which] = float(row[column])
    return pd.DataFrame(rows).T[["median", "low", "high", "never", "unit"]].infer_objects()
