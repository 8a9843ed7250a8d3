"""The model of the traces in words, and what it can't tell."""

from __future__ import annotations

from importlib.resources import files

import numpy as np
import pandas as pd

from bayestissue.report.fit.predictions import STRUCTURED, Residuals, inside_band
from bayestissue.report.fit.run import FitRun
from bayestissue.report.tables import Row, Table, columns, lines
from bayestissue.report.wording import percent

COVERAGE = files("bayestissue.report.fit").joinpath("coverage.csv")
_LIKELIHOODS = {
    "arma": "Each impact's displacement x is an ARMA(2,1) with the natural frequency and damping ratio of a mass on "
    "a spring and damper; its moving-average coefficient θ₁ is free, and pooled between impacts.",
    "a2": "Each impact's displacement x is an A(2), a mass on a spring and damper driven by white noise, as it looks "
    "when sampled: θ₁ follows from K, C and the sampling interval.",
    "impact": "Each impact's deceleration is that of a mass that meets a spring and damper at the recorded velocity, "
    "seen through an accelerometer with white noise.",
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
_SHAPE = (
    "No spring and damper of constant K and C is a tissue: stiffening, bottoming out on bone and reflexes are not "
    "in this model, and show as structure in the residuals."
)


def likelihood_words(run: FitRun) -> str:
    """What each trace is taken for."""
    return _LIKELIHOODS.get(run.likelihood, "")


def signal_words(run: FitRun) -> str:
    """The window and the zero of the displacement."""
    signal = run.about.get("model", {}).get("signal", {})
    window, zero = str(signal.get("window", "peak")), str(signal.get("equilibrium", "rest"))
    until = _WINDOWS.get(window, f"from contact to {window} of the time to zero velocity")
    text = f"The window goes {until}."
    if run.likelihood == "impact":
        return text
    return f"{text} The zero of x is {_EQUILIBRIA.get(zero, zero)}."


def limits(run: FitRun) -> list[str]:
    """What this model can't tell, one paragraph each."""
    if run.likelihood not in ("arma", "a2"):
        return [_SHAPE]
    paragraphs = [
        "An accelerometer's white noise, integrated twice, is not the noise of an ARMA(2,1): its fit is driven to "
        "the edge where θ₁ is −1, or its intervals promise more than they hold. models/impact.toml models "
        "the recorded deceleration with white noise instead: fit it to the same data and hold the two side by side."
    ]
    theta1 = run.of_impacts("theta1")
    if run.likelihood == "arma" and len(theta1):
        near = int((theta1["median"] < -0.99).sum())
        paragraphs.append(f"Here θ₁ lies below −0.99 in {near} of {len(theta1)} impacts (posterior median).")
    return [*paragraphs, _SHAPE]


def coverage_table(run: FitRun) -> Table | None:
    """Coverage of this likelihood's intervals, measured on simulated impacts; None where none was measured."""
    with COVERAGE.open(encoding="utf-8") as stream:
        every = pd.read_csv(stream)
    rows = [
        Row(
            (
                str(line.quantity),
                f"{line.level:g} %",
                f"{line.held} of {line.impacts}",
                percent(line.held / line.impacts),
                str(line.command),
            )
        )
        for line in lines(every[every["likelihood"] == run.likelihood])
    ]
    titles = ("quantity", "interval", "hold the truth", "share", "measured by")
    return Table(columns(*titles, number=titles[1:4], words=titles[4:]), rows) if rows else None


def residual_words(left: Residuals, one_step: np.ndarray) -> list[str]:
    """Whether the residuals have structure, and whether the model expects what they have."""
    p = left.whiteness_p[np.isfinite(left.whiteness_p)]
    sentences = [f"{percent(inside_band(left))} of all measured samples lie in the predicted 90 % band."]
    if p.size:
        sentences.append(_structure("Measured less predicted", p))
    if one_step.size:
        sentences.append(_structure("One step ahead, by the exact ARMA(2,1) point fit", one_step))
    table = left.lag_one
    inside = int(table["measured"].between(table["low"], table["high"]).sum())
    words = f"At lag 1 the model expects what {inside} of {len(table)} impacts show"
    if inside < 0.75 * len(table):
        words += ": its noise is not the recorder's"
    return [*sentences, f"{words}."]


def _structure(what: str, p: np.ndarray) -> str:
    count = int((p < STRUCTURED).sum())
    verdict = (
        "the residuals have structure that the model does not explain"
        if count > max(3, 0.05 * p.size)
        else "no more structure than chance gives"
    )
    return f"{what}: {count} of {p.size} impacts have p below 0.01, where white residuals give about 1 %: {verdict}."
