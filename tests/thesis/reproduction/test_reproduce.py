"""Numbers recomputed from the printed tables: against simulated impacts, by hand, and as they are kept."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from bayestissue.base.results.tables import write_table
from bayestissue.recordings.dataset.published import PublishedTables
from bayestissue.thesis.audit import audit_published
from bayestissue.thesis.reproduction import reproduce_published
from bayestissue.thesis.reproduction.claims import Evidence
from bayestissue.thesis.reproduction.conditions import (
    QUANTITIES,
    Quantity,
    conditions,
    covariate,
    grand_mean,
    rounding_norm,
    sum_of_squares,
)
from bayestissue.thesis.reproduction.relations import (
    correlation_figure,
    correlation_of_averages,
    correlation_of_impacts,
    p_value,
    printed_line,
    select_forward,
)

KEPT = Path(__file__).parents[3] / "docs" / "reports" / "published"
NAMES = ("Mass", "Mass Seq", "Velocity * Mass", "Energy* Mass *Velocity", "Energy", "Velocity Seq")


@pytest.mark.parametrize(
    ("name", "make"),
    [
        ("reproduction", reproduce_published),
        ("audit", lambda published: audit_published(published, reproduce_published(published))),
    ],
)
def test_every_printed_number_is_judged_as_it_was(
    published: PublishedTables, tmp_path: Path, name: str, make: Callable[[PublishedTables], pd.DataFrame]
) -> None:
    """As in the report that is kept, to the letter but in another case: nothing of it is drawn."""
    write_table(make(published), tmp_path / "made.csv")
    kept = (KEPT / f"{name}.csv").read_text(encoding="utf-8")
    assert (tmp_path / "made.csv").read_text(encoding="utf-8").lower() == kept.lower()


@pytest.mark.parametrize("quantity", QUANTITIES)
@pytest.mark.parametrize("seed", range(2))
def test_rounding_and_lost_impacts_move_a_number_no_further_than_its_bound(
    print_tables: Callable[[int], Any], quantity: Quantity, seed: int
) -> None:
    """The oracle sees all 90 impacts, unrounded."""
    printed = print_tables(seed)
    table, evidence = conditions(printed.tables, quantity), Evidence(printed.tables, quantity)
    groups, y = printed.impacts.groupby("trial")[quantity], printed.impacts[quantity].to_numpy()
    averages, of_trials = groups.mean(), printed.impacts.groupby("trial").mean(numeric_only=True)
    of_condition = {"average": averages, "sd": groups.std(), "range": groups.max() - groups.min()}
    for name, value in of_condition.items():
        off = (table[name] - value.reindex(table.index)).abs()
        assert (off <= table[f"{name}_rounding"] + 1e-12).all()
    of_all = {
        "mean": np.mean(y),
        "variance": np.var(y, ddof=1),
        "minimum of trial averages": averages.min(),
        "maximum of trial averages": averages.max(),
        "range of trial averages": averages.max() - averages.min(),
    }
    pairs = [(evidence.statistic(name), truth) for name, truth in of_all.items()]
    for name in NAMES:
        r = np.corrcoef(covariate(name, printed.impacts), y)[0, 1]
        pairs.append((correlation_of_impacts(name, table), r))
        assert pairs[-1][0].rounding < 1e-3
        r = np.corrcoef(covariate(name, of_trials), of_trials[quantity])[0, 1]
        pairs.append((correlation_of_averages(name, table), r))
    for found, truth in pairs:
        assert found.value is not None
        assert abs(found.value - truth) <= found.rounding + 1e-12
    total = sum_of_squares(table)
    # the triangle inequality bounds the norm of the centred impacts
    assert abs(np.sqrt(total) - np.linalg.norm(y - y.mean())) <= rounding_norm(table)
    assert abs(grand_mean(table) - y.mean()) <= table["average_rounding"].max()


HAND = {
    ("5.10", "standard deviation of K, trial 17"): (False, "repeats the range"),
    ("5.11", "range of C, trial 16"): (False, "differs by +0.983"),
    ("5.12", "correlation of K with Mass, all impacts"): (True, ""),
    # two-sided t of 88 degrees: r = 0.010 and 0.011 give 0.925 and 0.918
    ("5.12", "p-value of K with Muscle Thickness, all impacts"): (None, "not 0.912"),
    ("5.15", "correlation of C with Mass, averages"): (False, "cut off after the last printed digit"),
    ("equation of K", "coefficient of constant"): (False, "0.69524 with masses not cut to three decimals"),
    ("equation of C", "R²"): (True, ""),
    ("section 5.1", "K: maximum"): (None, "between 31.711 and 32.225"),
    ("section 5.2", "C: range"): (False, "repeats the maximum"),
    ("section 6.2", "K: correlation with Mass"): (False, "section 5.3 prints 0.997, which agrees"),
    ("section 6.4.3", "skin thickness: minimum (mm)"): (None, "never tabulated"),
}


def test_hand_figures(published: PublishedTables) -> None:
    found = reproduce_published(published).set_index(["table", "quantity"])[["agrees", "note"]]
    for line, (agrees, note) in HAND.items():
        told = found.loc[[line]].iloc[0]
        assert (None if pd.isna(told["agrees"]) else told["agrees"]) == agrees, line
        assert note in told["note"], line


def test_p_values_are_those_of_pearsons_test() -> None:
    x, y = np.random.default_rng(1).normal(size=(2, 25))
    expected = stats.pearsonr(x, y)
    # scipy goes through the beta distribution: the two differ by rounding only
    assert p_value(expected.statistic, 25) == pytest.approx(expected.pvalue, rel=1e-9)
    assert p_value(-expected.statistic, 25) == p_value(expected.statistic, 25)
    assert (p_value(0.0, 90), p_value(1.0, 90)) == (1.0, 0.0)


def test_forward_selection_finds_what_made_the_response_and_nothing_in_noise() -> None:
    generator = np.random.default_rng(3)
    x = {(name,): generator.normal(size=40) for name in "abcd"}
    response = pd.Series(3 * x["b",] + x["d",] + 0.1 * generator.normal(size=40))
    assert select_forward(response, x)[:2] == [("b",), ("d",)]
    # a response orthogonal to the constant and to the candidate: t is exactly 0
    response = pd.Series([1.0, -1.0, -1.0, 1.0, 1.0, -1.0, -1.0, 1.0])
    assert select_forward(response, {("x",): np.array([1.0, 1.0, -1.0, -1.0, 1.0, 1.0, -1.0, -1.0])}) == []


@pytest.mark.parametrize(("quantity", "averages", "count"), [("K", False, 13), ("C", True, 12)])
def test_bars_fall(published: PublishedTables, quantity: Quantity, averages: bool, count: int) -> None:
    figure = correlation_figure(published, quantity, averages=averages)
    assert len(figure) == count
    assert figure["absolute"].is_monotonic_decreasing
    assert figure["variable"].iloc[0] == "Mass"
    both = figure.dropna(subset=["correlation", "published"])
    # printed correlations are cut to three decimals
    assert ((both["correlation"] - both["published"]).abs() < 1e-3).all()
    assert printed_line(published, "C") == (-0.444, 2.962)
