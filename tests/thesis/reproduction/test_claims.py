from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from bayestissue.recordings.dataset.published import PublishedTables
from bayestissue.thesis.reproduction.agreement import PublishedNumber
from bayestissue.thesis.reproduction.claims import Evidence, claim_lines
from bayestissue.thesis.reproduction.conditions import QUANTITIES, Quantity


@pytest.fixture(scope="module")
def lines(published: PublishedTables) -> dict[int, PublishedNumber]:
    return {line.row: line for line in claim_lines(published)}


@pytest.mark.parametrize("quantity", QUANTITIES)
@pytest.mark.parametrize("seed", range(5))
def test_mean_and_variance_of_all_impacts(
    print_tables: Callable[[int], Any], quantity: Quantity, seed: int
) -> None:
    printed = print_tables(seed)
    evidence = Evidence(printed.tables, quantity)
    y = printed.impacts[quantity].to_numpy()
    for name, truth in (("mean", np.mean(y)), ("variance", np.var(y, ddof=1))):
        found = evidence.statistic(name)
        assert found.value is not None
        assert abs(found.value - truth) <= found.rounding


@pytest.mark.parametrize("quantity", QUANTITIES)
@pytest.mark.parametrize("seed", range(5))
def test_statistics_of_the_averages(
    print_tables: Callable[[int], Any], quantity: Quantity, seed: int
) -> None:
    printed = print_tables(seed)
    averages = printed.impacts.groupby("trial")[quantity].mean()
    evidence = Evidence(printed.tables, quantity)
    for name, truth in (
        ("minimum of trial averages", averages.min()),
        ("maximum of trial averages", averages.max()),
        ("range of trial averages", averages.max() - averages.min()),
    ):
        found = evidence.statistic(name)
        assert found.value is not None
        assert abs(found.value - truth) <= found.rounding + 1e-12


def test_every_claim_is_answered(published: PublishedTables, lines: dict[int, PublishedNumber]) -> None:
    assert sorted(lines) == list(published.claims["claim"])
    assert all(line.reproduced or line.note for line in lines.values())
    assert all(line.agrees or line.note for line in lines.values())
    assert not any("no rule" in line.note for line in lines.values())


@pytest.mark.parametrize(
    ("claim", "reproduced", "agreed", "note"),
    [
        (3, "90", True, "70 of them remain"),
        (9, "4.505", False, "4.626 of the text"),
        (17, "4.505", False, "repeats the maximum"),
        (21, "10", False, "differs by -9"),
        (22, "12", True, "13 names"),
        (23, "18.469622", True, ""),
        (24, "42.87196", True, ""),
        (28, "", None, "between 31.711 and 32.225"),
        (35, "5", True, ""),
        (36, "1", True, "Table 5.17 enters 2"),
        (38, "1.1208896", False, "cut off"),
        (41, "0.121", False, "decimal point"),
        (52, "0.99701086", False, "section 5.3 prints 0.997, which agrees"),
        (56, "", None, "never tabulated"),
    ],
)
def test_claims(
    lines: dict[int, PublishedNumber], claim: int, reproduced: str, agreed: bool | None, note: str
) -> None:
    assert (lines[claim].reproduced, lines[claim].agrees) == (reproduced, agreed)
    assert note in lines[claim].note


def test_an_impossible_maximum_is_not_used(published: PublishedTables) -> None:
    claims = published.claims.copy()
    claims.loc[claims["statistic"] == "maximum", "value"] = 99.0
    found = Evidence(replace(published, claims=claims), "K").statistic("range")
    assert found.value is None
    assert "none that is possible" in found.note


def test_an_unknown_statistic_is_left_open(published: PublishedTables) -> None:
    claims = published.claims.assign(statistic="kurtosis")
    found = claim_lines(replace(published, claims=claims))
    assert {line.reproduced for line in found} == {""}
    assert all(line.note for line in found)
