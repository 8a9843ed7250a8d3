"""The figures of a fit, by name: those of its page, of notebooks (`bayestissue.Fit.plot`) and of files."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import pandas as pd

from bayestissue.inference.answers.reliability import limits_of_agreement
from bayestissue.inference.results.meanings import COLUMNS, NAMES, TOGETHER, UNITS
from bayestissue.model.hierarchy.formulas.group_terms import stem_of
from bayestissue.reports.figures import impacts as of_impacts
from bayestissue.reports.figures import study_comparisons
from bayestissue.reports.figures import traces as of_traces
from bayestissue.reports.figures.impacts import axis_title
from bayestissue.reports.figures.intervals import ENDS, intervals, quantiles, with_ranks
from bayestissue.reports.figures.theme import HEIGHT, Figure
from bayestissue.reports.pages.fit import answers, level_outcomes, trace_predictions
from bayestissue.reports.pages.fit.fit_run import FitRun, OwnSlope, groupings, own_slopes
from bayestissue.reports.pages.fit.method_agreement import (
    TITLE,
    apparent_exponent,
    mass_varies,
    method_values,
    shown_rows,
)
from bayestissue.reports.pages.page import worded
from bayestissue.reports.pages.page_settings import LIMITS
from bayestissue.reports.pages.posterior import QUANTITIES, exponent_figure, group_words, mass_curve
from bayestissue.reports.pages.wording import said


def impacts(run: FitRun, x: str = "C", y: str = "K") -> Figure:
    """A point for each impact: K over C, over the mass, or in order; ``x`` is "C", "mass" or "order"."""
    where = {"order": "in their order", "mass": "over the mass of the impactor"}.get(
        x, f"over {run.names.get(x, x)}"
    )
    true = "; crosses are the truth of simulated data" if not run.truth.empty and x == "order" else ""
    return of_impacts.scatter(
        run.impacts_table, x, y, said("figures.impacts", name=run.names[y], where=where, true=true), run.names
    )


def people(run: FitRun, quantity: str = "K", level: str = "subject") -> Figure:
    """K (or C, or another) of every person, or level of another grouping, the greatest first."""
    variable, (one, _) = run.of_levels(quantity, level), group_words(level)
    name = run.names.get(quantity, quantity)
    unit = UNITS.get(quantity) or run.groups["posterior"][variable].attrs["unit"]
    return intervals(
        with_ranks(run.draws(variable), run.labels(level)),
        f"{name} ({unit})",
        said("figures.people", name=name, one=one),
    )


def who(run: FitRun, quantity: str = "K") -> Figure:
    """K (or C) of the typical person, of each level that is compared, and of each person; a new one's band.

    Of one impact its own.
    """
    level, typical = answers.level_of(run, quantity), answers.person_words(run)["typical"]
    drawn = run.draws(TOGETHER) if level.these else run.draws(f"{quantity}_typical_person")
    by_level = bool(answers.of_each_level(run, quantity))
    parts = [] if by_level else [quantiles(drawn[:, None], ["these impacts" if level.these else typical])]
    for dimension, variable in answers.compared(run, quantity):
        draws, labels = run.draws(variable), run.labels(dimension)
        if dimension == "subject":
            parts.append(with_ranks(draws, labels))
        else:
            what = group_words(dimension)[0] if dimension == "trial" else dimension
            parts.append(quantiles(draws, [f"{what} {label}" for label in labels]))
    if alone := len(run.impacts) == 1:
        parts = [run.estimates_by_method[quantity][list(ENDS)].assign(label="this impact")]
    rows = pd.concat(parts, ignore_index=True)
    figure = intervals(
        rows.fillna({"rank": ""}) if "rank" in rows else rows,
        axis_title(quantity, run.names),
        said("figures.who", name=run.names[quantity]),
        lines=() if alone or by_level else (level.typical.median,),
        band=None if alone or by_level or level.these else (level.new.low, level.new.high),
    )
    return replace(figure, chart=figure.chart | {"height": min(figure.chart["height"], HEIGHT)})


def first(run: FitRun, quantity: str) -> Iterator[tuple[str, Figure, str]]:
    """The pictures of K (or C) on the first screen: name, figure and the sentence that it shows.

    Who differs, and the dependence on mass; every impact in order where one of them can't be.
    """
    several, caption = bool(answers.compared(run, quantity)), worded("fit", "who", run, quantity)
    in_order = f"{quantity}-of-impacts", impacts(run, "order", quantity)
    if several or len(run.impacts) == 1:
        yield f"{quantity}-of-whom", who(run, quantity), caption
    else:
        yield *in_order, caption
    if mass_varies(run):
        yield (
            f"{quantity}-over-mass",
            mass(run, quantity, thesis=True),
            worded("fit", "mass_at_once", run, quantity),
        )
    elif several:
        yield *in_order, worded("fit", "scatter", run, quantity)


def sides(run: FitRun) -> list[str]:
    """The columns, such as ``side``, in whose levels the same people were hit, the condition last."""
    table = run.impacts_table
    several = [
        name
        for name in dict.fromkeys((*of_impacts.factors(table), "condition"))
        if name != "person"
        and 2 <= table[name].nunique() <= LIMITS.sides
        and table[["person", name]].drop_duplicates()["person"].duplicated().any()
    ]
    # Conditions that stand for masses are in the figure of the mass.
    return [name for name in several if name != "condition" or not run.has("mass_exponent_K")]


def paired(run: FitRun, quantity: str = "K", factor: str = "side") -> Figure:
    """K (or C) of each person from level to level of ``factor``, and the levels' means.

    Where the model has an effect of person and level together, values are that effect's posterior; else the
    geometric means of the person's impacts.
    """
    table = run.impacts_table
    column = "trial" if factor == "condition" else factor
    if variable := run.of_levels(quantity, f"subject:{column}"):
        rows = quantiles(run.draws(variable), run.labels(f"subject:{column}"))
        rows[["person", "level"]] = [str(label).rsplit(":", 1) for label in rows["label"]]
    else:
        rows = _geometric_means(table[COLUMNS[quantity]], table["person"], table[factor].rename("level"))
    if mean := run.of_levels(quantity, column):
        means = quantiles(run.draws(mean), run.labels(column)).rename(columns={"label": "level"})
    else:
        means = _geometric_means(rows["median"], rows["level"])
    return study_comparisons.paired(
        rows[["person", "level", "median", "eti90_low", "eti90_high"]],
        means[["level", "median", "eti90_low", "eti90_high"]],
        factor,
        axis_title(quantity, run.names),
        said("figures.paired", name=run.names[quantity], factor=factor),
    )


def _geometric_means(values: pd.Series, *by: pd.Series) -> pd.DataFrame:
    """A row for each combination of levels: the ``median`` in figures, without an interval."""
    means = np.exp(np.log(values).groupby(list(by)).mean())
    return means.rename("median").reset_index().assign(eti90_low=np.nan, eti90_high=np.nan)


def repeats(run: FitRun, quantity: str) -> pd.DataFrame:
    """Two successive measurements of one person, posterior medians: their ``ratio`` over their ``mean``.

    In the same condition where people were hit again in it, else from condition to condition.
    """
    table = run.impacts_table.assign(value=run.estimates_by_method[quantity]["median"].to_numpy())
    table = table[table["value"] > 0]
    levels = of_impacts.factors(table)
    if not table.duplicated(levels).any():
        levels = ["person"]
    before = table.groupby(levels, sort=False)[["impact", "value"]].shift()
    pairs = pd.DataFrame(
        {
            "person": table["person"],
            "pair": before["impact"] + ", " + table["impact"],
            "mean": np.sqrt(before["value"] * table["value"]),
            "ratio": table["value"] / before["value"],
        }
    )
    return pairs.dropna(ignore_index=True)


def repeatability(run: FitRun, quantity: str = "K") -> Figure:
    """Successive measurements of one person: their ratio over their mean, with 95 % limits of agreement."""
    rows = repeats(run, quantity)
    return study_comparisons.agreement(
        rows,
        limits_of_agreement(rows["ratio"]),
        f"geometric mean {quantity} of the two ({UNITS[quantity]})",
        "second over first",
        said("figures.repeatability", q=quantity),
    )


def methods(run: FitRun, quantity: str) -> Figure:
    """K (or C) of each impact by the thesis's method and this fit, as Bland and Altman plot them."""
    table = method_values(run, quantity)
    table = table[(table > 0).all(axis=1)]
    rows = pd.DataFrame(
        {
            "impact": table.index,
            "mean": np.sqrt((table["dds"] * table["posterior"]).to_numpy()),
            "ratio": (table["dds"] / table["posterior"]).to_numpy(),
        }
    )
    words = said("figures.methods", q=quantity, title=TITLE)
    mean = f"geometric mean {quantity} ({UNITS[quantity]})"
    limits = limits_of_agreement(rows["ratio"])
    return study_comparisons.agreement(shown_rows(rows), limits, mean, TITLE, words)


