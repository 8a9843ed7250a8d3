"""Whether log K and log C are straight lines of the numbers that formulas take as such."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from jaxtyping import Float
from scipy.linalg import solve_triangular
from scipy.stats import chi2

from bayestissue.base.arrays import IndexPerImpact
from bayestissue.base.remedies import sentence
from bayestissue.inference.checking.findings import Finding
from bayestissue.inference.execution.kept import some_impacts
from bayestissue.model.hierarchy.design import Design, ResponseDesign
from bayestissue.model.hierarchy.responses import RESPONSES, sd_impact

# Of a fit of straight lines one in a thousand is noted.
_BY_CHANCE = 0.001
# Of more values as many classes are made.
_MOST_LEVELS = 6


def straight_lines(
    design: Design, posterior: xr.Dataset, log_mass_sd: float = 0.0, mass_group: IndexPerImpact | None = None
) -> dict[str, Any]:
    """The entry ``straight_lines`` of ``diagnostics.json``.

    Beside the line X beta of log K (log C alike) each of a covariate's values, or of six classes of them,
    has a deviation of its own, gamma, flat a priori. Given the standard deviations at their posterior
    medians, and the impacts' posterior means y, gamma is normal about the generalised least squares
    estimate of

        y = X beta + D gamma + e,   cov(e) = sd_impact^2 I + sum over group terms of sd^2 Z Z',

    and gamma' cov(gamma)^-1 gamma is chi-squared where the line is straight. Posterior means are drawn to
    the line and the standard deviations hold what it lacks: chance is noted less often than stated.

    Args:
        design: the formulas evaluated over the impacts.
        posterior: its draws.
        log_mass_sd: of the impacts' recorded masses.
        mass_group: which error of its mass each impact has, where impacts share these; else each its own.

    Returns:
        ``lines``, a row for each covariate and response: ``of``, ``covariate``, ``p`` and ``off_the_line``,
        the fraction by which the response lies off the line at each value; and ``words``, empty where all
        are straight.
    """
    rows = some_impacts(len(design.subject))
    shares = np.arange(len(design.subject)) if mass_group is None else mass_group
    recorded, lines = design.recorded.rows, list[dict[str, Any]]()
    for q, part in design.responses.items():
        if q not in posterior or "impact" not in posterior[q].dims:
            continue
        drawn = np.log(posterior[q].transpose("impact", ...).to_numpy()).reshape(len(design.subject), -1)
        # K and C are in proportion to the mass.
        y, cov = drawn.mean(axis=1)[rows], _covariance(design, part, posterior, rows)
        cov += (log_mass_sd * (q in RESPONSES)) ** 2 * (shares[rows, None] == shares[rows])
        x = [np.ones((len(rows), 1)), part.covariates[rows]]
        x += [] if part.log_mass is None else [part.log_mass[rows, None]]
        root = np.linalg.cholesky(cov)
        for i, name in enumerate(part.names):
            # A column as it was recorded; what is made of columns, "log(dose)" say, less its reference.
            made = (part.covariates[:, i] * part.scale[i]).round(12)
            values = recorded[name].to_numpy(float) if name in recorded else made
            levels = _levels(values)[rows]
            if ":" in name or "[" in name or levels.nunique() < 3:
                continue
            p, off = _judged(y, np.hstack(x), root, levels, values[rows])
            lines.append({"of": q, "covariate": name, "p": p, "off_the_line": off})
    limit = _BY_CHANCE / max(len(lines), 1)
    words = " ".join(_words(line) for line in lines if line["p"] < limit)
    if not words:
        return {"lines": lines, "words": words}
    first = sentence("no-straight-line.first")
    return Finding("no-straight-line", passed=False, words=words, first=first).record(lines=lines)


def _covariance(
    design: Design, part: ResponseDesign, posterior: xr.Dataset, rows: np.ndarray
) -> Float[np.ndarray, "row row"]:
    q = part.response
    cov = float(posterior[sd_impact(part.parameter)].median()) ** 2 * np.eye(len(rows))
    for term, column in part.terms.items():
        code, scaled = design.groupings[term.grouping].code[rows], column.covariate[rows] * column.scale
        sd = float(posterior[term.sd(q)].median())
        cov += sd**2 * (code[:, None] == code) * np.outer(scaled, scaled)
    return cov


def _levels(values: np.ndarray) -> pd.Series:
    """The class of each value: the value itself, or one of six where there are more."""
    if len(np.unique(values)) <= _MOST_LEVELS:
        return pd.Series(values)
    return pd.Series(pd.qcut(values, _MOST_LEVELS, duplicates="drop").codes)


def _judged(
    y: Float[np.ndarray, " row"],
    x: Float[np.ndarray, "row column"],
    root: Float[np.ndarray, "row row"],
    levels: pd.Series,
    values: Float[np.ndarray, " row"],
) -> tuple[float, dict[str, float]]:
    dummies = pd.get_dummies(levels, dtype=float).to_numpy()
    white_y, white_x, white_d = (solve_triangular(root, part, lower=True) for part in (y, x, dummies))
    left_y, left_d = (
        part - white_x @ np.linalg.lstsq(white_x, part, rcond=None)[0] for part in (white_y, white_d)
    )
    u, size, vt = np.linalg.svd(left_d, full_matrices=False)
    # What the other columns and the line itself say has no size but rounding.
    known = size > 1e-8 * np.linalg.norm(white_d)
    along = u[:, known].T @ left_y
    gamma = vt[known].T @ (along / size[known])
    line = np.column_stack([np.ones_like(values), values])
    bend = dummies @ gamma
    bend -= line @ np.linalg.lstsq(line, bend, rcond=None)[0]
    off = pd.Series(np.expm1(bend)).groupby(np.asarray(levels)).mean()
    middle = pd.Series(values).groupby(np.asarray(levels)).mean()
    p = float(chi2.sf(along @ along, known.sum())) if known.any() else 1.0
    return p, {f"{at:.4g}": float(by) for at, by in zip(middle, off, strict=True)}


def _words(line: dict[str, Any]) -> str:
    """What to do about a line that is none, with how far off it lies."""
    name, q = line["covariate"], line["of"]
    off = ", ".join(f"{by:+.0%} at {at}".replace("-", "−", 1) for at, by in line["off_the_line"].items())
    whole = name.isidentifier() and len(line["off_the_line"]) < _MOST_LEVELS
    remedy = sentence(f"no-straight-line.{'categories' if whole else 'transform'}", name=name)
    return sentence("no-straight-line.off", q=q, name=name, off=off, remedy=remedy)
