"""K and C of every impact by itself as a table, by any of the methods: `estimates.csv`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
from jaxtyping import Bool

from bayestissue.dataset import as_dataset
from bayestissue.dataset.impacts import of_phantoms
from bayestissue.elements.outcomes import NEVER, OUTCOMES
from bayestissue.errors import InputError
from bayestissue.hierarchy.design import build_design
from bayestissue.hierarchy.specification import Formulas, read_specification
from bayestissue.hierarchy.trace_data import Prepared, assemble, only_by_impact, unsuited
from bayestissue.inference.checking.recorded_peak import missed_peaks
from bayestissue.inference.execution.kept import some_of
from bayestissue.inference.points.estimates import (
    default_options,
    estimates_table,
    flagged,
    in_rows,
    table_of,
)
from bayestissue.inference.points.fit import PointFit
from bayestissue.inference.points.notes import (
    C_MOSTLY_UNTOLD,
    C_UNTOLD,
    K_MOSTLY_UNTOLD,
    K_UNTOLD,
    UNCORRECTED,
)
from bayestissue.inference.results.labels import element_attributes, outcome_column
from bayestissue.inference.samplers.diagnostics import PEAK_MISSED
from bayestissue.inference.samplers.psis import k_threshold
from bayestissue.inference.single.posterior import POINTS, SinglePosteriors, single_posteriors
from bayestissue.oscillator import spring_damper_inverse, to_discrete
from bayestissue.resources import shared
from bayestissue.signal import Displacements, SignalOptions, displacements
from bayestissue.signal.displacement import FEWEST_SAMPLES
from bayestissue.signal.quality import Finding, inspect

if TYPE_CHECKING:
    import pandas as pd

    from bayestissue.dataset import Dataset

Method = Literal["impact", "exact", "dds"]
Say = Callable[[str, int, int], None]
_METHODS = ("impact", "exact", "dds")
# Of the peak: below it the likelihood's own approximations, to first order in the moment of contact, count.
_LEAST_NOISE = 1e-5
# What an impact came to, and which number of its posterior; `time_to_peak_s` is the recorded one.
OUTCOME_COLUMNS = {
    outcome_column(name, "" if which == "median" and name != "time_to_peak" else which): (name, which)
    for name in OUTCOMES
    for which in ("median", "low", "high")
} | {f"{name}_never": (name, "never") for name in NEVER}
# An interval whose ends are this many times apart leaves the order of magnitude open.
_DECADE = 10.0


def method_for(dataset: Dataset, options: SignalOptions | None = None) -> Method:
    """The method unless told otherwise: "impact" of decelerations, "exact" of displacements.

    "exact" too where the options choose what only an integrated displacement has: a filter, another rule of
    integration, or an equilibrium other than rest.
    """
    default = SignalOptions()
    chosen = options or default
    only_displaced = ("filter", "integration", "equilibrium")
    if dataset.quantity == "displacement" or any(
        getattr(chosen, name) != getattr(default, name) for name in only_displaced
    ):
        return "exact"
    return "impact"


def estimate(
    dataset: Dataset | str | Path,
    *,
    method: Method | None = None,
    options: SignalOptions | None = None,
    say: Say | None = None,
) -> pd.DataFrame:
    """K and C of every impact by itself, with intervals and flags.

    Args:
        dataset: as `bayestissue.read_dataset` or `bayestissue.dataset` returns it, or its folder.
        method: "impact" for the posterior of each impact under the likelihood of its own deceleration, the
            errors of its measuring chain integrated out, and weak priors (those of ``models/impact.toml`` on
            the intercepts and the noise, and one of the damping ratio): medians and intervals that hold.
            "exact" for maximum likelihood of
            an ARMA(2,1) about the rest position; "dds" for the thesis's conditional least squares about the
            sample mean. `method_for` unless given.
        options: how the displacement is made from the recording; `default_options` unless given.
        say: told the stage, how much of it is done, and its total.

    Returns:
        One row per impact with the columns of `estimates.csv`: the ARMA(2,1) coefficients, omega_n, zeta,
        K and C, and ``flags``, what is wrong with the impact, joined by "; "; then standard errors and 90 %
        intervals of K and C; and last ``notes``, what is not wrong with the impact but a property of the
        method or of how it was recorded (see `bayestissue.inference.points.notes`). By "impact" K and C are
        posterior medians, omega_n, zeta, phi1, phi2 and theta1 those of an oscillator of this K and C, errors
        posterior standard deviations, and ``sigma_a`` is empty: the noise is the recorder's, in
        ``noise_sd_m_s2``, and no shock drives the impact; ``pareto_k`` is of the importance weights. What the
        impact came to follows, see `OUTCOME_COLUMNS`, the chain's errors in its intervals. K, or C,
        is empty and flagged where its interval spans more than a factor of 10: the interval is then from 0
        to an upper bound that holds with 95 %; and where nothing was found, which has no interval either.
        Where that befalls most impacts of a trial its others are flagged too. By the
        others intervals are from the trace and the relative standard deviation of the mass alone, and hold
        when the noise is what an ARMA(2,1) assumes.

    Raises:
        InputError: the method or the options ask for what the recordings can't give, such as "exact" or "dds"
            for even times.
        ValueError: there is no such method.
    """
    dataset = as_dataset(dataset)
    method = method or method_for(dataset, options)
    options = options or default_options("dds" if method == "dds" else "exact")
    findings = inspect(dataset, options)
    return estimates(dataset, displacements(dataset, options), method, options, findings, say=say)


def estimates(
    dataset: Dataset,
    signal: Displacements,
    method: Method,
    options: SignalOptions,
    findings: Sequence[Finding] = (),
    *,
    say: Say | None = None,
) -> pd.DataFrame:
    """The table of `estimate` for displacements that were made with these options.

    Impacts of fewer than eight samples have a row without numbers.

    Args:
        dataset: the recordings.
        signal: what was made of them.
        method: see `estimate`.
        options: what it was made with.
        findings: what `bayestissue.signal.quality.inspect` found; flagged.
        say: as of `estimate`.
    """
    if method not in _METHODS:
        raise ValueError(f"method is one of {', '.join(_METHODS)}, not {method!r}")
    if method != "impact":
        if problems := only_by_impact(dataset, f"estimate --method {method}", "method", method):
            raise InputError(problems)
        return estimates_table(dataset, signal, method, findings)
    return by_impact(dataset, signal, options, findings, say=say)[0]


def by_impact(
    dataset: Dataset,
    signal: Displacements,
    options: SignalOptions,
    findings: Sequence[Finding] = (),
    *,
    say: Say | None = None,
) -> tuple[pd.DataFrame, SinglePosteriors | None]:
    """The table of `estimates` by the method "impact", and the posteriors where there are samples enough.

    Arguments as of `estimates`; without any such impact there are no posteriors.

    Raises:
        InputError: the recordings are displacements, or the options filter them.
    """
    alone: dict[str, object] = {"formula": Formulas(K="1", C="1"), "discrepancy": "none"}
    # Whoever shares an impact's error of mass, an impact alone has it.
    alone |= {"mass_error": "impact", "signal": options}
    specification = read_specification(shared("models", "impact.toml")).model_copy(update=alone)
    if problems := unsuited(dataset, specification, "estimate --method impact"):
        raise InputError(problems)
    rows = signal.n_below_limit >= FEWEST_SAMPLES
    if not rows.any():
        # Nothing to ask: the same columns without numbers.
        table = estimates_table(dataset, signal, "exact", findings)
        lacking = dict.fromkeys(["noise_sd_m_s2", "pareto_k", *OUTCOME_COLUMNS], np.nan)
        return table.assign(**lacking, notes=table.pop("notes")), None
    design = build_design(specification.formula, dataset.impacts, reference_mass_kg=None, source="estimate")
    prepared = some_of(assemble(dataset, specification, design, signal), np.flatnonzero(rows))
    posteriors = single_posteriors(prepared) if say is None else single_posteriors(prepared, say)
    noiseless = posteriors.sigma.median < _LEAST_NOISE * np.exp(np.asarray(prepared.data.log_peak))
    untold, bounded = _untold(posteriors, noiseless), posteriors.moved & ~noiseless

    def in_table(values: np.ndarray, stands: np.ndarray | bool = True) -> np.ndarray:
        """Of all impacts of the dataset, without those whose value means nothing."""
        return in_rows(np.where(stands, values, np.nan), rows)

    # What is not told from below has the upper end of its interval as a bound.
    ends = {
        name: (
            in_table(np.where(untold[name], 0.0, marginal.low), bounded),
            in_table(marginal.high, bounded),
        )
        for name, marginal in (("K", posteriors.K), ("C", posteriors.C))
    }
    known = _told(_as_fit(posteriors, prepared.signal, noiseless), untold)
    fit = PointFit(*(in_rows(column, rows) for column in known))
    flags, notes = flagged(dataset, signal, fit, findings, "impact")
    missed = _missed_peak(dataset, prepared, posteriors)
    raised = {
        UNCORRECTED: (posteriors.pareto_k > k_threshold(POINTS)) & ~noiseless,
        PEAK_MISSED: bounded & missed,
        **_untold_flags(prepared, untold),
    }
    for flag, impacts in raised.items():
        for row in np.flatnonzero(rows)[impacts]:
            flags[row].append(flag)
    # Of what was not found, and of intervals that are none, there is no outcome either.
    outcomes = {
        column: in_table(getattr(outcome, which), posteriors.moved if which == "median" else bounded)
        for column, (name, which) in OUTCOME_COLUMNS.items()
        if (outcome := posteriors.outcomes.get(name)) is not None
    }
    table = table_of(dataset, signal, fit, ends, flags, notes)
    return table.assign(
        noise_sd_m_s2=in_table(posteriors.sigma.median),
        pareto_k=in_table(posteriors.pareto_k),
        **outcomes,
        notes=table.pop("notes"),
    ), posteriors


def _missed_peak(
    dataset: Dataset, prepared: Prepared, posteriors: SinglePosteriors
) -> Bool[np.ndarray, " impact"]:
    """Whether the sensor's own peak is outside its interval."""
    greatest, jerk = (posteriors.outcomes[name] for name in ("peak_deceleration", "peak_jerk"))
    return missed_peaks(dataset, prepared, greatest.low, greatest.high, jerk.high)


