"""Reliability against the analysis of variance, on balanced levels that are known without error."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from numpy.testing import assert_allclose
from statsmodels.formula.api import ols
from statsmodels.stats.anova import anova_lm

from bayestissue.inference.answers.reliability import (
    ICC,
    MDC,
    REPEATS,
    SEM,
    Variances,
    as_variables,
    coefficients,
    reliability,
    variances,
)
from bayestissue.model.hierarchy.recorded import Recorded

# Six targets rated by four judges: Shrout and Fleiss (1979, doi:10.1037/0033-2909.86.2.420), table 2, whose
# coefficients are ICC(3,1), ICC(2,1), ICC(3,k), ICC(2,k) in their words.
RATINGS = [[9, 2, 5, 8], [6, 1, 3, 2], [8, 4, 6, 8], [7, 1, 2, 6], [10, 5, 6, 9], [6, 2, 4, 7]]
PUBLISHED = {"ICC(C,1)": 0.71, "ICC(A,1)": 0.29, "ICC(C,k)": 0.91, "ICC(A,k)": 0.62}


def mean_squares(levels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of rows, columns and error, and their degrees of freedom, by statsmodels."""
    person, condition = np.indices(levels.shape)
    table = pd.DataFrame({"y": levels.ravel(), "person": person.ravel(), "condition": condition.ravel()})
    found = anova_lm(ols("y ~ C(person) + C(condition)", table).fit())
    return found["mean_sq"].to_numpy(), found["df"].to_numpy()


def components(squares: np.ndarray, shape: tuple[int, int]) -> tuple[np.ndarray, ...]:
    """Variances of rows, columns and error of these mean squares, [...]."""
    rows, columns, error = squares
    return (rows - error) / shape[1], (columns - error) / shape[0], error


def of(people, conditions, error, *, k: float, measurement: float = 0.0, shared: float = 0.0) -> Variances:
    return Variances(people, shared, {"trial": (conditions, k)}, {}, error, measurement, k)


def classical(each: Variances) -> dict[str, np.ndarray]:
    return {
        f"ICC({letter},{number})": each.icc(letter, averaged=number == "k")
        for letter in "CA"
        for number in "1k"
    }


def test_the_classical_estimates_are_those_of_the_mean_squares() -> None:
    levels = np.array(RATINGS, float)
    squares, _ = mean_squares(levels)
    found = classical(of(*components(squares, levels.shape), k=4))
    assert {name: round(float(value), 2) for name, value in found.items()} == PUBLISHED
    # McGraw and Wong's table 4, in mean squares.
    (rows, columns, error), n, k = squares, *levels.shape
    assert found["ICC(C,1)"] == pytest.approx((rows - error) / (rows + (k - 1) * error))
    assert found["ICC(A,k)"] == pytest.approx((rows - error) / (rows + (columns - error) / n))
    single = (rows - error) / (rows + (k - 1) * error + k / n * (columns - error))
    assert found["ICC(A,1)"] == pytest.approx(single)


def test_what_the_chain_makes_counts_and_a_shared_error_stays() -> None:
    clear = of(0.04, 0.01, 0.02, k=4)
    assert clear.icc("C") == pytest.approx(0.04 / 0.06)
    blurred = clear._replace(measurement=0.02)
    assert blurred.icc("C") == pytest.approx(0.04 / 0.08)
    assert blurred.icc("A", averaged=True) == pytest.approx(0.04 / (0.04 + (0.01 + 0.04) / 4))
    shared = blurred._replace(shared=0.02)
    assert shared.icc("C", averaged=True) == pytest.approx(0.04 / (0.06 + 0.04 / 4))
    # Spearman and Brown: a mean of so many has the ICC asked for.
    for each in (clear, blurred, shared._replace(shared=0.001)):
        for form in ("C", "A"):
            k = each.repeats(0.9, form)
            error = each.error(form) / k
            assert each.people / (each.people + each.shared + error) == pytest.approx(0.9)
    assert shared.repeats(0.75, "C") == np.inf


