"""Specifications of figures: what Vega-Lite makes of them, and what they show."""

from __future__ import annotations

import re

import numpy as np
import pandas as pd
import pytest
import vl_convert

from bayestissue import read_run
from bayestissue.figures.browser import packed_json
from bayestissue.figures.intervals import MOST_LEVELS, intervals, with_ranks
from bayestissue.figures.study import agreement, limits_of_agreement
from bayestissue.figures.theme import Figure, scale_over
from bayestissue.report.fit import figures
from bayestissue.report.fit.run import read_fit_run
from bayestissue.report.run_folder import read_about
from make_fit_run import make_fit_run
from page_reader import figures as specifications


def svg(figure: Figure) -> str:
    return vl_convert.vegalite_to_svg(figure.specification())


def words_in(drawn: str) -> list[str]:
    return re.findall(r"<text[^>]*>([^<]*)</text>", drawn)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return make_fit_run(tmp_path_factory.mktemp("figures") / "run", two_sides=True)


@pytest.fixture(scope="module")
def run(folder):
    made = read_fit_run(folder, read_about(folder))
    # Every person on both sides: conditions in turn on the left and on the right.
    constants = made.groups["constant_data"]
    constants["column_side"] = constants["column_side"].copy(data=np.resize(["left"] * 4 + ["right"] * 4, 12))
    return made


def test_every_figure_of_a_paper_is_drawn_with_names_and_units(run) -> None:
    made = {name: make() for name, make in figures.published(run)}
    for name in ("K-by-subject", "K-paired-by-side", "C-over-mass", "K-repeatability", "recording"):
        assert name in made
    for name, figure in made.items():
        drawn = svg(figure)
        unit = "m/s²" if name == "recording" else "N/m" if name.startswith("K") else "N s/m"
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
    assert {"left", "right"} <= set(words_in(svg(figure)))


def test_repeats_are_pairs_of_one_person(run) -> None:
    pairs = figures.repeats(run, "K")
    values = run.estimates_exact.set_index("impact")["K_N_per_m"]
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
    drawn = svg(
        agreement(pd.DataFrame({"mean": [1.0, 2.0, 3.0], "ratio": ratio[:3]}), "K (N/m)", "a over b", "w")
    )
    assert f"{expected[0]:.3g}" in words_in(drawn)


def test_ranks_are_those_of_the_draws_and_the_middle_of_very_many_is_left_out() -> None:
    draws = np.array([[1.0, 3.0, 2.0], [1.0, 2.0, 3.0]])
    rows = with_ranks(draws, ["a", "b", "c"])
    assert rows.set_index("label")["rank"].to_dict() == {"b": "1 to 2", "c": "1 to 2", "a": "3"}
    many = with_ranks(np.arange(1.0, 101.0) + np.zeros((3, 1)), [f"{k}" for k in range(100)])
    assert len(many) == MOST_LEVELS
    assert (many["label"].iloc[0], many["label"].iloc[-1]) == ("99", "0")


def test_names_from_the_data_are_text() -> None:
    names = ["a.b[0]", "'quoted' \\ <b>", "long " * 20, "_x"]
    rows = with_ranks(np.arange(4.0) + np.ones((2, 1)), names)
    shown = words_in(svg(intervals(rows, "K (N/m)", "words")))
    assert {"a.b[0]", "_x"} <= set(shown)
    assert any("…" in words for words in shown)


def test_a_scale_is_logarithmic_where_values_are_far_apart() -> None:
    assert scale_over([1.0, 10.0])["type"] == "log"
    assert scale_over([1.0, 2.0, np.nan])["type"] == "linear"
    assert scale_over([-1.0, 10.0])["type"] == "linear"


def test_a_table_stands_in_a_specification_once() -> None:
    rows = with_ranks(np.ones((3, 2)), ["a", "b"])
    whole = intervals(rows, "K (N/m)", "words").specification()
    assert list(whole["datasets"]) == ["rows-0"]
    (packed,) = specifications(f'<script type="text/plain" class="packed">{packed_json(whole)}</script>')
    assert '"rows-0":[{"label":"a"' in packed


def test_a_fit_draws_its_figures_for_a_notebook(folder) -> None:
    plot = read_run(folder).plot
    shown = plot.people("C")._repr_mimebundle_()["application/vnd.vegalite.v6+json"]
    assert {row["label"] for row in shown["datasets"]["rows-0"]} == {"s0", "s1", "s2", "s3"}
    assert plot.mass().data["impact"].nunique() == 12
    recorded = plot.recording(read_run(folder).posterior["posterior"]["impact"].to_numpy()[3])
    assert "Measured deceleration" in recorded.words
