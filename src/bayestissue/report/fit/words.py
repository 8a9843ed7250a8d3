"""The model of the traces in words, and what it can't tell."""

from __future__ import annotations

from importlib.resources import files

import numpy as np
import pandas as pd

from bayestissue.declarations import declared
from bayestissue.hierarchy import SIDE_BY_SIDE
from bayestissue.report.fit.answers import depth_words, has_common_depth
from bayestissue.report.fit.estimates import COVERAGE
from bayestissue.report.fit.run import FitRun
from bayestissue.report.tables import Field, Table, lines, table_of
from bayestissue.report.wording import percent

_MEASURED = files("bayestissue.report.fit").joinpath("coverage.csv")
_WORDS = declared(__package__, "words.toml")
# Of a normal's 5 % point from one draw, over the width from there to its 95 % point: the error of a quantile
# is (p (1 - p))^1/2 over the density there.
_ERROR_OF_END = 0.642


def likelihood_words(run: FitRun) -> str:
    """What each trace is taken for."""
    name, noise = _element(run), _WORDS["recorders"][recorder_noise(run)]
    K_words = _WORDS["own_K" if run.element_alone else "of_both"]
    additions = f" {_WORDS['discrepancy']} {K_words}" if has_discrepancy(run) else ""
    if has_common_depth(run):
        additions += f" K_common_depth is the force over the depth at {depth_words(run)} and at rest."
    if name != SIDE_BY_SIDE:
        from bayestissue.elements import element

        met = element(name)
        meanings = "; ".join(
            f"{parameter.name} ({parameter.unit}): {parameter.meaning}" for parameter in met.parameters
        )
        return (
            f"Each impact's deceleration is that of a mass that meets this at the recorded velocity: "
            f"{met.title}; seen through an accelerometer with {noise}. {meanings}. K_secant, "
            "C_equivalent and energy_lost compare across elements: force over depth at the greatest depth, "
            "the damping beside a spring that loses as much by then, and the share of the kinetic "
            f"energy that is gone when the impactor leaves; ω_n and ζ are those of K_secant and C_equivalent."
            f"{additions}"
        )
    return _WORDS["likelihoods"].get(run.likelihood, "").format(noise=noise) + additions


def has_discrepancy(run: FitRun) -> bool:
    """Whether the fit has a force beside the element's."""
    return bool(run.record.get("discrepancy"))


def recorder_noise(run: FitRun) -> str:
    """The noise of the recorder as the model file names it: "white" or "autoregressive"."""
    return str(run.record.get("model", {}).get("noise", "white"))


def _element(run: FitRun) -> str:
    return str(run.record.get("model", {}).get("element", SIDE_BY_SIDE))


def unused_priors(run: FitRun) -> tuple[str, ...]:
    """Priors that the model file may set and this likelihood has no use for."""
    unused: tuple[str, ...] = () if run.likelihood == "arma" else ("atanh_theta1", "sd_atanh_theta1")
    if not has_discrepancy(run):
        unused = (*unused, "discrepancy", "sd_discrepancy")
    if recorder_noise(run) == "white":
        unused = (*unused, "atanh_noise_correlation", "sd_atanh_noise_correlation")
    return unused


def signal_words(run: FitRun) -> str:
    """The window and the zero of the displacement."""
    signal = run.record.get("model", {}).get("signal", {})
    window, zero = str(signal.get("window", "peak")), str(signal.get("equilibrium", "rest"))
    until = _WORDS["windows"].get(window, f"from contact to {window} of the time to zero velocity")
    text = f"The window goes {until}."
    if run.likelihood == "impact":
        return text
    return f"{text} The zero of x is {_WORDS['equilibria'].get(zero, zero)}."


def limits(run: FitRun) -> list[str]:
    """What this model can't tell, one paragraph each."""
    if run.likelihood not in ("arma", "a2"):
        coloured = recorder_noise(run) != "white"
        return [_WORDS["shape"], *[_WORDS["passes_for_noise"]] * coloured]
    paragraphs = [_WORDS["noise"][run.shown]]
    theta1 = run.of_impacts("theta1")
    if run.likelihood == "arma" and len(theta1):
        near = int((theta1["median"] < -0.99).sum())
        paragraphs.append(f"Here θ₁ lies below −0.99 in {near} of {len(theta1)} impacts (posterior median).")
    return [*paragraphs, _WORDS["shape"]]


def thinned(run: FitRun) -> str:
    """What was kept of single impacts, where they are too many to keep everything; else empty."""
    if run.impact_draws is None:
        return ""
    return (
        f"Impacts are many. Of each of them {run.impact_draws} draws are kept, evenly spaced among the "
        "population's, of which all are kept; so few draws tell the ends of an impact's 90 % interval to "
        f"{percent(_ERROR_OF_END / np.sqrt(run.impact_draws))} of its width. Predictions, leaving one impact "
        f"out and priors of impacts are of {len(run.predicted)} evenly spaced impacts; figures show at most "
        "a thousand."
    )


def coverage_table(run: FitRun) -> Table | None:
    """Coverage of this likelihood's intervals on simulated impacts; None where none was measured."""
    if has_discrepancy(run) or recorder_noise(run) != "white":
        return None
    with _MEASURED.open(encoding="utf-8") as stream:
        coverage = pd.read_csv(stream)
    measured = lines(coverage[coverage["likelihood"] == run.likelihood])
    table = table_of(measured, *COVERAGE)
    return table if measured else None


def excluded_table(run: FitRun) -> Table:
    """The impacts that were left out of the fit, and why."""
    return table_of(run.record["left_out"], Field("impact and reason", str, "words"))


def chain_words(run: FitRun) -> str:
    """What the traces say of the errors of the chain that they tell; empty where they were not asked."""
    if not run.chain:
        return ""
    if not run.chain["passed"]:
        return f"{run.chain['words']} {_WORDS['mass_does_not_show']}"
    return (
        f"What the {run.chain['of']} traces by themselves ask of velocity, gain and offset is as large as "
        "the declared standard deviations let one expect, of all impacts together, of each person and "
        "condition, and of each impact (a right chain raises an alarm in 1 of 200 fits). "
        f"{_WORDS['mass_does_not_show']}"
    )