def mass(run: FitRun, quantity: str = "K", *, thesis: bool = False) -> Figure:
    """K (or C) over mass on log scales: impacts, conditions, the posterior line, exponents 0 and 1."""
    masses = run.constant("mass_kg")
    trial = pd.Series(run.constant("impact_trial").astype(str), name="label")
    at = _geometric_means(pd.Series(masses), trial).set_index("label")["median"]
    whose = answers.person_words(run)["typical"]
    if variable := run.of_levels(quantity, "trial"):
        conditions = quantiles(run.draws(variable), run.labels("trial"))
    else:
        # Of K_secant there are the recorded impacts alone.
        medians = run.estimates_by_method[quantity]["median"].reset_index(drop=True)
        conditions = _geometric_means(medians, trial)
        conditions = conditions.set_index("label").reindex(run.labels("trial")).reset_index()
        whose = "mean of impacts"
    conditions = conditions.assign(mass_kg=at.reindex(run.labels("trial")).to_numpy())
    dds = run.point_estimates[["impact", "mass_kg", COLUMNS[quantity]]].rename(
        columns={COLUMNS[quantity]: "value"}
    )
    curve = mass_curve(run, quantity, masses, run.reference_mass)
    if thesis and (line := apparent_exponent(run, quantity)):
        ratio = curve["mass_kg"] / run.reference_mass
        curve["line of the thesis"] = np.exp(line.intercept) * ratio**line.slope.median
    return of_impacts.over_mass(
        shown_rows(run.impacts_table),
        conditions,
        curve,
        quantity,
        said("figures.mass", name=run.names[quantity]),
        who=whose,
        names=run.names,
        others=[shown_rows(dds[dds["value"] > 0].assign(kind=of_impacts.THESIS))] if thesis else [],
    )


