from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from bayestissue.recordings.dataset.published import PublishedTables
from bayestissue.thesis.reproduction.conditions import QUANTITIES, Quantity, conditions
from bayestissue.thesis.reproduction.relations import (
    regression_lines,
    select_forward,
    stepwise_lines,
    straight_line,
)


@pytest.mark.parametrize("quantity", QUANTITIES)
def test_the_line_is_that_of_least_squares(published: PublishedTables, quantity: Quantity) -> None:
    table = conditions(published, quantity)
    slope, constant = np.polyfit(table["mass_kg"], table["average"], 1)
    fit = straight_line(table)
    # two stable solvers of a 9 x 2 problem with condition number below 10
    assert fit.params["Mass"] == pytest.approx(slope, rel=1e-12)
    assert fit.params["const"] == pytest.approx(constant, rel=1e-11)
    r = np.corrcoef(table["mass_kg"], table["average"])[0, 1]
    assert fit.rsquared == pytest.approx(r * r, rel=1e-12)


def test_forward_selection_finds_what_made_the_response() -> None:
    generator = np.random.default_rng(3)
    x = {(name,): generator.normal(size=40) for name in "abcd"}
    response = pd.Series(3 * x["b",] + x["d",] + 0.1 * generator.normal(size=40))
    assert select_forward(response, x)[:2] == [("b",), ("d",)]


def test_forward_selection_enters_nothing_into_noise() -> None:
    # a response orthogonal to the constant and to the candidate: t is exactly 0
    response = pd.Series([1.0, -1.0, -1.0, 1.0, 1.0, -1.0, -1.0, 1.0])
    assert select_forward(response, {("x",): np.array([1.0, 1.0, -1.0, -1.0, 1.0, 1.0, -1.0, -1.0])}) == []


def test_forward_selection_stops_before_degrees_run_out() -> None:
    generator = np.random.default_rng(0)
    x = {(str(i),): generator.normal(size=5) for i in range(6)}
    assert len(select_forward(pd.Series(sum(x.values())), x)) <= 2


def test_equations(published: PublishedTables) -> None:
    lines = {(line.table, line.quantity): line for line in regression_lines(published)}
    assert lines["equation of K", "coefficient of Mass"].agrees
    constant = lines["equation of K", "coefficient of constant"]
    assert (constant.published, constant.agrees) == ("+0.695", False)
    assert constant.note.startswith("0.69524 with masses not cut to three decimals")
    assert lines["equation of K", "coefficient of SFT"].reproduced == ""
    assert lines["equation of C", "R²"].agrees
    assert lines["equation of C", "coefficient of constant"].agrees
    assert "rounding" in lines["equation of C", "coefficient of Mass"].note


def test_only_mass_enters(published: PublishedTables) -> None:
    lines = stepwise_lines(published)
    entered = [line.quantity for line in lines if line.reproduced == "entered"]
    assert entered == [f"Mass in the stepwise regression of {quantity}" for quantity in QUANTITIES]
    assert all(line.agrees for line in lines if line.reproduced)
    assert sum(not line.reproduced for line in lines) == 5
