from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from bayestissue.recordings.dataset.published import PublishedTables
from bayestissue.thesis.reproduction.conditions import (
    QUANTITIES,
    Quantity,
    between_sum_of_squares,
    conditions,
    grand_mean,
    rounding_norm,
    unrounded_mass,
    within_sum_of_squares,
)


@pytest.mark.parametrize("quantity", QUANTITIES)
def test_rows_that_remain_are_summarised(published: PublishedTables, quantity: Quantity) -> None:
    table = conditions(published, quantity)
    for trial in (8, 9, 16, 17, 18, 26, 27):
        values = published.estimates.query("trial == @trial")[quantity].to_numpy()
        found = table.loc[trial]
        # float64 sums of ten numbers below 100: errors below 1e-13
        assert found["average"] == pytest.approx(np.mean(values), abs=1e-13)
        assert found["sd"] == pytest.approx(np.std(values, ddof=1), abs=1e-13)
        assert found["range"] == pytest.approx(np.ptp(values), abs=1e-13)
        assert found["from_rows"]


def test_lost_rows_leave_what_was_printed(published: PublishedTables) -> None:
    table = conditions(published, "K")
    assert list(table.index[~table["from_rows"]]) == [7, 25]
    assert list(table.loc[25, ["average", "sd", "range", "impacts"]]) == [31.631, 0.208, 0.673, 10]
    assert np.isnan(table.loc[7, "minimum"])


@pytest.mark.parametrize("quantity", QUANTITIES)
@pytest.mark.parametrize("seed", range(5))
def test_rounding_moves_a_summary_no_further_than_its_bound(
    print_tables: Callable[[int], Any], quantity: Quantity, seed: int
) -> None:
    printed = print_tables(seed)
    table = conditions(printed.tables, quantity)
    groups = printed.impacts.groupby("trial")[quantity]
    truth = {"average": groups.mean(), "sd": groups.std(), "range": groups.max() - groups.min()}
    for name, value in truth.items():
        off = (table[name] - value.reindex(table.index)).abs()
        assert (off <= table[f"{name}_rounding"] + 1e-12).all()


@pytest.mark.parametrize("quantity", QUANTITIES)
def test_sums_of_squares_add_up_to_those_of_all_impacts(
    print_tables: Callable[[int], Any], quantity: Quantity
) -> None:
    printed = print_tables(11)
    table = conditions(printed.tables, quantity)
    y = printed.impacts[quantity].to_numpy()
    total = within_sum_of_squares(table) + between_sum_of_squares(table)
    norm, error = np.linalg.norm(y - y.mean()), rounding_norm(table)
    # the triangle inequality bounds the norm of the centred impacts
    assert abs(np.sqrt(total) - norm) <= error
    assert abs(grand_mean(table) - y.mean()) <= table["average_rounding"].max()


def test_the_printed_masses_come_from_velocities_a_quarter_higher(published: PublishedTables) -> None:
    table = conditions(published, "K")
    mass = unrounded_mass(table)
    assert (np.trunc(1000 * mass) / 1000 == table["mass_kg"]).all()
    assert mass[7] == pytest.approx(2 / 3, rel=1e-15)
    assert mass[26] == pytest.approx(3 / 1.75**2, rel=1e-15)