def posterior() -> tuple[xr.Dataset, Recorded]:
    rng, shape = np.random.default_rng(2), (4, 1000)
    sds = {"subject": 0.3, "trial": 0.1, "subject_side": 0.05, "session": 0.02, "team": 0.2, "impact": 0.04}
    found = {f"sd_{name}_K": sd * np.exp(0.1 * rng.standard_normal(shape)) for name, sd in sds.items()}
    found["intercept_K"] = np.log(2000) + 0.01 * rng.standard_normal(shape)
    found["K_typical_person"] = np.exp(found["intercept_K"])
    rows = pd.DataFrame(
        [
            (f"p{person}", f"t{trial}", side, f"p{person}-{trial % 2}", f"team{person % 2}", 1.0)
            for person in range(4)
            for trial in range(3)
            for side in ("left", "right")
        ],
        columns=["subject", "trial", "side", "session", "team", "mass_kg"],
    )
    formula = "(1|subject) + (1|trial) + (1|subject:side) + (1|session) + (1|team)"
    draws = xr.Dataset({name: (("chain", "draw"), values) for name, values in found.items()})
    return draws, Recorded(rows, {"K": formula}, 1.0)


def test_each_group_is_part_of_the_variance_that_its_levels_say() -> None:
    draws, recorded = posterior()
    found = variances(draws, recorded, "K", measurement_sd=0.03, shared_sd=0.01)
    square = {str(name): array.to_numpy() ** 2 for name, array in draws.items()}
    # People belong to teams; sides and these sessions are one person's; conditions are everybody's.
    assert_allclose(found.people, square["sd_subject_K"] + square["sd_team_K"])
    assert [levels for _, levels in found.agreement.values()] == [3]
    assert [levels for _, levels in found.within.values()] == [2, 2]
    assert found.k == 6
    error = square["sd_impact_K"] + square["sd_subject_side_K"] + square["sd_session_K"] + 0.03**2
    assert_allclose(found.error("C"), error)
    averaged = (square["sd_impact_K"] + 0.03**2) / 6 + square["sd_trial_K"] / 3
    averaged = averaged + (square["sd_subject_side_K"] + square["sd_session_K"]) / 2
    assert_allclose(found.error("A", averaged=True), averaged)


def test_the_table_and_the_variables_are_in_percent_and_in_units() -> None:
    draws, recorded = posterior()
    each = variances(draws, recorded, "K", measurement_sd=0.03)
    found = coefficients(draws, recorded, {"K": 0.03})
    table, further = reliability(found), as_variables(found)
    row = table.set_index(["measure", "form", "unit"])["median"]
    s = np.sqrt(each.error("A"))
    assert row[SEM, "agreement", "%"] == pytest.approx(100 * np.median(np.expm1(s)), rel=1e-3)
    change = np.expm1(1.96 * np.sqrt(2) * s)
    assert row[MDC, "agreement", "%"] == pytest.approx(100 * np.median(change), rel=1e-3)
    in_units = np.median(change * np.exp(draws["intercept_K"]))
    assert row[MDC, "agreement", "N/m"] == pytest.approx(in_units, rel=1e-3)
    assert row[SEM, "measuring chain", "%"] == pytest.approx(100 * np.expm1(0.03))
    assert row[REPEATS, "ICC(A,k) of 0.9", "1"] == np.ceil(np.median(further["repeats_A90_K"]))
    assert row[ICC, "ICC(C,k), k = 6", "1"] == pytest.approx(float(further["ICC_Ck_K"].median()), rel=1e-3)
    ends = table.set_index(["measure", "form"]).loc[(ICC, "ICC(A,1)"), ["low", "high"]]
    assert_allclose(ends.astype(float), further["ICC_A1_K"].quantile([0.05, 0.95]), rtol=1e-2)
    assert further["SEM_C_K"].attrs["unit"] == "N/m"


def test_of_one_person_only_the_errors_are_told() -> None:
    draws, recorded = posterior()
    alone = Recorded(recorded.rows.assign(subject="p0"), {"K": "(1|trial)"}, 1.0)
    found = coefficients(draws, alone, {"K": 0.03})
    table, further = reliability(found), as_variables(found)
    assert set(table["measure"]) == {SEM, MDC}
    assert "ICC_C1_K" not in further
    assert reliability(coefficients(draws, alone, {})).empty


def test_how_much_is_prior_stands_beside_each_coefficient() -> None:
    draws, recorded = posterior()
    both = [
        coefficients(of, recorded, {"K": 0.03})
        for of in (draws, draws.assign(sd_trial_K=2 * draws["sd_trial_K"]))
    ]
    row = reliability(*both).set_index(["measure", "form", "unit"])["prior_overlap"]
    # The data told nothing but of conditions, which are in agreement alone.
    assert row[ICC, "ICC(C,1)", "1"] == pytest.approx(1)
    assert row[ICC, "ICC(A,1)", "1"] < 0.9
    assert np.isnan(row[SEM, "measuring chain", "%"])
    assert reliability(both[0])["prior_overlap"].isna().all()
