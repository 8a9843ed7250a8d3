from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
import statsmodels.formula.api as smf

from bayestissue.dataset.published import read_published
from bayestissue.thesis.causes.design import (
    Design,
    campaign_statistics,
    observed_statistics,
    published_design,
)


@pytest.fixture(scope="module")
def design() -> Design:
    return published_design(read_published())[0]


def test_the_published_exponents_are_those_of_the_nine_averages(design: Design) -> None:
    tables = read_published()
    found = observed_statistics(published_design(tables)[1], design)
    for quantity in ("K", "C"):
        rows = tables.averages[tables.averages["quantity"] == quantity]
        line = np.polyfit(np.log(rows["mass_kg"]), np.log(rows["average"]), 1)
        assert found[f"mass_exponent_{quantity}"] == pytest.approx(line[0], rel=1e-12)


def test_published_scatter_by_hand(design: Design) -> None:
    tables = read_published()
    found = observed_statistics(published_design(tables)[1], design)
    rows = tables.estimates
    ratio = np.log(rows["K"] / rows["mass_kg"])
    assert found["K_over_M_scatter"] == pytest.approx(ratio.std(), rel=1e-12)
    zeta = rows["C"] / (2 * np.sqrt(rows["K"] * rows["mass_kg"]))
    assert found["zeta_median"] == pytest.approx(zeta.median(), rel=1e-12)
    assert found["omega_zeta_correlation"] == pytest.approx(np.corrcoef(ratio, zeta)[0, 1], rel=1e-12)


def test_spreads_are_the_analysis_of_variance(design: Design) -> None:
    random = np.random.default_rng(2)
    people = 0.3 * random.standard_normal(design.subjects)
    log_K = people[design.subject] + 0.1 * random.standard_normal(len(design.mass))
    K = np.exp(log_K)[None]
    found = campaign_statistics(K, np.ones_like(K), design)
    keep = design.in_rows
    frame = pd.DataFrame(
        {"y": log_K[keep], "s": design.subject[keep].astype(str), "t": design.trial[keep].astype(str)}
    )
    fit = smf.ols("y ~ t + s", frame).fit()
    both, trials = fit.ssr, smf.ols("y ~ t", frame).fit().ssr
    rest = both / fit.df_resid
    between = ((trials - both) / (design.subjects - 1) - rest) / 7
    assert found["sd_rest_K"][0] == pytest.approx(np.sqrt(rest), rel=1e-10)
    assert found["sd_subject_K"][0] == pytest.approx(np.sqrt(between), rel=1e-10)


def test_people_who_do_not_differ_have_a_spread_around_zero(design: Design) -> None:
    random = np.random.default_rng(3)
    K = np.exp(0.2 * random.standard_normal((400, len(design.mass))))
    spread = campaign_statistics(K, np.ones_like(K), design)["sd_subject_K"]
    variance = np.sign(spread) * spread**2
    assert abs(variance.mean()) < 4 * variance.std() / np.sqrt(len(variance))


def test_power_laws_come_back(design: Design) -> None:
    K = (20 * design.mass**0.7 * design.velocity**-0.4)[None]
    C = (2 * design.mass**1.3)[None]
    found = campaign_statistics(K, C, design)
    assert found["velocity_exponent_K"][0] == pytest.approx(-0.4, abs=1e-10)
    assert found["mass_exponent_C"][0] == pytest.approx(1.3, abs=1e-10)
    assert found["velocity_exponent_C"][0] == pytest.approx(0, abs=1e-10)


def test_a_curve_of_omega_in_zeta_leaves_no_scatter_and_outliers_do_not_hide_it(design: Design) -> None:
    random = np.random.default_rng(4)
    zeta = random.uniform(0.1, 0.6, len(design.mass))
    omega = 5 * np.exp(0.5 * (zeta - 0.3) ** 2)
    K = (design.mass * omega**2)[None]
    C = 2 * zeta * omega * design.mass
    K[0, np.flatnonzero(design.in_rows)[::12]] *= 1.1
    found = campaign_statistics(K, C[None], design)
    assert found["omega_zeta_residual"][0] < 0.05
    chance = campaign_statistics(K, random.permutation(C)[None], design)
    assert chance["omega_zeta_residual"][0] > 0.3


def test_an_impact_without_estimate_costs_one_impact(design: Design) -> None:
    K = np.exp(0.1 * np.random.default_rng(5).standard_normal((2, len(design.mass))))
    C = np.ones_like(K)
    K[1], K[1, 3] = K[0], np.nan
    found = campaign_statistics(K, C, design)
    assert found["without_estimate"][1] == pytest.approx(1 / len(design.mass))
    assert all(np.isfinite(values).all() for values in found.values())


def test_a_design_with_one_velocity_has_no_exponent_of_it() -> None:
    mass = np.repeat([0.5, 0.8, 1.2, 1.5], 3)
    trial, subject = np.repeat(np.arange(4), 3), np.tile(np.arange(3), 4)
    flat = Design(mass, np.full(12, 1.5), subject, trial, np.ones(12, bool))
    found = campaign_statistics(np.ones((1, 12)) * mass, np.ones((1, 12)), flat)
    assert "velocity_exponent_K" not in found
    assert found["mass_exponent_K"][0] == pytest.approx(1, abs=1e-12)
