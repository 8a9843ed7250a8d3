"""A finished `reproduce` run, read whole, and its figures; the thesis's own figures drawn anew among them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pandas as pd

from bayestissue.base.declarations import sentences
from bayestissue.inference.results.meanings import COLUMNS, NAMES
from bayestissue.recordings.dataset.published import PublishedTables
from bayestissue.reports.figures import study_comparisons
from bayestissue.reports.figures.impacts import MASS, axis_title, over_mass
from bayestissue.reports.figures.intervals import intervals, quantiles
from bayestissue.reports.figures.theme import Figure, number
from bayestissue.reports.pages.posterior import mass_curve
from bayestissue.reports.pages.run_folder import POSTERIOR_TABLES, PosteriorRun, of_table
from bayestissue.thesis.reproduction.conditions import Quantity, conditions
from bayestissue.thesis.reproduction.relations import correlation_figure, printed_line, straight_line

said = sentences(__package__)
_THESIS = "line of the thesis"
_GROUPS = ("posterior", "observed_data", "posterior_predictive", "constant_data")


@dataclass(frozen=True, eq=False, repr=False)
class PublishedRun(PosteriorRun):
    """A finished `reproduce` run."""

    opened = _GROUPS
    needed: ClassVar = dict.fromkeys(_GROUPS, ())
    table_files = (*POSTERIOR_TABLES, "reproduction", "audit", "comparison", "predictive_checks")
    again = "Make the run anew with `bayestissue reproduce`."

    reproduction = of_table("reproduction", "Every published number beside the recomputed one.")
    audit = of_table("audit", "What the audit found, the worst first.")
    comparison = of_table("comparison", "How well each explanation predicts.")
    predictive_checks = of_table("predictive_checks", "Statistics of the data beside those predicted.")

    def observed(self, name: str) -> np.ndarray:
        """What was published, such as ``K_observed`` [impact]."""
        return self.groups["observed_data"][name].to_numpy()

    @property
    def reference_mass(self) -> float:
        """The mass in kg at which people and conditions are reported."""
        return float(self.constant("reference_mass_kg"))


def inside_share(run: PublishedRun, quantity: str) -> tuple[int, int]:
    """How many published impacts lie inside their 90 % predictive interval, and how many there are."""
    observed = run.observed(f"{quantity}_observed")
    low, high = np.percentile(run.draws(f"{quantity}_observed", "posterior_predictive"), [5, 95], axis=0)
    return int(np.sum((observed >= low) & (observed <= high))), observed.size


def _impacts(run: PublishedRun) -> pd.DataFrame:
    """Of each published impact its name, person, condition and mass."""
    of_trial, of_subject = run.constant("impact_trial"), run.constant("impact_subject")
    return pd.DataFrame(
        {
            "impact": run.labels("impact"),
            "person": np.array(run.labels("subject"))[of_subject],
            "condition": np.array(run.labels("trial"))[of_trial],
            "mass_kg": run.constant("mass_kg")[of_trial],
        }
    )


def predictive_figure(run: PublishedRun, quantity: str) -> Figure:
    """Published impacts over the predictive interval of their condition, both in % of its median.

    The predictive draws of a condition's impacts are pooled, so a bar is what the model expects of an
    impact on one of its people.
    """
    predicted = run.draws(f"{quantity}_observed", "posterior_predictive")
    rows, observed = _impacts(run), run.observed(f"{quantity}_observed")
    subject, of_trial = run.constant("impact_subject"), run.constant("impact_trial")
    bars, off = [], np.empty(len(rows))
    for trial in np.unique(of_trial):
        member = of_trial == trial
        draws = predicted[:, member]
        middle = np.median(draws)
        # One bar per condition: at most a few dozen, each from all of its draws.
        bars.append(quantiles(100 * (draws.reshape(-1, 1) / middle - 1), [run.labels("trial")[trial]]))
        off[member] = 100 * (observed[member] / middle - 1)
    return intervals(
        pd.concat(bars, ignore_index=True),
        f"{quantity} off the predicted median (%)",
        said("figures.predictive", name=NAMES[quantity]),
        points=rows.assign(label=rows["condition"], value=off, offset=subject / max(subject.max(), 1) - 0.5),
        lines=(0,),
        straight=True,
    )


def posterior_mass_figure(run: PublishedRun, quantity: str, line: tuple[float, float]) -> Figure:
    """K (or C) over mass: published estimates, the typical person with its band, and the thesis's line.

    ``line`` is the thesis's intercept and slope over mass.
    """
    mass, trials = run.constant("mass_kg"), run.labels("trial")
    curve = mass_curve(run, quantity, mass, run.reference_mass)
    straight = line[0] + line[1] * curve["mass_kg"]
    curve[_THESIS] = straight.where(straight > 0)
    lost = [trials.index(str(trial)) for trial in run.observed("averaged_trial")]
    value, sd = run.observed(f"{quantity}_average"), run.observed(f"{quantity}_sd")
    printed = {"value": value, "low": value - sd, "high": value + sd, "kind": "mean ± sd, rows lost"}
    return over_mass(
        _impacts(run).assign(**{COLUMNS[quantity]: run.observed(f"{quantity}_observed")}),
        quantiles(run.draws(f"{quantity}_trial"), trials).assign(mass_kg=mass),
        curve,
        quantity,
        said("figures.over_mass", name=NAMES[quantity]),
        others=[pd.DataFrame({"mass_kg": mass[lost], **printed})],
    )


def deviations(run: PublishedRun, quantity: str) -> tuple[np.ndarray, np.ndarray]:
    """Published and posterior K (or C) of each impact over a typical person's in its condition, less one.

    Returns:
        The published deviation [impact] and the posterior's 5 %, 50 % and 95 % points [point, impact].
    """
    typical = np.median(run.draws(f"{quantity}_trial"), axis=0)[run.constant("impact_trial")]
    points = np.percentile(run.draws(quantity), [5, 50, 95], axis=0)
    return run.observed(f"{quantity}_observed") / typical - 1, points / typical - 1


def kept_share(run: PublishedRun, quantity: str) -> float:
    """The slope of posterior on published deviations: 1 is no shrinkage, 0 is all of it."""
    published, points = deviations(run, quantity)
    return float(np.polyfit(published, points[1], 1)[0])


def shrinkage_figure(run: PublishedRun, quantity: str) -> Figure:
    """Posterior over published deviation from a typical person's in the condition, in %, by impact."""
    published, (low, median, high) = (100 * part for part in deviations(run, quantity))
    rows = _impacts(run).assign(
        published=published, posterior=median, low=low, high=high, kind="person in that condition"
    )
    ends = [published.min(), published.max()]
    lines = pd.DataFrame({"published": ends * 2, "posterior": [*ends, 0.0, 0.0]})
    return study_comparisons.points(
        rows,
        number("published", f"published {quantity}, off a typical person's in the condition (%)"),
        number("posterior", f"posterior {quantity}, off the same (%)"),
        said("figures.shrinkage", name=NAMES[quantity]),
        lines=lines.assign(line=np.repeat(["taken at its word", "given up"], 2)),
    )


