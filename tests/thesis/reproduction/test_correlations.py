from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy import stats

from bayestissue.recordings.dataset.published import PublishedTables
from bayestissue.thesis.reproduction.conditions import QUANTITIES, Quantity, conditions, covariate
from bayestissue.thesis.reproduction.relations import (
    correlation_lines,
    correlation_of_averages,
    correlation_of_impacts,
    p_value,
)

NAMES = ("Mass", "Mass Seq", "Velocity * Mass", "Energy* Mass *Velocity", "Energy", "Velocity Seq")


@pytest.mark.parametrize("quantity", QUANTITIES)
@pytest.mark.parametrize("seed", range(5))
def test_lost_impacts_do_not_matter_to_a_correlation(
    print_tables: Callable[[int], Any], quantity: Quantity, seed: int
) -> None:
    printed = print_tables(seed)
    table = conditions(printed.tables, quantity)
    for name in NAMES:
        # the oracle sees all 90 impacts, unrounded
        r = np.corrcoef(covariate(name, printed.impacts), printed.impacts[quantity])[0, 1]
        found = correlation_of_impacts(name, table)
        assert found.value is not None
        assert abs(found.value - r) <= found.rounding
        assert found.rounding < 1e-3


@pytest.mark.parametrize("quantity", QUANTITIES)
def test_with_no_row_lost_it_is_the_correlation_of_the_rows(
    published: PublishedTables, quantity: Quantity
) -> None:
    table = conditions(published, quantity).query("from_rows")
    rows = published.estimates
    for name in NAMES:
        r = np.corrcoef(covariate(name, rows), rows[quantity])[0, 1]
        assert correlation_of_impacts(name, table).value == pytest.approx(r, abs=1e-13)


@pytest.mark.parametrize("quantity", QUANTITIES)
@pytest.mark.parametrize("seed", range(5))
def test_correlations_of_averages(print_tables: Callable[[int], Any], quantity: Quantity, seed: int) -> None:
    printed = print_tables(seed)
    truth = printed.impacts.groupby("trial")[["energy_J", "velocity_m_s", "mass_kg", quantity]].mean()
    for name in NAMES:
        r = np.corrcoef(covariate(name, truth), truth[quantity])[0, 1]
        found = correlation_of_averages(name, conditions(printed.tables, quantity))
        assert found.value is not None
        assert abs(found.value - r) <= found.rounding


@pytest.mark.parametrize("seed", range(4))
def test_p_values_are_those_of_pearsons_test(seed: int) -> None:
    x, y = np.random.default_rng(seed).normal(size=(2, 25))
    expected = stats.pearsonr(x, y + seed * x)
    # scipy goes through the beta distribution: the two differ by rounding only
    assert p_value(expected.statistic, 25) == pytest.approx(expected.pvalue, rel=1e-9)
    assert p_value(-expected.statistic, 25) == p_value(expected.statistic, 25)


def test_p_values_at_the_ends() -> None:
    assert p_value(0.0, 90) == 1.0
    assert p_value(1.0, 90) == 0.0


def test_hand_figures(published: PublishedTables) -> None:
    lines = {(line.table, line.quantity): line for line in correlation_lines(published)}
    mass = lines["5.12", "correlation of K with Mass, all impacts"]
    assert (mass.published, mass.agrees) == ("0.997", True)
    lost = lines["5.13", "correlation of C with Mass, all impacts"]
    assert (lost.published, lost.agrees) == ("0.787", True)
    filled = lines["5.13", "correlation of C with Energy, all impacts"]
    assert (filled.published, filled.agrees, filled.reproduced[:5]) == ("", None, "0.567")
    cut = lines["5.15", "correlation of C with Mass, averages"]
    assert (cut.agrees, cut.note) == (False, "cut off after the last printed digit instead of rounded")


def test_every_correlation_agrees_or_was_cut_off(published: PublishedTables) -> None:
    compared = [line for line in correlation_lines(published) if line.agrees is not None]
    assert len(compared) == 41
    assert all(line.agrees or line.note.startswith("cut off") for line in compared)


def test_a_p_value_is_checked_against_its_printed_correlation(published: PublishedTables) -> None:
    notes = {line.quantity: line.note for line in correlation_lines(published) if line.table == "5.12"}
    # two-sided t of 88 degrees: r = 0.010 and 0.011 give 0.925 and 0.918
    assert "not 0.912" in notes["p-value of K with Muscle Thickness, all impacts"]
    assert "not" not in notes["p-value of K with Skin Fold, all impacts"].partition(";")[2]
