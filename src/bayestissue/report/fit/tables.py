"""Tables of a fit: the measuring chain, what was left out and predicted, and the measured coverage."""

from __future__ import annotations

import numpy as np
import pandas as pd

from bayestissue.hierarchy.formulas.group_terms import stem_of
from bayestissue.report.fit.groupings import groupings, own_slopes
from bayestissue.report.fit.run import FitRun
from bayestissue.report.tables import Field, Row, Table, columns, lines, table_of
from bayestissue.report.wording import listed, number, percent, significant

_ERRORS = {
    "mass": ("mass of the impactor", "g", 1e3),
    "velocity_error": ("velocity at contact and gain together", "mm/s", 1e3),
    "ramp_error": ("velocity at contact and gain together", "mm/s", 1e3),
    "offset_error": ("zero of the recorder, after what the quiet part before contact tells", "m/s²", 1.0),
    "contact_time_error": ("time of contact", "µs", 1e6),
    "level_error": ("displacement at contact, from the time of contact", "µm", 1e6),
}
_DECLARED = {
    "relative_mass_sd": ("mass", percent),
    "velocity_sd_m_s": ("velocity at contact", "{:.2g} m/s".format),
    "relative_gain_sd": ("gain", percent),
    "offset_sd": ("zero of the recorder", "{:.2g} in the signal's unit".format),
}
MOST_ROWS = 300
# The greatest of even 10,000 normal errors is seldom beyond this many standard deviations.
_FAR = 4.5
_FROM_TRACE = "read off each trace"


def declared_sd(run: FitRun, error: str) -> np.ndarray:
    """Prior standard deviation of an error [impact]; NaN where each trace itself gave it."""
    if f"{error}_sd" in run.groups["constant_data"]:
        return run.constant(f"{error}_sd")
    declared = {name: float(run.record.get("uncertainty", {}).get(name) or 0) for name in _DECLARED}
    mass, velocity = run.constant("mass_kg"), run.constant("velocity_m_s")
    if error == "mass":
        return declared["relative_mass_sd"] * mass
    if error in ("velocity_error", "ramp_error"):
        return np.hypot(declared["velocity_sd_m_s"], declared["relative_gain_sd"] * velocity)
    return np.full(mass.shape, np.nan)


def chain_table(run: FitRun) -> Table:
    """How far each error of the measuring chain was known before, and is known after, the fit."""
    rows = []
    for error, (words, unit, scale) in _ERRORS.items():
        errors = run.of_impacts(error)
        if errors.empty or not (errors["sd"] > 0).any():
            continue
        before, after = declared_sd(run, error), errors["sd"].to_numpy()
        declared = bool((before > 0).all())
        moved = (errors["median"] - (run.constant("mass_kg") if error == "mass" else 0)).abs()
        farthest = float((moved / before).max()) if declared else 0.0
        rows.append(
            Row(
                (
                    words,
                    unit,
                    significant(scale * float(np.median(before)), 2) if declared else _FROM_TRACE,
                    significant(scale * float(np.median(after)), 2),
                    percent(float(np.median(after / before))) if declared else "",
                    significant(scale * float(moved.max()), 2),
                    f"{farthest:.1f} sd" if declared else "",
                ),
                "disagrees" if farthest > _FAR else "",
            )
        )
    titles = (
        *("error of", "unit", "sd before", "sd after", "after / before"),
        *("greatest correction", "of its sd before"),
    )
    return Table(columns(*titles, number=titles[2:], words=titles[:1]), rows)


def declared_words(run: FitRun) -> str:
    """The standard deviations that the dataset declares of its measuring chain."""
    declared = run.record.get("uncertainty", {})
    parts = [
        f"{words} {shown(float(declared[name]))}"
        for name, (words, shown) in _DECLARED.items()
        if declared.get(name)
    ]
    if not parts:
        return (
            "The dataset declares no uncertainty of its measuring chain, so mass, velocity, gain and zero "
            "are taken as exact: the intervals of K and C are narrower than the truth if they are not."
        )
    persons = ""
    if run.record.get("model", {}).get("mass_error") == "subject" and declared.get("relative_mass_sd"):
        persons = (
            " The error of the mass is a person's, the same in all of the person's impacts, so that K and C "
            "of a person are no surer than that mass."
        )
    return f"Declared standard deviations: {listed(parts)}.{persons}"


def left_out_summary(run: FitRun) -> Table:
    """Per scheme of leaving out: summed log predictive density, its standard error, and Pareto k."""
    rows = []
    for scheme, part in run.cross_validation.groupby("scheme", sort=False):
        high = part.loc[part["warning"] != "", "label"]
        error = np.sqrt(len(part)) * part["elpd"].std(ddof=1)
        rows.append(
            Row(
                (
                    str(scheme),
                    str(len(part)),
                    number(part["elpd"].sum(), 0),
                    number(error, 0),
                    number(part["pareto_k"].max(), 2),
                    str(len(high)),
                    listed([str(label) for label in high[:12]]) + (" and others" if len(high) > 12 else ""),
                ),
                "disagrees" if len(high) else "",
            )
        )
    titles = ("scheme", "parts", "elpd (nats)", "se", "largest Pareto k", "k above 0.7", "which")
    return Table(columns(*titles, number=titles[1:6], words=("which",)), rows)


def left_out_table(run: FitRun) -> Table:
    """Every part left out, those of the highest Pareto k first within each scheme, up to 300."""
    parts = pd.concat(
        [
            part.sort_values("pareto_k", ascending=False, kind="stable")
            for _, part in run.cross_validation.groupby("scheme", sort=False)
        ]
        or [run.cross_validation]
    )
    ordered = parts.groupby("scheme", sort=False).head(MOST_ROWS)
    return table_of(
        lines(ordered),
        Field("scheme", lambda line: line.scheme),
        Field("left out", lambda line: line.label),
        Field("elpd (nats)", lambda line: number(line.elpd, 1), "number"),
        Field("Pareto k", lambda line: number(line.pareto_k, 2), "number"),
        Field("warning", lambda line: line.warning),
        mark=lambda line: "disagrees" if line.warning else "",
    )


# Of how many intervals hold the truth: rows with quantity, level, held and impacts.
COVERAGE = (
    Field("quantity", lambda row: str(row.quantity)),
    Field("interval", lambda row: f"{row.level:g} %", "number"),
    Field("hold the truth", lambda row: f"{row.held} of {row.impacts}", "number"),
    Field("share", lambda row: percent(row.held / row.impacts), "number"),
)


def population_names(run: FitRun) -> tuple[str, ...]:
    """The parameters of the population, covariates' effects among them, in the order of `summary.csv`."""
    stems_of_responses = tuple(
        f"{stem}_{quantity}"
        for stem in ("intercept", "mass_exponent", "sd_subject", "sd_trial", "sd_impact")
        for quantity in run.responses
    )
    stems = ("atanh_theta1", "atanh_noise_correlation")
    last = (name for stem in stems for name in (f"{stem}_mean", f"sd_{stem}"))
    others = ("residual_correlation", "noise_mean", "sd_noise", *last)
    names = [str(name) for name in dict.fromkeys(run.summary["variable"])]
    covariates = [name for name in names if name.startswith(("effect_of_", "covariate_effect_"))]
    further = [name for name in names if name.startswith(("log_", "sd_log_"))]
    further += [f"sd_{stem_of(group)}_{q}" for group in groupings(run) for q in run.responses]
    further += [f"sd_{slope.name}" for slope in own_slopes(run)]
    secants = ("mass_exponent_K_common_depth", "mass_exponent_K_secant")
    return (*stems_of_responses, *further, *secants, *covariates, *others)