def correlations_plot(published: PublishedTables, quantity: Quantity, *, averages: bool) -> Figure:
    """Figures 5.1 (K) and 5.2 (C) over all impacts, 5.3 (K) and 5.4 (C) over averages: falling |r|."""
    rows = correlation_figure(published, quantity, averages=averages)
    over = "averages" if averages else "all impacts"
    recomputed, printed = rows["correlation"].abs(), rows["published"].abs()
    return intervals(
        pd.DataFrame({"label": rows["variable"], "value": recomputed, "printed": printed}),
        f"absolute correlation with {quantity}, {over} (no unit)",
        said("figures.correlations", name=NAMES[quantity], over=over),
        points=pd.DataFrame({"label": rows["variable"], "value": printed}).dropna(),
        domain=(0, 1),
        straight=True,
    )


def mass_plot(published: PublishedTables, quantity: Quantity) -> Figure:
    """Figures 5.5 (K) and 5.6 (C): every remaining impact and the averages, over the mass."""
    table, column = conditions(published, quantity), COLUMNS[quantity]
    impacts = published.estimates.rename(columns={quantity: column})[["mass_kg", column]]
    averages = table.rename(columns={"average": column})[["mass_kg", column]]
    kinds = np.where(table["from_rows"], "average", "average, rows lost")
    ends = np.array([0.0, 1.05 * table["mass_kg"].max()])
    refitted, line = straight_line(table).params, printed_line(published, quantity)
    lines = {_THESIS: line, "refitted": (refitted["const"], refitted["Mass"])}
    return study_comparisons.points(
        pd.concat([impacts.assign(kind="impact"), averages.assign(kind=kinds)], ignore_index=True),
        number("mass_kg", MASS),
        number(column, axis_title(quantity)),
        said("figures.mass", name=NAMES[quantity]),
        lines=pd.concat(
            pd.DataFrame({"mass_kg": ends, column: pair[0] + pair[1] * ends, "line": name})
            for name, pair in lines.items()
        ),
    )
