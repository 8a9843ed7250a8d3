"""The model of the traces in words, and what it can't tell."""

from __future__ import annotations

import math
from importlib.resources import files
from statistics import NormalDist

import pandas as pd

from bayestissue.model.hierarchy import SIDE_BY_SIDE
from bayestissue.reports.pages.fit.answers import depth_words, has_common_depth
from bayestissue.reports.pages.fit.fit_run import FitRun
from bayestissue.reports.pages.fit.method_agreement import COVERAGE
from bayestissue.reports.pages.fit.sentences import SENTENCES, said
from bayestissue.reports.pages.page_tables import Field, Table, table_of
from bayestissue.reports.pages.wording import percent

# Parameters of impacts that not every model and dataset has.
_OF_SOME_FITS = ("atanh_theta1", "contact", "log_gain", "discrepancy", "noise_force", "log_force_ratio")
_MEASURED = files("bayestissue.reports.pages.fit").joinpath("coverage.csv")


def likelihood_words(run: FitRun) -> str:
    """What each trace is taken for."""
    name = _element(run)
    additions = []
    if has_discrepancy(run):
        additions += [said("model.discrepancy"), said(f"model.{'own_K' if run.element_alone else 'of_both'}")]
    if has_common_depth(run):
        additions.append(said("model.at_common_depth", depth=depth_words(run)))
    other: dict[str, str] = {}
    if name != SIDE_BY_SIDE:
        from bayestissue.mechanics.elements import element

        met = element(name)
        meanings = "; ".join(f"{one.name} ({one.unit}): {one.meaning}" for one in met.parameters)
        other = {"title": met.title, "meanings": meanings}
    law = said("model.element", **other) if other else said(f"likelihoods.{run.likelihood}")
    return " ".join([law, *additions])


def has_discrepancy(run: FitRun) -> bool:
    """Whether the fit has a force beside the element's."""
    return bool(run.record.get("discrepancy"))


def _element(run: FitRun) -> str:
    return str(run.record.get("model", {}).get("element", SIDE_BY_SIDE))


def unused_priors(run: FitRun) -> tuple[str, ...]:
    """Priors that the model file may set and this fit has no use for."""
    known = set(run.summary["variable"])
    unused = (name for name in _OF_SOME_FITS if f"{name}_mean" not in known)
    return tuple(prior for name in unused for prior in (name, f"sd_{name}"))


def signal_words(run: FitRun) -> str:
    """The window."""
    window = str(run.record.get("model", {}).get("signal", {}).get("window", "peak"))
    until = SENTENCES["windows"].get(window, f"from contact to {window} of the time to zero velocity")
    return f"The window goes {until}."


def limits(run: FitRun) -> list[str]:
    """What this model can't tell, one paragraph each."""
    if run.likelihood not in ("arma", "a2"):
        return [said("model.shape")]
    paragraphs = [said(f"noise.{run.shown}")]
    theta1 = run.of_impacts("theta1")
    if run.likelihood == "arma" and len(theta1):
        near = int((theta1["median"] < -0.99).sum())
        paragraphs.append(said("model.near_edge", near=near, all=len(theta1)))
    return [*paragraphs, said("model.shape")]


def thinned(run: FitRun) -> str:
    """What was kept of single impacts, where they are too many to keep everything; else empty."""
    if run.impact_draws is None:
        return ""
    error = percent(error_of_end(run.impact_draws))
    return said("model.thinned", draws=run.impact_draws, error=error, predicted=len(run.predicted))


def error_of_end(draws: int, p: float = 0.05) -> float:
    """Standard error of a normal's ``p`` quantile by so many draws, as a share of the interval's width.

    That is (p (1 - p) / draws)^1/2 over the density there, and the interval from there to the quantile 1 - p.
    """
    normal = NormalDist()
    end = normal.inv_cdf(p)
    return math.sqrt(p * (1 - p) / draws) / normal.pdf(end) / (-2 * end)


def coverage_table(run: FitRun) -> Table | None:
    """Coverage of this likelihood's intervals on simulated impacts; None where none was measured."""
    if has_discrepancy(run):
        return None
    with _MEASURED.open(encoding="utf-8") as stream:
        coverage = pd.read_csv(stream)
    measured = coverage[coverage["likelihood"] == run.likelihood]
    return None if measured.empty else table_of(measured, *COVERAGE)


def excluded_table(run: FitRun) -> Table:
    """The impacts that were left out of the fit, and why."""
    return table_of(run.record["left_out"], Field("impact and reason", str, "words"))


def chain_words(run: FitRun) -> str:
    """What the traces say of the errors of the chain that they tell; empty where they were not asked."""
    if not run.chain:
        return ""
    sound = said("model.chain_as_declared", of=run.chain["of"])
    return f"{sound if run.chain['passed'] else run.chain['words']} {said('model.mass_does_not_show')}"