def _untold_flags(
    prepared: Prepared, untold: dict[str, Bool[np.ndarray, " impact"]]
) -> dict[str, Bool[np.ndarray, " impact"]]:
    """By flag: impacts whose K or C is not told, and the others of a trial of which most are not.

    The few of a trial that come out above the threshold are those that erred upwards.
    """
    flags: dict[str, np.ndarray] = {}
    for name, alone, among in (("K", K_UNTOLD, K_MOSTLY_UNTOLD), ("C", C_UNTOLD, C_MOSTLY_UNTOLD)):
        rows_of = prepared.impacts.assign(untold=untold[name], phantom=of_phantoms(prepared.impacts))
        share = rows_of.groupby(["trial", "phantom"])["untold"].transform("mean")
        flags |= {alone: untold[name], among: (share.to_numpy() > 0.5) & ~untold[name]}
    return flags


def outcomes_in(row: pd.Series) -> pd.DataFrame:
    """What the impact of a row of `estimates.csv` came to, an outcome a row.

    ``median``, ``low`` and ``high``, the ends of the 90 % interval, and ``unit``; ``never`` is the
    probability of what is infinite.
    """
    import pandas as pd

    units, rows = element_attributes(), dict[str, dict[str, float | str]]()
    for column, (name, which) in OUTCOME_COLUMNS.items():
        if column in row:
            one = rows.setdefault(name, {"never": 0.0, "unit": units[name]["unit"]})
            one[which] = float(row[column])
    return pd.DataFrame(rows).T[["median", "low", "high", "never", "unit"]].infer_objects()