def slope(run: FitRun, chosen: OwnSlope) -> Figure:
    """Each level's own coefficient, the greatest first."""
    one = group_words(chosen.grouping)[0]
    band = np.percentile(run.draws(chosen.shared), [5, 95]) if run.has(chosen.shared) else None
    return intervals(
        with_ranks(run.draws(chosen.name), run.labels(chosen.grouping)),
        chosen.words if chosen.covariate else f"{chosen.words} (no unit)",
        said("figures.slope", what=chosen.words, one=one),
        lines=(0,) if chosen.covariate else (0, 1),
        band=None if band is None else (float(band[0]), float(band[1])),
        straight=True,
    )


def spreads(run: FitRun) -> Figure:
    """The population's standard deviations of log K and log C, in percent."""
    parts = [
        quantiles(100 * np.expm1(run.draws(name))[:, None], [_of(level)]).assign(series=NAMES[q])
        for level in dict.fromkeys(("subject", "trial", *groupings(run), "impact"))
        for q in QUANTITIES
        if q in run.of_tissue and run.has(name := f"sd_{stem_of(level)}_{q}")
    ]
    rows = pd.concat(parts, ignore_index=True)
    return intervals(rows, "standard deviation (% of K or C)", said("figures.spreads"), straight=True)


def _of(level: str) -> str:
    return "impacts" if level == "impact" else group_words(level)[1]


