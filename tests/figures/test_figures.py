"""Specifications of figures: what Vega-Lite makes of them, and what they show."""

from __future__ import annotations

import json
import re

import numpy as np
import pandas as pd
import pytest

from bayestissue import read_run
from bayestissue.inference.answers.reliability import agreement as agreement_table
from bayestissue.inference.answers.reliability import limits_of_agreement
from bayestissue.reports.figures.browser import figure_json
from bayestissue.reports.figures.intervals import MOST_LEVELS, with_ranks
from bayestissue.reports.figures.study_comparisons import agreement
from bayestissue.reports.figures.theme import scale_over
from bayestissue.reports.figures.traces import thinned
from bayestissue.reports.pages.fit import figures
from make_fit_run import fit_run, make_fit_run

pytestmark = pytest.mark.slow


def words_in(drawn: str) -> list[str]:
    return re.findall(r"<text[^>]*>([^<]*)</text>", drawn)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return make_fit_run(tmp_path_factory.mktemp("figures") / "run", two_sides=True)


@pytest.fixture(scope="module")
def run():
    return fit_run(two_sides=True)


def test_every_figure_of_a_paper_is_drawn_with_names_and_units(run) -> None:
    made = {name: make() for name, make in figures.published(run)}
    for name in ("K-by-subject", "K-paired-by-side", "C-over-mass", "K-repeatability", "recording"):
        assert name in made
    for name, figure in made.items():
        drawn = figure.svg()
        units = {"recording": "m/s²", "f": "N", "p": "N", "K": "N/m", "C": "N s/m"}
        unit = units.get(name) or units[name[0]]
        assert any(unit in words for words in words_in(drawn)), name
        assert "NaN" not in drawn, name
        assert len(figure.data), name


def test_a_persons_line_goes_from_side_to_side(run) -> None:
    figure = figures.paired(run, "K", "side")
    table = run.impacts_table
    person = table[table["person"] == "s1"]
    expected = np.exp(np.log(person["K_N_per_m"]).groupby(person["side"]).mean())
    rows = figure.data[figure.data["person"] == "s1"].set_index("level")["median"]
    pd.testing.assert_series_equal(rows, expected, check_names=False)
    assert {"left", "right"} <= set(words_in(figure.svg()))


def test_repeats_are_pairs_of_one_person(run) -> None:
    pairs = figures.repeats(run, "K")
    values = run.impacts_table.set_index("impact")["K_N_per_m"]
    # Three impacts of four people, none of them in one condition twice.
    assert len(pairs) == 4 * 2
    for row in pairs.itertuples():
        first, second = (values[name] for name in row.pair.split(", "))
        assert row.ratio == pytest.approx(second / first)
        assert row.mean == pytest.approx(np.sqrt(first * second))


def test_limits_of_agreement_are_those_of_logs() -> None:
    ratio = pd.Series([0.9, 1.0, 1.2, -1.0])
    logs = np.log(ratio[:3])
    expected = np.exp([logs.mean(), logs.mean() - 1.96 * logs.std(), logs.mean() + 1.96 * logs.std()])
    np.testing.assert_allclose(limits_of_agreement(ratio), expected)
    assert np.isnan(limits_of_agreement(ratio[:1])[1])
    rows = pd.DataFrame({"mean": [1.0, 2.0, 3.0], "ratio": ratio[:3]})
    drawn = agreement(rows, expected, "K (N/m)", "a over b", "w").svg()
    assert f"{expected[0]:.3g}" in words_in(drawn)


def test_limits_of_agreement_are_those_of_all_impacts_where_some_are_drawn(monkeypatch) -> None:
    values = pd.DataFrame({"dds": np.exp(np.random.default_rng(1).normal(size=3000)), "posterior": 1.0})
    monkeypatch.setattr(figures, "method_values", lambda *_: values)
    ends = agreement_table({"K": values}).loc[0, ["ratio", "low", "high"]]
    drawn = words_in(figures.methods(None, "K").svg())  # type: ignore[arg-type]
    assert {f"{end:.3g}" for end in ends} <= set(drawn)


def test_ranks_are_those_of_the_draws_and_the_middle_of_very_many_is_left_out() -> None:
    draws = np.array([[1.0, 3.0, 2.0], [1.0, 2.0, 3.0]])
    rows = with_ranks(draws, ["a", "b", "c"])
    assert rows.set_index("label")["rank"].to_dict() == {"b": "1 to 2", "c": "1 to 2", "a": "3"}
    many = with_ranks(np.arange(1.0, 101.0) + np.zeros((3, 1)), [f"{k}" for k in range(100)])
    assert len(many) == MOST_LEVELS
    assert (many["label"].iloc[0], many["label"].iloc[-1]) == ("99", "0")


def test_a_scale_is_logarithmic_where_values_are_far_apart() -> None:
    assert scale_over([1.0, 11.0])["type"] == "log"
    assert scale_over([1.0, 9.0, np.nan])["type"] == "linear"
    assert scale_over([-1.0, 10.0])["type"] == "linear"


def test_a_page_holds_what_a_pixel_can_show() -> None:
    rows = [
        {"far": far, "close": close, "name": "<b>"}
        for far, close in ((1 / 3, 1000.123456), (3e-9 / 7, 1001.0))
    ]
    columns = json.loads(figure_json({"datasets": {"rows-0": rows}}))["datasets"]["rows-0"]
    assert columns["far"] == [0.3333, 4.286e-10]
    assert columns["close"] == [1000.12, 1001.0]
    assert "<" not in figure_json({"datasets": {"rows-0": rows}})


@pytest.mark.slow
def test_a_fit_draws_its_figures_for_a_notebook(folder) -> None:
    plot = read_run(folder).plot
    shown = plot.people("C")._repr_mimebundle_()["application/vnd.vegalite.v6+json"]
    assert {row["label"] for row in shown["datasets"]["rows-0"]} == {"s0", "s1", "s2", "s3"}
    assert plot.mass().data["impact"].nunique() == 12
    recorded = plot.recording(read_run(folder).posterior["posterior"]["impact"].to_numpy()[3])
    assert "Measured deceleration" in recorded.words


def test_of_a_long_trace_every_peak_stays() -> None:
    values = np.sin(np.arange(10_000) / 50)
    values[[137, 5000]] = 9.0, -9.0
    kept = thinned(values, 100)
    assert len(kept) <= 100
    assert {137, 5000} <= set(kept)
    assert (np.diff(kept) > 0).all()
    np.testing.assert_array_equal(thinned(values[:99], 100), np.arange(99))
