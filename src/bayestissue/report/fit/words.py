"""The model of the traces in words, and what it can't tell."""

from __future__ import annotations

from importlib.resources import files

import numpy as np
import pandas as pd

from bayestissue.elements.element import Element
from bayestissue.elements.registry import element
from bayestissue.hierarchy.specification import SIDE_BY_SIDE
from bayestissue.report.fit.answers import depth_words, has_common_depth
from bayestissue.report.fit.estimates import COVERAGE
from bayestissue.report.fit.run import FitRun
from bayestissue.report.tables import Field, Table, lines, table_of
from bayestissue.report.wording import percent

_MEASURED = files("bayestissue.report.fit").joinpath("coverage.csv")
_LIKELIHOODS = {
    "arma": "Each impact's displacement x is an ARMA(2,1) with the natural frequency and damping ratio of a "
    "mass on a spring and damper; its moving-average coefficient θ₁ is free, and pooled between impacts.",
    "a2": "Each impact's displacement x is an A(2), a mass on a spring and damper driven by white noise, as "
    "it looks when sampled: θ₁ follows from K, C and the sampling interval.",
    "impact": "Each impact's deceleration is that of a mass that meets a spring and damper at the recorded "
    "velocity, seen through an accelerometer with {noise}.",
}
_RECORDERS = {
    "white": "white noise",
    "autoregressive": "first-order autoregressive noise, whose correlation from sample to sample the traces "
    "tell and impacts share in part; the noise that is given relative to the peak is that of its shocks",
}
_WINDOWS = {
    "peak": "from contact to zero velocity, the greatest displacement",
    "rebound": "from contact until the impactor leaves again",
}
_EQUILIBRIA = {
    "rest": "the position at contact, where the spring is at rest",
    "sample-mean": "the mean of the samples, as the thesis has it, which makes K and C too large",
    "estimated": "estimated along with the rest",
}
_NOISE = {
    "deceleration": "An accelerometer's white noise, integrated twice, is not the noise of an ARMA(2,1): "
    "its fit is driven to the edge where θ₁ is −1, or its intervals promise more than they hold. "
    "models/impact.toml models the recorded deceleration with white noise instead: fit it to the same data "
    "and hold the two side by side.",
    "displacement": "White noise of a position sensor, added to x, makes an ARMA(2,2) of an A(2), not an "
    "ARMA(2,1): where the sensor's noise is not small, the intervals of K and C promise more than they "
    "hold. models/impact.toml has white noise, but of a recorded deceleration, which these data lack.",
}
# Of a normal's 5 % point from one draw, over the width from there to its 95 % point: the error of a quantile
# is (p (1 - p))^1/2 over the density there.
_ERROR_OF_END = 0.642
_SHAPE = (
    "No spring and damper of constant K and C is a tissue: stiffening, bottoming out on bone and reflexes "
    "are not in this model, and show as structure in the residuals."
)
_MASS_DOES_NOT_SHOW = (
    "A wrong mass does not show: it makes K and C of an impact wrong by one factor, and its trace no other."
)
_PASSES_FOR_NOISE = (
    "Correlated noise may take up what another law leaves over: structure shows less in the residuals than "
    "it would beside white noise, and this program adds no discrepancy then."
)
_DISCREPANCY = (
    "Beside it acts a discrepancy: a smooth force of unknown shape, a Gaussian process over the window's own "
    "time with a correlation length of 0.3 of it and a size that the traces tell. K_secant, the force over "
    "the depth at the greatest depth, and ω_n and ζ are those of both together. "
)
_OWN_K = (
    "So is K, of impacts, people and the population: beside a spring K and a damper it would be the same. "
    "The spring's own stiffness is K_tangent; C is the damper's own, widened by what they share with the "
    "discrepancy."
)
_OWN_C = (
    "So is K, of impacts, people and the population, in place of the element's own; what that makes at "
    "contact is K_tangent. C is the element's own, widened by what it shares with the discrepancy."
)


