"""Numbers as straight lines: those of few values are named, and lines that are none are noted."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
import xarray as xr

from bayestissue.base.remedies import codes_in
from bayestissue.inference.checking.findings import warned_codes, warnings
from bayestissue.inference.checking.formula_checks import straight_lines
from bayestissue.inference.results.meanings import few_valued_words
from bayestissue.model.hierarchy.columns import few_valued
from bayestissue.model.hierarchy.design import Design
from designs import design_of, impacts

DRAWS, SD_SUBJECT, SD_IMPACT = 200, 0.2, 0.04


def rows(seed: int) -> pd.DataFrame:
    """Eight people, each at doses 0, 10 and 20, coded so."""
    table = impacts(8)
    dose = np.random.default_rng([seed, 0]).permutation(np.resize([0, 10, 20], len(table)))
    return table.assign(dose=dose)


def drawn(design: Design, ratio: np.ndarray, seed: int) -> xr.Dataset:
    """A posterior of K about truths that dose multiplies by these ratios, as the line's fit would have it.

    What the line lacks is part of its standard deviation between impacts.
    """
    rng, table = np.random.default_rng([seed, 1]), design.recorded.rows
    effect = np.log(ratio)[table["dose"].to_numpy(int) // 10]
    person = SD_SUBJECT * rng.standard_normal(8)[design.subject]
    log_k = 8 + effect + person + SD_IMPACT * rng.standard_normal(len(table))
    bend = effect - np.polyval(np.polyfit(table["dose"], effect, 1), table["dose"])
    sd = float(np.hypot(SD_IMPACT, bend.std()))
    dims, error = ("chain", "draw", "impact"), 0.01 * rng.standard_normal((1, DRAWS, len(table)))
    one = np.ones((1, DRAWS))
    return xr.Dataset(
        {
            "K": (dims, np.exp(log_k + error)),
            "sd_impact_K": (dims[:2], sd * one),
            "sd_subject_K": (dims[:2], SD_SUBJECT * one),
        }
    )


@pytest.mark.parametrize("formula", ["dose + (1|subject)", "log(mass_kg) + age + dose + (1|subject)"])
def test_a_code_that_is_taken_as_a_line_is_noted(formula: str) -> None:
    """K is 1.4 times as large at 10 as at 0 and 20, where the line says 1."""
    design = design_of(formula, rows=rows(1))
    found = straight_lines(design, drawn(design, np.array([1.0, 1.4, 1.0]), 1))
    line = next(line for line in found["lines"] if line["covariate"] == "dose")
    assert line["p"] < 1e-6
    # Off the line by log(1.4) (−1, 2, −1) / 3; 48 impacts a dose tell each to 0.04 / 48^(1/2) and better.
    expected = dict(zip(("0", "10", "20"), np.expm1(np.log(1.4) * np.array([-1, 2, -1]) / 3), strict=True))
    assert line["off_the_line"] == pytest.approx(expected, abs=4 * 0.04 / np.sqrt(48))
    assert "write C(dose) in the formula" in found["words"]
    diagnostics = {"checks": [], "straight_lines": found}
    assert [str(words) for words in warnings(diagnostics)] == [found["words"]]
    assert warned_codes(diagnostics) == ["no-straight-line"]


def test_a_further_parameter_with_a_formula_is_judged_by_its_own_scatter() -> None:
    """Of it sd_log_thickness_m is the scatter, and no error of mass is part of it."""
    design = design_of("dose", rows=rows(7), thickness_m="dose + (1|subject)")
    posterior = drawn(design_of("dose + (1|subject)", rows=rows(7)), np.array([1.0, 1.4, 1.0]), 7)
    alone = posterior.rename(K="thickness_m", sd_impact_K="sd_log_thickness_m")
    alone = alone.rename(sd_subject_K="sd_subject_thickness_m")
    (line,) = straight_lines(design, alone, log_mass_sd=10.0)["lines"]
    same = straight_lines(design_of("dose + (1|subject)", rows=rows(7)), posterior)["lines"][0]
    assert line == same | {"of": "thickness_m"}
    assert line["p"] < 1e-6


@pytest.mark.slow
def test_a_line_that_is_one_is_not_noted() -> None:
    """Of 200 lines none is plainly bent, and p is uniform: the share below a tenth within four errors."""
    p, design = [], design_of("dose + (1|subject)", rows=rows(2))
    for seed in range(200):
        found = straight_lines(design, drawn(design, 1.1 ** np.arange(3), seed))
        p += [line["p"] for line in found["lines"]]
        assert not found["words"]
    assert len(p) == 200
    assert np.mean(np.array(p) < 0.1) == pytest.approx(0.1, abs=4 * np.sqrt(0.09 / 200))


def test_a_bend_that_a_group_may_be_is_not_noted() -> None:
    """Where each dose is a session of its own, what bends may be the session."""
    table = rows(3).assign(session=lambda t: "day " + t["dose"].astype(str))
    design = design_of("dose + (1|subject) + (1|session)", rows=table)
    posterior = drawn(design, np.array([1.0, 1.1, 1.0]), 3)
    posterior["sd_session_K"] = (("chain", "draw"), np.full((1, DRAWS), 0.15))
    assert not straight_lines(design, posterior)["words"]


def test_categories_and_two_values_are_no_lines() -> None:
    table = rows(4).assign(two=lambda t: (t["room"] > 20).astype(int))
    design = design_of("C(dose) + two + side + (1|subject)", rows=table)
    assert straight_lines(design, drawn(design, np.ones(3), 4)) == {"lines": [], "words": ""}


def test_many_values_are_taken_in_classes() -> None:
    design = design_of("room + (1|subject)", rows=rows(5).assign(room=lambda t: np.linspace(0, 30, len(t))))
    posterior = drawn(design, np.ones(3), 5)
    room = design.recorded.rows["room"].to_numpy()
    posterior["K"] = posterior["K"] * np.exp(((room - 15) / 15) ** 2 / 4)
    found = straight_lines(design, posterior)
    assert len(found["lines"][0]["off_the_line"]) == 6
    assert "transform room, or add {room**2}" in found["words"]


def test_few_whole_numbers_are_named_with_how_they_become_categories() -> None:
    table = rows(6).assign(score=lambda t: t["dose"] + 0.5, n=lambda t: t["dose"])
    assert set(few_valued(table)) == {"dose", "session"}
    assert design_of("C(dose) + (1|session)", rows=table).few_valued() == {}
    few = design_of("log(mass_kg) + dose", rows=table).few_valued()
    assert few == {"dose": ["0", "10", "20"]}
    (words,) = few_valued_words(few)
    assert words.startswith("dose has the values 0, 10 and 20 only")
    assert "C(dose) makes it categories" in words
    assert codes_in(words) == ["few-values"]
