"""People, conditions and other groups: their levels, their own coefficients, and the mass of the impactor."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pandas as pd
from markupsafe import Markup

from bayestissue.hierarchy.formulas.group_terms import stem_of
from bayestissue.report.fit.estimates import apparent_exponent, shown_rows, side_by_side
from bayestissue.report.fit.run import FitRun
from bayestissue.report.page import figure
from bayestissue.report.posterior import (
    NAMES,
    QUANTITIES,
    Quantity,
    Spread,
    draw_intervals,
    group_words,
    ranked,
    spread,
    typical_draws,
)
from bayestissue.report.style import (
    MUTED,
    PALETTE,
    POSTERIOR,
    PUBLISHED,
    REFERENCE,
    log_ticks,
    new_figure,
)
from bayestissue.report.wording import UNITS, listed

_FIRST = ("subject", "trial")


class OwnSlope(NamedTuple):
    """A coefficient that differs between the levels of a grouping.

    Attributes:
        grouping: the dimension of its levels, such as ``subject``.
        covariate: empty of a mass exponent.
        quantity: K, C, or a further parameter that has a formula.
    """

    grouping: str
    covariate: str
    quantity: str

    @property
    def name(self) -> str:
        """The name of each level's own coefficient in the posterior."""
        what = f"effect_of_{self.covariate}" if self.covariate else "mass_exponent"
        return f"{stem_of(self.grouping)}_{what}_{self.quantity}"

    @property
    def shared(self) -> str:
        """The name of the population's coefficient."""
        what = f"effect_of_{self.covariate}" if self.covariate else "mass_exponent"
        return f"{what}_{self.quantity}"

    @property
    def words(self) -> str:
        """What it is."""
        if self.covariate:
            return f"effect of {self.covariate} on log {self.quantity}"
        return f"mass exponent of {self.quantity}"


def groupings(run: FitRun) -> list[str]:
    """The dimensions whose levels have effects: people and conditions, then the others."""
    of_effects = [
        str(array.dims[-1])
        for name, array in run.groups["posterior"].data_vars.items()
        if str(name).endswith(tuple(f"_effect_{q}" for q in run.responses)) and array.ndim > 2
    ]
    return list(dict.fromkeys([*(grouping for grouping in _FIRST if grouping in of_effects), *of_effects]))


def own_slopes(run: FitRun) -> list[OwnSlope]:
    """The coefficients that differ between levels."""
    slopes = []
    for variable, array in run.groups["posterior"].data_vars.items():
        name, dimension = str(variable), str(array.dims[-1])
        start = f"{stem_of(dimension)}_"
        if array.ndim != 3 or not name.startswith(start):
            continue
        for quantity in run.responses:
            what = name.removeprefix(start).removesuffix(f"_{quantity}")
            if f"{start}{what}" != name and (what == "mass_exponent" or what.startswith("effect_of_")):
                covariate = "" if what == "mass_exponent" else what.removeprefix("effect_of_")
                slopes.append(OwnSlope(dimension, covariate, quantity))
    return slopes


def differing_words(run: FitRun) -> str:
    """Whether people, or the levels of another grouping, differ in the dependence on mass; else empty."""
    return " ".join(_differing(run, slope) for slope in own_slopes(run) if not slope.covariate)


def _differing(run: FitRun, slope: OwnSlope) -> str:
    scatter = spread(run.draws(f"sd_{slope.name}"))
    low, high = np.percentile(_deviations(run, slope), [5, 95], axis=0)
    apart = int(((low > 0) | (high < 0)).sum())
    one, several = group_words(slope.grouping)
    which = f"{apart} of {low.size} {several}" if apart else f"no {one}"
    verb = "are" if apart > 1 else "is"
    begin = (
        f"{several.capitalize()} differ in it"
        if apart
        else f"{several.capitalize()} are not seen to differ in it"
    )
    return (
        f"{begin}: in {slope.quantity} {which} {verb} told apart from the common exponent by 90 % intervals; "
        f"standard deviation of the exponents {scatter.value} ({scatter.range})."
    )