def _untold(posteriors: SinglePosteriors, noiseless: np.ndarray) -> dict[str, Bool[np.ndarray, " impact"]]:
    """Where the recording does not tell K, or C: its interval spans a decade, or nothing was found at all."""
    with np.errstate(all="ignore"):
        wide = {
            name: ~(marginal.high < _DECADE * marginal.low)
            for name, marginal in (("K", posteriors.K), ("C", posteriors.C))
        }
    return {name: (~posteriors.moved | here) & ~noiseless for name, here in wide.items()}


def _told(fit: PointFit, untold: dict[str, Bool[np.ndarray, " impact"]]) -> PointFit:
    """The same without what the recordings do not tell; all but K, omega_n and C needs both K and C."""
    always = {"log_likelihood", "whiteness_p", "branch", "noiseless", "theta1_at_limit"}
    needs = dict.fromkeys(("K", "K_signed", "K_se", "omega_n", "omega_n_se"), untold["K"])
    needs |= dict.fromkeys(("C", "C_signed", "C_se"), untold["C"])
    either = untold["K"] | untold["C"]
    return PointFit(
        *(
            column if name in always else np.where(needs.get(name, either), np.nan, column)
            for name, column in zip(fit._fields, fit, strict=True)
        )
    )


def _as_fit(posteriors: SinglePosteriors, signal: Displacements, noiseless: np.ndarray) -> PointFit:
    """The posteriors' medians as point estimates, and the sampled oscillator of this K and C."""
    K, C = posteriors.K.median, posteriors.C.median
    omega_n, zeta = (np.asarray(values) for values in spring_damper_inverse(K, C, signal.mass))
    phi1, phi2, theta1 = (np.asarray(values) for values in to_discrete(omega_n, zeta, signal.dt))
    none = np.full(len(K), np.nan)
    omega_n_se, zeta_se, K_se, C_se = (
        np.where(noiseless, np.nan, marginal.sd)
        for marginal in (posteriors.omega_n, posteriors.zeta, posteriors.K, posteriors.C)
    )
    return PointFit(
        phi1=phi1,
        phi2=phi2,
        theta1=theta1,
        sigma_a=none,
        omega_n=omega_n,
        zeta=zeta,
        K=K,
        C=C,
        K_signed=K,
        C_signed=C,
        omega_n_se=omega_n_se,
        zeta_se=zeta_se,
        theta1_se=none,
        K_se=K_se,
        C_se=C_se,
        log_likelihood=posteriors.log_likelihood,
        whiteness_p=posteriors.noise_p,
        branch=np.zeros(len(K), int),
        noiseless=noiseless,
        theta1_at_limit=np.zeros(len(K), bool),
    )
