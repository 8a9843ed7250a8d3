"""What lies under the intervals of a fit: model, measuring chain, what was left out, and what makes them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from importlib.resources import files
from statistics import NormalDist
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from bayestissue.model.hierarchy import SIDE_BY_SIDE
from bayestissue.reports.pages.fit.answers import person_words
from bayestissue.reports.pages.fit.fit_run import FitRun
from bayestissue.reports.pages.fit.method_agreement import held_table
from bayestissue.reports.pages.page_settings import LIMITS, WORTH
from bayestissue.reports.pages.page_tables import Table, form_words, shown, table_of_cells
from bayestissue.reports.pages.posterior import QUANTITIES
from bayestissue.reports.pages.wording import SENTENCES, listed, percent, relative

if TYPE_CHECKING:
    from bayestissue.mechanics.elements.element import Element


def declared_sd(run: FitRun, error: str) -> np.ndarray:
    """Prior standard deviation of an error [impact]; NaN where each trace itself gave it."""
    if f"{error}_sd" in run.groups["constant_data"]:
        return run.constant(f"{error}_sd")
    declared = {
        name: float(run.record.get("uncertainty", {}).get(name) or 0) for name in SENTENCES["declared_errors"]
    }
    mass, velocity = run.constant("mass_kg"), run.constant("velocity_m_s")
    if error == "mass":
        return declared["relative_mass_sd"] * mass
    if error in ("velocity_error", "ramp_error"):
        return np.hypot(declared["velocity_sd_m_s"], declared["relative_gain_sd"] * velocity)
    return np.full(mass.shape, np.nan)


def chain_table(run: FitRun) -> Table:
    """How far each error of the measuring chain was known before, and is known after, the fit."""
    rows = [row for error in SENTENCES["chain_errors"] if (row := _chain_row(run, error))]
    return shown(
        "chain_errors",
        pd.DataFrame(rows),
        mark=lambda row: "disagrees" if row["farthest"] > WORTH.correction else "",
    )


def _chain_row(run: FitRun, error: str) -> dict[str, Any]:
    """Of an error its sd before and after, and its greatest correction; NaN where none was declared."""
    errors, (words, unit, scale) = run.of_impacts(error), SENTENCES["chain_errors"][error]
    if errors.empty or not (errors["sd"] > 0).any():
        return {}
    before, after = declared_sd(run, error), errors["sd"].to_numpy()
    before = before if (before > 0).all() else np.full(before.shape, np.nan)
    moved = (errors["median"] - (run.constant("mass_kg") if error == "mass" else 0)).abs()
    return {
        "error": words,
        "unit": unit,
        "before": scale * np.median(before),
        "after": scale * np.median(after),
        "left": np.median(after / before),
        "moved": scale * moved.max(),
        "farthest": (moved / before).max(),
    }


def declared_sds(run: FitRun) -> list[str]:
    """The standard deviations that the dataset declares of its measuring chain, in words."""
    declared = run.record.get("uncertainty", {})
    return [
        f"{words} {form_words(form)(float(declared[name]))}"
        for name, (words, form) in SENTENCES["declared_errors"].items()
        if declared.get(name)
    ]


def left_out_summary(run: FitRun) -> Table:
    """Per scheme of leaving out: summed log predictive density, its standard error, and Pareto k."""
    rows = []
    for scheme, part in run.cross_validation.groupby("scheme", sort=False):
        high = part.loc[part["warning"] != "", "label"].astype(str).to_list()
        row = {"scheme": scheme, "parts": len(part), "high": len(high), "k": part["pareto_k"].max()}
        row |= {"elpd": part["elpd"].sum(), "se": np.sqrt(len(part)) * part["elpd"].std(ddof=1)}
        rows.append(row | {"which": listed(high[:12]) + (" and others" if len(high) > 12 else "")})
    return shown("parts_left_out", pd.DataFrame(rows), mark=lambda row: "disagrees" if row["high"] else "")


def left_out_table(run: FitRun) -> Table:
    """Every part left out, those of the highest Pareto k first within each scheme, up to 300."""
    schemes = [part for _, part in run.cross_validation.groupby("scheme", sort=False)]
    ordered = [
        part.sort_values("pareto_k", ascending=False, kind="stable")[: LIMITS.rows] for part in schemes
    ]
    return shown(
        "cross_validation",
        pd.concat(ordered or [run.cross_validation]),
        mark=lambda row: "disagrees" if row["warning"] else "",
    )


def population_names(run: FitRun) -> list[str]:
    """The parameters of the population, covariates' effects among them."""
    begins = ("intercept_", "mass_exponent_", "sd_", "log_", "effect_of_", "covariate_effect_", "atanh_")
    names = [str(name) for name in dict.fromkeys(run.summary["variable"])]
    return [name for name in names if name.startswith((*begins, "residual_correlation", "noise_mean"))]


# In the order of the page, as the run names them and as the page does.
_NAMES: dict[str, str] = SENTENCES["interval_sources"]
_ALL, _DRAWN, _PRIORS = "all", "as drawn", "priors"
# Half a 90 % interval of a normal, in its standard deviations.
_HALF = NormalDist().inv_cdf(0.95)


