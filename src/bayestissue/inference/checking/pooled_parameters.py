"""Whether an element's further parameter differs between levels that its own formula takes as alike."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Float, Int
from scipy.stats import f_oneway

from bayestissue.base.declarations import general
from bayestissue.base.errors import Coded
from bayestissue.base.remedies import sentence
from bayestissue.inference.checking.findings import Finding
from bayestissue.inference.execution.kept import some_impacts
from bayestissue.mechanics.elements.element import Element
from bayestissue.model.hierarchy.formulas.group_terms import GroupTerm, grouping_of, labels_of
from bayestissue.model.hierarchy.levels import design_at
from bayestissue.model.hierarchy.recorded import Condition, Recorded
from bayestissue.model.hierarchy.responses import RESPONSES, parameter_of, sd_impact


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