def recording(run: FitRun, impact: str | None = None) -> Figure:
    """What was recorded of one impact over what is predicted of it; the median one by K unless given."""
    names = [run.impacts[row] for row in run.predicted]
    index = trace_predictions.middle_impact(run) if impact is None else names.index(impact)
    rows, (unit, _) = trace_predictions.trace_rows(run, index), trace_predictions.SCALES[run.shown]
    return of_traces.recording(rows, run.shown, unit, said("figures.recording", shown=run.shown))


def recorded_force(run: FitRun) -> Figure:
    """The force of one impact over what is predicted of it."""
    index = trace_predictions.force_impact(run)
    rows, unit = trace_predictions.trace_rows(run, index, what="force"), trace_predictions.SCALES["force"][0]
    words = said("figures.force", impact=run.impacts[run.predicted[index]])
    return of_traces.recording(rows, "force", unit, words)


def residual_figures(run: FitRun, left: trace_predictions.Residuals) -> list[Figure]:
    """Of the residuals: the p-values where they were tested, and the autocorrelation at lag 1.

    That is of what was recorded, and of data made by the model.
    """
    rows = left.lag_one.drop(columns="inside").rename(columns={"measured": "recorded"})
    of_lag = of_traces.lag_one(rows.assign(impact=np.array(run.impacts)[left.which]), said("figures.lag_one"))
    if not run.tested:
        return [of_lag]
    tested, words = np.array(list(run.tested.values())), said("figures.residual_p")
    return [of_traces.sorted_p(tested, trace_predictions.STRUCTURED, words), of_lag]


def published(run: FitRun) -> Iterator[tuple[str, Callable[[], Figure]]]:
    """The figures of a fit that serve a paper: a name fit for a file, and what makes each."""
    for q in QUANTITIES:
        if answers.compared(run, q):
            yield f"{q}-of-whom", partial(who, run, q)
        for level in groupings(run):
            if run.of_levels(q, level):
                yield f"{q}-by-{stem_of(level)}", partial(people, run, q, level)
        for factor in sides(run):
            yield f"{q}-paired-by-{factor}", partial(paired, run, q, factor)
        if mass_varies(run):
            yield f"{q}-over-mass", partial(mass, run, q, thesis=True)
        if len(repeats(run, q)) > 1:
            yield f"{q}-repeatability", partial(repeatability, run, q)
        yield f"{q}-of-impacts", partial(impacts, run, "order", q)
    yield "K-over-C", partial(impacts, run)
    yield "recording", partial(recording, run)
    yield from level_outcomes.published(run)
    for coefficient in own_slopes(run):
        yield coefficient.name, partial(slope, run, coefficient)


def level_figures(run: FitRun, level: str, quantities: Sequence[str]) -> list[Figure]:
    """Quantities of every person, or level of another grouping."""
    return [people(run, q, level) for q in quantities]


def slope_figures(run: FitRun) -> list[Figure]:
    """Every coefficient that differs between levels."""
    return [slope(run, chosen) for chosen in own_slopes(run)]


def repeat_figures(run: FitRun) -> list[Figure]:
    """Successive measurements of one person, of K and of C, where there are several pairs."""
    return [repeatability(run, q) for q in QUANTITIES if len(repeats(run, q)) > 1]


def _bound(figure: Callable[..., Figure]) -> property:
    return property(lambda self: partial(figure, self.run), doc=figure.__doc__)


@dataclass(frozen=True)
class Plots:
    """Figures of a fit for notebooks, `bayestissue.Fit.plot`: a cell that ends with one draws it."""

    run: FitRun

    impacts = _bound(impacts)
    people = _bound(people)
    paired = _bound(paired)
    repeatability = _bound(repeatability)
    mass = _bound(mass)
    exponent = _bound(exponent_figure)
    spreads = _bound(spreads)
    recording = _bound(recording)
    loops = _bound(level_outcomes.loops)
    curves = _bound(level_outcomes.curves)
    ranks = _bound(level_outcomes.ranks)