def _deviations(run: FitRun, slope: OwnSlope) -> np.ndarray:
    slopes = run.draws(slope.name)
    return slopes - run.draws(slope.shared)[:, None] if run.has(slope.shared) else slopes


def slope_words(run: FitRun, slope: OwnSlope) -> str:
    """Which levels' coefficients are told from the population's."""
    low, high = np.percentile(_deviations(run, slope), [5, 95], axis=0)
    apart = np.array(run.labels(slope.grouping))[(low > 0) | (high < 0)]
    scatter: Spread = spread(run.draws(f"sd_{slope.name}"))
    named = f": {listed([str(label) for label in apart])}" if apart.size else ""
    one, _ = group_words(slope.grouping)
    return (
        f"The {slope.words} differs between one {one} and the next with a standard deviation of "
        f"{scatter.value} ({scatter.range}). A 90 % interval tells {apart.size or 'none'} of {low.size} from "
        f"the typical one{named}."
    )


def slope_figure(run: FitRun, slope: OwnSlope) -> Markup:
    """Each level's own coefficient, ranked."""
    drawn = run.draws(slope.name)
    xlabel, one = (
        slope.words if slope.covariate else f"{slope.words} (no unit)",
        group_words(slope.grouping)[0],
    )
    fig, axes = ranked(drawn, run.labels(slope.grouping), xlabel=xlabel, ylabel=one)
    if run.has(slope.shared):
        typical = np.percentile(run.draws(slope.shared), [5, 95])
        axes.axvspan(*typical, color=POSTERIOR, alpha=0.15, lw=0)
    for value in (0,) if slope.covariate else (0, 1):
        axes.axvline(value, color=REFERENCE, ls="--", lw=1)
    return figure(
        fig,
        f"The {slope.words} of each {one} itself, ranked: posterior median, "
        "50 % and 90 % interval; shaded: the 90 % interval of the typical one.",
    )


_GRID = 60


def ranked_figure(run: FitRun, quantity: str, level: str) -> Markup:
    """K (or C, or another) of every person (``level`` "subject"), condition ("trial") and so on, ranked."""
    variable, (one, _) = f"{quantity}_{stem_of(level)}", group_words(level)
    drawn, name = run.draws(variable), NAMES.get(quantity, quantity)
    unit = UNITS.get(quantity) or run.groups["posterior"][variable].attrs["unit"]
    names = _with_ranks(run.labels(level), drawn)
    fig, _ = ranked(drawn, names, xlabel=f"{name} ({unit})", ylabel=one)
    return figure(
        fig,
        f"{name} of each {one}, ranked: posterior median, 50 % and 90 % interval, "
        "and in brackets the 90 % interval of the rank.",
    )


def _with_ranks(names: list[str], drawn: np.ndarray) -> list[str]:
    """Each name with the 90 % interval of its rank, 1 for the greatest; ``drawn`` is [draw, name]."""
    ranks = 1 + np.argsort(np.argsort(-drawn, axis=1), axis=1)
    low, high = np.percentile(ranks, [5, 95], axis=0).round().astype(int)
    return [
        f"{name} ({a})" if a == b else f"{name} ({a} to {b})"
        for name, a, b in zip(names, low, high, strict=True)
    ]


