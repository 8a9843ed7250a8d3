"""Whether what formulas take for granted holds: straight lines, and parameters alike at all levels.

`straight_lines` asks whether log K and log C are straight lines of the numbers that formulas take as such,
`pooled_parameters` whether a further parameter of the element differs between levels that its own formula
takes as alike.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import xarray as xr
from jaxtyping import Float, Int
from scipy.linalg import solve_triangular
from scipy.stats import chi2, f_oneway

from bayestissue.base.declarations import general
from bayestissue.base.errors import Coded
from bayestissue.base.impact_arrays import IndexPerImpact
from bayestissue.base.remedies import sentence
from bayestissue.inference.checking.findings import Finding
from bayestissue.inference.execution.kept import some_impacts
from bayestissue.mechanics.elements.element import Element
from bayestissue.model.hierarchy.design import Design, ResponseDesign
from bayestissue.model.hierarchy.formulas.group_terms import GroupTerm, grouping_of, labels_of
from bayestissue.model.hierarchy.levels import design_at
from bayestissue.model.hierarchy.recorded import Condition, Recorded
from bayestissue.model.hierarchy.responses import RESPONSES, parameter_of, sd_impact

# Of a fit of straight lines one in a thousand is noted.
_BY_CHANCE = 0.001
# Of more values as many classes are made.
_MOST_LEVELS = 6


class Pooled(NamedTuple):
    """A further parameter that is pooled over a factor's levels.

    Attributes:
        parameter: its name.
        factor: the levels' columns, such as "pad" or "subject:side".
        term: what its formula would have of them.
        p: twice the median p-value: see `pooled_parameters`.
        medians: at each level, of the impacts' geometric mean.
        unit: of these.
    """

    parameter: str
    factor: str
    term: str
    p: float
    medians: dict[str, float]
    unit: str

    @property
    def words(self) -> Coded:
        """What differs, between which levels, and the line of the model file that lets it."""
        low, high = (choose(self.medians, key=lambda level: self.medians[level]) for choose in (min, max))
        ends = " and ".join(
            f"{general(self.medians[level], 3)} {self.unit} at {level}" for level in (low, high)
        )
        names = {"parameter": self.parameter, "factor": self.factor}
        return Coded.stated("pooled-parameter.fit", ends=ends, term=self.term, **names)

    @property
    def note(self) -> Coded:
        """Of a prediction, in few words."""
        names = {"parameter": self.parameter, "factor": self.factor}
        return Coded.stated("pooled-parameter.prediction", **names)

    def record(self) -> dict[str, Any]:
        """As it stands in ``diagnostics.json``."""
        first = sentence("pooled-parameter.first")
        return Finding("pooled-parameter", passed=False, words=self.words, first=first).record(
            **self._asdict()
        )


def pooled_parameters(
    posterior: xr.Dataset, recorded: Recorded, element: Element, level: float = 0.01
) -> list[Pooled]:
    """The further parameters that differ between levels of what K's or C's formula has and theirs has not.

    Under the model the deviations of an impact's parameter theta_i from what its formula expects,

        z_i = (log theta_i - x_i b) / sd,

    are independent standard normals, in the prior and so, over all data, in a draw of the posterior too,
    whatever the traces say of each (pivotal quantities: Johnson 2007, Bayesian Analysis 2, 719-734). So the
    p-value of the analysis of variance of z over levels is uniform in each draw, and twice its median over
    draws is a p-value: of uniform variables, however dependent, half and more lie below a / 2 with
    probability a at most. Traces that hardly tell theta add noise to z, which hides differences and makes
    none.

    Args:
        posterior: its draws.
        recorded: what was measured.
        element: of the fit.
        level: of significance: the probability that anything differs by chance, at most.

    Returns:
        Each such parameter and factor that differs; all that are tested share the level (Bonferroni).
    """
    rows, tested = some_impacts(len(recorded.rows)), []
    for extra in element.extra:
        if extra.name not in posterior:
            continue
        factors = _lacking(recorded, extra.name)
        groupings = {term: grouping_of(recorded.rows.iloc[rows], names) for term, names in factors.items()}
        # With one impact of each level among them nothing tells a level from an impact.
        telling = {k: g for k, g in groupings.items() if 1 < len(g.levels) < len(rows)}
        if not telling:
            continue
        logs, z = _deviations(posterior, recorded, extra.name, rows)
        for term, grouping in telling.items():
            of_levels = [grouping.code == number for number in range(len(grouping.levels))]
            p = min(1.0, 2 * float(np.median(f_oneway(*(z[here] for here in of_levels)).pvalue)))
            middle = np.exp([np.median(logs[here].mean(axis=0)) for here in of_levels])
            medians = dict(zip(map(str, grouping.levels), map(float, middle), strict=True))
            tested.append(Pooled(extra.name, grouping.name, term, p, medians, extra.unit))
    return [one for one in tested if one.p < level / len(tested)]


def _lacking(recorded: Recorded, name: str) -> dict[str, tuple[str, ...]]:
    """The factors of the formulas of K and C that a parameter's lacks, by the term that it would have."""
    columns = set(recorded.response(name).terms.columns)
    terms: dict[tuple[str, ...], str] = {}
    for response in RESPONSES:
        for column in recorded.response(response).categories:
            terms[(column,)] = f"C({column})" if recorded.is_number(column) else column
        for term in recorded.response(response).terms.groups:
            terms.setdefault(term.factors, str(GroupTerm(term.factors)))
    return {term: factors for factors, term in terms.items() if not set(factors) <= columns}


def _deviations(
    posterior: xr.Dataset, recorded: Recorded, name: str, rows: Int[np.ndarray, " row"], count: int = 200
) -> tuple[Float[np.ndarray, "row draw"], Float[np.ndarray, "row draw"]]:
    """Of about ``count`` draws, enough for a median: log theta of some impacts, and z."""
    theta, draws = posterior[name], posterior
    if "kept_draw" in theta.dims:
        draws = posterior.isel(draw=posterior["kept_draw"].to_numpy())
    step = max(1, draws.sizes["chain"] * draws.sizes["draw"] // count)
    draws = draws.isel(draw=slice(None, None, step))
    logs = np.log(theta.transpose("chain", ..., "impact").to_numpy()[:, ::step][..., rows])
    parameter = parameter_of(name)
    table = recorded.rows.iloc[rows]
    labels: dict[str, np.ndarray] = {
        column: labels_of(table[column]) if column in recorded.named else table[column].to_numpy(float)
        for column in recorded.response(name).terms.columns
    }
    conditions: list[Condition] = [
        {column: values[row] for column, values in labels.items()} for row in range(len(rows))
    ]
    expected = design_at(recorded, name, conditions).log(draws)
    z = (logs - expected) / draws[sd_impact(parameter)].to_numpy()[..., None]
    return logs.reshape(-1, len(rows)).T, z.reshape(-1, len(rows)).T


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
            column = (part.covariates[:, i] * part.scale[i]).round(12)
            values = recorded[name].to_numpy(float) if name in recorded else column
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
