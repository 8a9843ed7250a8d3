"""Which level is best on the first screen, and the figures of what impacts do."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from bayestissue.reports.pages import write_report
from bayestissue.reports.pages.fit import figures, level_outcomes
from bayestissue.reports.pages.fit.fit_run import FitRun
from bayestissue.reports.pages.run_folder import read_about
from bayestissue.reports.pages.wording import Spread
from make_fit_run import make_fit_run, read_fit_run
from page_reader import Reader

pytestmark = pytest.mark.usefixtures("read_once")


def plain(html: str) -> str:
    return re.sub(r"\s+", " ", re.sub(r"<[^>]+>", " ", html)).replace("\N{NO-BREAK SPACE}", " ")


def first_screen(html: str) -> str:
    return plain(html[html.index('class="first"') : html.index("<nav")])


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    return make_fit_run(
        tmp_path_factory.mktemp("outcomes") / "run",
        two_sides=True,
        pictures=True,
        mass_varies=False,
        exponent=None,
    )


@pytest.fixture(scope="module")
def run(folder) -> FitRun:
    return read_fit_run(folder, read_about(folder))


@pytest.fixture(scope="module")
def html(folder) -> str:
    return write_report(folder).read_text(encoding="utf-8")


def test_the_first_screen_says_which_level_is_best_and_the_comparisons_by_which_question(run, html) -> None:
    first, compared = (
        first_screen(html),
        plain(html[html.index('id="comparisons"') : html.index('id="outcomes"')]),
    )
    rows = run.levels.set_index(["quantity", "level"])
    force = rows.loc["peak_force"]
    assert force["median"].idxmin() == "right"
    assert "Lowest peak force: almost certainly right" in first
    assert "What are K and C, and what differs by side?" in first
    assert f"{force.loc['right', 'median']:.1f} N" in compared
    assert "best(side, lowest peak_depth[mass_kg=0.7, velocity_m_s=" in compared
    # Beside the ratio of K that of the outcome.
    assert re.search(r"left over right: K × 1\.\d+ .*; peak force × 1\.\d+", compared)
    K = Spread(*rows.loc[("K", "left"), ["median", "low", "high"]])
    assert f"{K.value} {K.range}" in compared
    assert "mass real?" not in first
    page = Reader()
    page.feed(html)
    assert page.open == []
    assert len(page.ids) == len(set(page.ids))
    assert {"outcomes", "comparisons"} <= set(page.ids)


def test_without_compared_levels_nothing_is_said_of_the_best(tmp_path) -> None:
    html = write_report(make_fit_run(tmp_path / "run")).read_text(encoding="utf-8")
    assert "Lowest peak force" not in html
    assert "what differs" not in first_screen(html)
    assert 'id="outcomes"' not in html


def test_of_several_levels_the_two_best_are_held_against_each_other(folder, tmp_path) -> None:
    copied = make_fit_run(tmp_path / "run", two_sides=True)
    table = pd.read_csv(copied / "levels.csv", keep_default_na=False)
    third = table[table["level"] == "left"].assign(level="middle")
    scale = ["median", "low", "high"]
    third[scale] = 2 * third[scale].astype(float)
    pd.concat([table, third]).to_csv(copied / "levels.csv", index=False)
    compared = pd.read_csv(copied / "contrasts.csv", keep_default_na=False)
    others = [compared.assign(level=level, against="middle") for level in ("left", "right")]
    pd.concat([*others, compared]).to_csv(copied / "contrasts.csv", index=False)
    first = first_screen(write_report(copied).read_text(encoding="utf-8"))
    assert "K, left over right: × 1." in first
    assert "over middle" not in first
    assert re.search(r"probability of being best [\w .]+; left \+\d+ %, middle \+\d+ %", first)


def test_the_pictures_numbers_are_those_of_the_tables(run) -> None:
    shown = level_outcomes.loops(run, "side").data
    assert set(shown["level"]) == {"left", "right"}
    assert {one.split(" at ")[0] for one in shown["panel"]} == {"0.7 kg"}
    assert np.allclose(shown["depth_mm"], 1e3 * run.loops["depth_m"])
    assert np.allclose(shown["force_N"], run.loops["force_N"])
    curve = level_outcomes.curves(run, "side").data
    of_force = run.curves[run.curves["quantity"] == "peak_force"]
    assert np.allclose(curve[["median", "low", "high"]], of_force[["median", "low", "high"]])
    ranked = level_outcomes.ranks(run, "side").data
    assert list(ranked["label"]) == ["right, rank 1", "left, rank 2"]
    depth = level_outcomes.ranks(run, "side", "peak_depth").data
    of_depth = run.levels[run.levels["quantity"] == "peak_depth"]
    assert np.allclose(sorted(depth["median"]), sorted(1e3 * of_depth["median"]))


def test_recorded_impacts_are_mass_times_deceleration_over_depth(run) -> None:
    chart = level_outcomes.loops(run, "side").chart
    recorded = chart["data"][chart["data"]["part"] == "recorded"]
    observed, impacts = run.groups["observed_data"], run.impacts_table.set_index("impact")
    for impact, rows in recorded.groupby("impact"):
        at = run.impacts.index(impact)
        assert rows["depth_mm"].max() == pytest.approx(1e3 * np.nanmax(observed["displacement"][at]))
        expected = impacts.loc[impact, "mass_kg"] * float(observed["deceleration"][at, 0])
        assert rows["force_N"].iloc[0] == pytest.approx(expected)
        assert set(rows["level"]) == {impacts.loc[impact, "side"]}


def test_figures_of_what_impacts_do_are_published_and_drawn(run) -> None:
    of_outcomes = dict(level_outcomes.published(run))
    assert list(of_outcomes) == [
        "force-over-depth-by-side",
        "peak_force-curves-by-side",
        "peak_force-ranks-by-side",
        "K-ranks-by-side",
    ]
    assert set(of_outcomes) <= {name for name, _ in figures.published(run)}
    for make in of_outcomes.values():
        assert "<svg" in make().svg()


def test_units_and_words_of_the_dataset_are_on_the_figures(folder, tmp_path) -> None:
    path = folder / "run.json"
    before = path.read_text(encoding="utf-8")
    try:
        path.write_text(json.dumps(json.loads(before) | {"words": {"impact": "drop"}}), encoding="utf-8")
        html = write_report(folder).read_text(encoding="utf-8")
    finally:
        path.write_text(before, encoding="utf-8")
    assert "What drops do" in html
    assert "Lowest peak force of a drop of 0.700 kg" in plain(html)
    assert "impact" not in first_screen(html)


@pytest.mark.parametrize(
    "options",
    [
        {"two_sides": True, "pictures": True, "mass_varies": False, "exponent": None},
        {"likelihood": "impact", "exponent": 0.3, "own_depth": 0.3},
    ],
)
def test_where_impacts_are_many_the_page_has_the_recordings_of_some(tmp_path: Path, options: dict) -> None:
    which = [2, 7, 9]

    def some(groups: dict) -> dict:
        kept = ("observed_data", "posterior_predictive")
        return groups | {name: groups[name].isel(impact=which) for name in kept}

    folder = make_fit_run(tmp_path / "run", extended=some, **options)
    assert write_report(folder).read_text(encoding="utf-8").rstrip().endswith("</html>")
    run = read_fit_run(folder, read_about(folder))
    for figure in level_outcomes.loop_figures(run):
        drawn = json.dumps(figure.specification())
        assert [name for name in run.impacts if f'"{name}"' in drawn] == [run.impacts[at] for at in which]