def mass_figure(run: FitRun, quantity: Quantity) -> Markup:
    """K (or C) over mass on log scales: impacts, conditions, the posterior line, exponents 0 and 1."""
    mass = run.constant("mass_kg")
    grid = np.geomspace(0.93 * mass.min(), 1.07 * mass.max(), _GRID)
    ratio = np.log(grid / run.reference_mass)
    table = shown_rows(side_by_side(run, quantity).assign(mass=mass))
    apparent = apparent_exponent(run, quantity)
    who = "this person" if run.people_count == 1 else "typical person"
    typical = typical_draws(run, quantity)
    level = float(np.median(typical))
    fig, axes = new_figure((4.8, 4.2))
    axes.plot(
        table["mass"], table["dds"], "D", ms=3, mfc="none", mew=0.7, color=PUBLISHED,
        label="thesis's method (dds)",
    )  # fmt: skip
    if apparent:
        line = np.exp(apparent.intercept + apparent.slope.median * ratio)
        axes.plot(grid, line, color=PUBLISHED, lw=1.2)
    axes.plot(table["mass"], table["median"], ".", ms=3.5, color=MUTED, label="impact, posterior median")
    at, drawn = _conditions(run, quantity)
    low, median, high = np.percentile(drawn, [5, 50, 95], axis=0)
    axes.errorbar(
        at, median, [median - low, high - median], fmt="s", ms=4.5, mfc="white", lw=1.2, color=POSTERIOR,
        label=f"condition, {who}, 90 %",
    )  # fmt: skip
    if run.has(f"mass_exponent_{quantity}"):
        slope = run.draws(f"mass_exponent_{quantity}")[:, None] * ratio
        curve = typical[:, None] * np.exp(slope)
        low, middle, high = np.percentile(curve, [5, 50, 95], axis=0)
        axes.fill_between(grid, low, high, color=POSTERIOR, alpha=0.2, lw=0)
        axes.plot(grid, middle, color=POSTERIOR, label=f"{who}, 90 % band")
    axes.plot(grid, level + 0 * grid, color=REFERENCE, ls="--", lw=1, label="exponent 0")
    axes.plot(grid, level * grid / run.reference_mass, color=REFERENCE, ls=":", lw=1.2, label="exponent 1")
    axes.set(
        xscale="log",
        yscale="log",
        xlabel="mass of the impactor, M (kg)",
        ylabel=f"{NAMES[quantity]} ({UNITS[quantity]})",
    )
    log_ticks(axes.xaxis, mass)
    log_ticks(axes.yaxis, table[["median", "dds"]].to_numpy().ravel())
    fig.legend(loc="outside upper left", ncols=2, fontsize=7.5)
    return figure(
        fig,
        f"{NAMES[quantity]} over the mass of the impactor on log scales: posterior of conditions and "
        "impacts with the fitted line, the thesis's point estimates, and lines for exponents 0 and 1.",
    )


def _conditions(run: FitRun, quantity: str) -> tuple[np.ndarray, np.ndarray]:
    """Geometric mean mass of each condition, and draws of a typical person's K or C in it, [draw, trial]."""
    frame = pd.DataFrame(
        {"trial": run.constant("impact_trial").astype(str), "log_mass": np.log(run.constant("mass_kg"))}
    )
    mass = np.exp(frame.groupby("trial")["log_mass"].mean()).reindex(run.labels("trial"))
    return mass.to_numpy(), run.draws(f"{quantity}_trial")


def spreads_figure(run: FitRun) -> Markup:
    """The population's standard deviations of log K and log C, in percent, with 50 % and 90 % intervals."""
    levels = dict.fromkeys(("subject", "trial", *groupings(run), "impact"))
    names = [
        level
        for level in levels
        if any(run.has(f"sd_{stem_of(level)}_{quantity}") for quantity in QUANTITIES)
    ]
    fig, axes = new_figure((4.8, 1.1 + 0.55 * len(names)))
    for shift, colour, mark, quantity in zip((0.14, -0.14), PALETTE, "os", QUANTITIES, strict=False):
        present = [level for level in names if run.has(f"sd_{stem_of(level)}_{quantity}")]
        height = np.array([len(names) - 1 - names.index(level) for level in present]) + shift
        drawn = 100 * np.expm1(
            np.stack([run.draws(f"sd_{stem_of(level)}_{quantity}") for level in present], axis=1)
        )
        draw_intervals(axes, height, drawn, colour, mark, NAMES[quantity])
    axes.set(
        xlabel="standard deviation (% of K or C)",
        yticks=np.arange(len(names))[::-1],
        yticklabels=["impacts" if name == "impact" else group_words(name)[1] for name in names],
        ylim=(-0.6, len(names) - 0.4),
        xlim=(0, None),
    )
    fig.legend(loc="outside upper left", ncols=2)
    return figure(
        fig,
        "Posterior of the standard deviations of K and C between people, conditions, other groups and "
        "impacts, in percent: median, 50 % and 90 % interval.",
    )