def likelihood_words(run: FitRun) -> str:
    """What each trace is taken for."""
    met, noise = _element(run), _RECORDERS[recorder_noise(run)]
    K_words = _OWN_K if met.name == SIDE_BY_SIDE else _OWN_C
    additions = f" {_DISCREPANCY}{K_words}" if has_discrepancy(run) else ""
    if has_common_depth(run):
        additions += f" K_common_depth is the force over the depth at {depth_words(run)} and at rest."
    if met.name != SIDE_BY_SIDE:
        meanings = "; ".join(
            f"{parameter.name} ({parameter.unit}): {parameter.meaning}" for parameter in met.parameters
        )
        return (
            f"Each impact's deceleration is that of a mass that meets this at the recorded velocity: "
            f"{met.title}; seen through an accelerometer with {noise}. {meanings}. K_secant, "
            "C_equivalent and energy_lost compare across elements: force over depth at the greatest depth, "
            "the damping beside a spring that loses as much by then, and the share of the energy that is "
            f"gone when the impactor leaves; ω_n and ζ are those of K_secant and C_equivalent.{additions}"
        )
    return _LIKELIHOODS.get(run.likelihood, "").format(noise=noise) + additions


def has_discrepancy(run: FitRun) -> bool:
    """Whether the fit has a force beside the element's."""
    return bool(run.record.get("discrepancy"))


def recorder_noise(run: FitRun) -> str:
    """The noise of the recorder as the model file names it: "white" or "autoregressive"."""
    return str(run.record.get("model", {}).get("noise", "white"))


def _element(run: FitRun) -> Element:
    return element(run.record.get("model", {}).get("element", SIDE_BY_SIDE))


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
    until = _WINDOWS.get(window, f"from contact to {window} of the time to zero velocity")
    text = f"The window goes {until}."
    if run.likelihood == "impact":
        return text
    return f"{text} The zero of x is {_EQUILIBRIA.get(zero, zero)}."


def limits(run: FitRun) -> list[str]:
    """What this model can't tell, one paragraph each."""
    if run.likelihood not in ("arma", "a2"):
        return [_SHAPE] if recorder_noise(run) == "white" else [_SHAPE, _PASSES_FOR_NOISE]
    paragraphs = [_NOISE[run.shown]]
    theta1 = run.of_impacts("theta1")
    if run.likelihood == "arma" and len(theta1):
        near = int((theta1["median"] < -0.99).sum())
        paragraphs.append(f"Here θ₁ lies below −0.99 in {near} of {len(theta1)} impacts (posterior median).")
    return [*paragraphs, _SHAPE]


def thinned(run: FitRun) -> str:
    """What was kept of single impacts, where they are too many to keep everything; else empty."""
    if run.impact_draws is None:
        return ""
    drawn = (
        " The population itself was drawn by chains with independent proposals about its posterior mode, "
        "which many impacts make nearly normal."
        if run.record.get("sampler_of_population") == "independence chains"
        else ""
    )
    return (
        f"Impacts are many. Of each of them {run.impact_draws} draws are kept, evenly spaced among the "
        "population's, of which all are kept; so few draws tell the ends of an impact's 90 % interval to "
        f"{percent(_ERROR_OF_END / np.sqrt(run.impact_draws))} of its width. Predictions, leaving one impact "
        f"out and priors of impacts are of {len(run.predicted)} evenly spaced impacts; figures show at most "
        f"a thousand.{drawn}"
    )


def coverage_table(run: FitRun) -> Table | None:
    """Coverage of this likelihood's intervals on simulated impacts; None where none was measured."""
    if has_discrepancy(run) or recorder_noise(run) != "white":
        return None
    with _MEASURED.open(encoding="utf-8") as stream:
        coverage = pd.read_csv(stream)
    measured = lines(coverage[coverage["likelihood"] == run.likelihood])
    table = table_of(
        measured,
        *COVERAGE,
        Field("measured by", lambda line: str(line.command), "words"),
        Field("state", lambda line: str(line.measured), "words"),
    )
    return table if measured else None


def excluded_table(run: FitRun) -> Table:
    """The impacts that were left out of the fit, and why."""
    return table_of(run.record["left_out"], Field("impact and reason", str, "words"))


def chain_words(run: FitRun) -> str:
    """What the traces say of the errors of the chain that they tell; empty where they were not asked."""
    if not run.chain:
        return ""
    if not run.chain["passed"]:
        return f"{run.chain['words']} {_MASS_DOES_NOT_SHOW}"
    return (
        f"What the {run.chain['of']} traces by themselves ask of velocity, gain and offset is as large as "
        "the declared standard deviations let one expect, of all impacts together, of each person and "
        "condition, and of each impact (a right chain raises an alarm in 1 of 200 fits). "
        f"{_MASS_DOES_NOT_SHOW}"
    )
