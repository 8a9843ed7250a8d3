"""Published measurements are whole, and are offered where they compare."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest

from bayestissue.base.literature import FACTOR, MEASURED, SITES, Range, comparable, measurements
from bayestissue.recordings.dataset.dataset_file import STANDARD_GRAVITY


def named(short: str) -> list:
    return [row for row in measurements() if row.source.short == short]


def test_every_row_says_what_was_hit_by_what_how_where_it_stands_and_on_what_terms() -> None:
    for row in measurements():
        assert row.site in SITES
        assert row.published
        assert set(row.published) <= set(MEASURED)
        for text in (row.hit, row.by, row.method, row.where, row.source.title, row.source.licence):
            assert text.strip()
        assert row.source.address.startswith("https://")
        for values in (*row.published.values(), *filter(None, (row.mass, row.velocity))):
            assert 0 < values.low <= values.high
    assert {row.site for row in measurements()} == set(SITES)


def test_what_was_derived_follows_from_what_was_published() -> None:
    for row in named("Descente Sports Science 12"):
        height = float(re.search(r"from (\d+) mm", row.by)[1]) / 1e3
        assert row.velocity.low == pytest.approx(math.sqrt(2 * STANDARD_GRAVITY * height), abs=5e-4)
    (cadavers,) = named("Robinovitch et al. 1995")
    taken_up = [float(found) for found in re.search(r"([\d.]+) to ([\d.]+) J", cadavers.method).groups()]
    given = float(re.search(r"(\d+) J", cadavers.by)[1])
    np.testing.assert_allclose(cadavers.published["energy_share"], np.array(taken_up) / given, atol=5e-4)


def test_rows_within_a_factor_of_two_compare_and_no_others() -> None:
    (row,) = named("Kinoshita et al. 1993")
    mass = 5 * np.array([1.0, FACTOR, 1 / FACTOR, 1.01 * FACTOR, 1.0, 1.0, 1.0])
    velocity = 0.93 * np.array([1.0, 1 / FACTOR, FACTOR, 1.0, 0.99 / FACTOR, 1.0, np.nan])
    (found,) = (one.impacts for one in comparable(mass, velocity, "heel") if one.measurement is row)
    np.testing.assert_array_equal(found, [True, True, True, False, False, True, False])
    # Both must be like it in one and the same impact.
    assert comparable(np.array([5.0, 500.0]), np.array([93.0, 0.93]), "heel") == []


def test_a_range_compares_from_half_its_least_to_twice_its_greatest() -> None:
    (row,) = named("Robinovitch et al. 2009")
    mass = np.array([10.9, 11.0, 66.0, 66.1])
    (found,) = comparable(mass, np.full(4, 3.4), "hip")
    assert found.measurement is row
    np.testing.assert_array_equal(found.impacts, [False, True, True, False])


def test_another_site_compares_only_where_none_is_stated() -> None:
    mass, velocity = np.array([5.0]), np.array([0.93])
    assert comparable(mass, velocity, "hip") == []
    assert {one.measurement.site for one in comparable(mass, velocity)} == {"heel"}


def test_without_mass_and_velocity_a_row_compares_with_nothing() -> None:
    every = comparable(np.geomspace(1e-3, 1e3, 200).repeat(50), np.tile(np.geomspace(0.05, 50, 50), 200))
    assert all(one.measurement.mass and one.measurement.velocity for one in every)
    assert len(every) == sum(bool(row.mass and row.velocity) for row in measurements())


@pytest.mark.parametrize(("value", "ratio"), [(20, 0.5), (40, 1), (50, 1), (80, 1), (160, 2)])
def test_a_value_is_held_against_the_nearest_published_one(value: float, ratio: float) -> None:
    assert Range(40, 80).ratio(value) == ratio