def sources_table(run: FitRun) -> Table:
    """A row a source, columns of K and C by level: share of the variance, and half its own interval."""
    sources = run.interval_sources
    cells = {(row["source"], row["level"], row["quantity"]): row for row in sources.to_dict("records")}
    levels = source_levels(run)
    columns_shown = [(level, q) for level in levels for q in QUANTITIES if (_ALL, level, q) in cells]
    titles = [f"{q}, {levels[level]}" for level, q in columns_shown]
    present = set(sources["source"])
    names = _source_names(sources)
    rows = [
        (words, *(_cell(cells.get((name, *column))) for column in columns_shown))
        for name, words in names.items()
        if name in present
    ]
    if "element" not in present:
        rows.append((_NAMES["element"], *["taken as true"] * len(titles)))
    widths = (_half_width(cells[(_ALL, *column)]["sd"]) for column in columns_shown)
    rows.append(("all together", *widths))
    return table_of_cells(rows, "source", *titles, number=titles)


def _source_names(sources: pd.DataFrame) -> dict[str, str]:
    """The sources in the order of the page, further group terms as the model file has them before priors."""
    known = (*_NAMES, _ALL, _DRAWN, _PRIORS)
    further = [str(name) for name in sources["source"].unique() if name not in known]
    return _NAMES | {name: name for name in (*further, _PRIORS)}


def source_levels(run: FitRun) -> dict[str, str]:
    """Levels that these data tell something of, in words: of one impact, that impact alone."""
    who = person_words(run)
    several = {} if len(run.impacts) == 1 else {"typical person": who["typical"], "new person": who["new"]}
    return {"impact": "impact", **several}


def _cell(row: Mapping[Any, Any] | None) -> str:
    if row is None:
        return ""
    share = percent(max(row["share"], 0.0))
    return share if row["share"] < WORTH.share else f"{share} ({_half_width(row['sd'])})"


def _half_width(sd: float) -> str:
    return relative(math.expm1(_HALF * sd))


def largest_sources(run: FitRun, level: str, quantity: str) -> list[str]:
    """The sources that make most of a variance, each with its share."""
    sources = run.interval_sources
    names = _source_names(sources)
    chosen = sources[
        (sources["level"] == level) & (sources["quantity"] == quantity) & sources["source"].isin(names)
    ]
    ordered = chosen.sort_values("share", ascending=False, kind="stable")
    ordered = ordered[ordered["share"] >= min(WORTH.source, ordered["share"].max())]
    return [f"{names[row['source']]} {percent(row['share'])}" for row in ordered.to_dict("records")]


def doubtful_levels(run: FitRun, levels: Mapping[str, str]) -> list[str]:
    """Of which of the ``levels`` the sources do not add up to the variance of the draws, and how far off."""
    sources = run.interval_sources
    drawn = sources[(sources["source"] == _DRAWN) & sources["level"].isin(levels)]
    off = drawn[~drawn["share"].between(*WORTH.approximation)]
    return [
        f"{row['quantity']} of {levels[row['level']]} ({row['share']:.2g} times)"
        for row in off.to_dict("records")
    ]


# Parameters of impacts that not every model and dataset has.
_OF_SOME_FITS = ("atanh_theta1", "contact", "log_gain", "discrepancy", "noise_force", "log_force_ratio")
_MEASURED = files("bayestissue.reports.pages.fit").joinpath("coverage.csv")


def element_of(run: FitRun) -> Element | None:
    """The law of the tissue; None of a spring and damper side by side."""
    from bayestissue.mechanics.elements import element

    name = str(run.record.get("model", {}).get("element", SIDE_BY_SIDE))
    return None if name == SIDE_BY_SIDE else element(name)


def unused_priors(run: FitRun) -> tuple[str, ...]:
    """Priors that the model file may set and this fit has no use for."""
    known = set(run.summary["variable"])
    unused = (name for name in _OF_SOME_FITS if f"{name}_mean" not in known)
    return tuple(prior for name in unused for prior in (name, f"sd_{name}"))


def error_of_end(draws: int, p: float = 0.05) -> float:
    """Standard error of a normal's ``p`` quantile by so many draws, as a share of the interval's width.

    That is (p (1 - p) / draws)^1/2 over the density there, and the interval from there to the quantile 1 - p.
    """
    normal = NormalDist()
    end = normal.inv_cdf(p)
    return math.sqrt(p * (1 - p) / draws) / normal.pdf(end) / (-2 * end)


def coverage_table(run: FitRun) -> Table | None:
    """Coverage of this likelihood's intervals on simulated impacts; None where none was measured."""
    if run.record.get("discrepancy"):
        return None
    with _MEASURED.open(encoding="utf-8") as stream:
        coverage = pd.read_csv(stream)
    measured = coverage[coverage["likelihood"] == run.likelihood]
    return None if measured.empty else held_table(measured)
