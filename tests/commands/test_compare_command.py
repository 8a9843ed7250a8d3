from __future__ import annotations

from dataclasses import replace

import pandas as pd
import pytest
import xarray as xr
from numpy.testing import assert_allclose

from bayestissue.base.errors import InputError
from bayestissue.commands.finished_runs import compare
from make_fit_run import CONDITIONS, PEOPLE, fit_run, groups_of, make_scored_run

IMPACTS = PEOPLE * CONDITIONS
SCHEMES = ["leave one impact out", "leave one subject out", "leave one trial out"]

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("read_once")]


def compared(*runs, out=None):
    compare(runs=list(runs), out=out, quiet=True)


def refused(*runs) -> str:
    with pytest.raises(InputError) as raised:
        compared(*runs)
    return str(raised.value)


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """Two runs of the same displacements and one of decelerations."""
    folder = tmp_path_factory.mktemp("runs")
    return {
        "arma": make_scored_run(folder / "arma", likelihood="arma"),
        "a2": make_scored_run(folder / "a2", likelihood="a2", worse=2.0),
        "impact": make_scored_run(folder / "impact", likelihood="impact"),
    }


@pytest.fixture(scope="module")
def out(runs, tmp_path_factory):
    folder = tmp_path_factory.mktemp("out") / "comparison"
    compared(runs["a2"], runs["arma"], runs["impact"], out=folder)
    return folder


def test_runs_of_the_same_numbers_get_differences_and_weights(out):
    table = pd.read_csv(out / "comparison.csv", keep_default_na=False, na_values=[""])
    assert list(table["scheme"].unique()) == SCHEMES
    same = table[table["data"] == "displacement"]
    assert list(same["model"]) == ["arma", "a2"] * 3
    best, other = same[same["model"] == "arma"], same[same["model"] == "a2"]
    assert_allclose(best["elpd_difference"], 0)
    # Twelve impacts, each worse by 2 give or take 0.2.
    assert_allclose(other["elpd_difference"], -2.0 * IMPACTS, atol=4 * 0.2 * IMPACTS**0.5)
    assert_allclose(other["se_difference"], 0.2 * IMPACTS**0.5, rtol=1)
    # Stacking stops near the edge of the simplex, not on it.
    assert_allclose(best["weight"], 1, atol=1e-3)


def test_a_density_of_other_numbers_gets_neither(out):
    table = pd.read_csv(out / "comparison.csv")
    alone = table[table["model"] == "impact"]
    assert len(alone) == 3
    assert alone["elpd"].notna().all()
    assert alone[["elpd_difference", "se_difference", "weight"]].isna().all(axis=None)
    assert table["warning"].str.contains("not comparable").all()


def test_another_window_is_another_density(runs, tmp_path):
    about = {"model": {"likelihood": "a2", "signal": {"window": "rebound"}}}
    other = make_scored_run(tmp_path / "centred", shift=-1e-3, about=about)
    compared(runs["a2"], other, out=tmp_path / "out")
    table = pd.read_csv(tmp_path / "out" / "comparison.csv")
    assert set(table["data"]) == {"displacement, window peak", "displacement, window rebound"}
    assert table["elpd_difference"].isna().all()
    html = (tmp_path / "out" / "report.html").read_text()
    assert "different numbers" in html


def test_runs_of_one_name_are_told_apart_by_their_paths(tmp_path):
    first, second = (make_scored_run(tmp_path / part / "run") for part in ("one", "two"))
    compared(first, second, out=tmp_path / "out")
    assert set(pd.read_csv(tmp_path / "out" / "comparison.csv")["model"]) == {"one/run", "two/run"}


def test_what_is_no_two_fits_with_densities_is_refused(runs, tmp_path):
    reproduction = make_scored_run(tmp_path / "reproduction", about={"kind": "published"})
    bare = tmp_path / "bare"
    bare.mkdir()
    groups = {name: part for name, part in groups_of(fit_run()).items() if "likelihood" not in name}
    replace(fit_run(), posterior=xr.DataTree.from_dict(groups)).write(bare)
    for parts, *wrong in (
        (["at least two folders"], runs["a2"]),
        (["another run than"], runs["a2"], runs["a2"] / ".." / "a2"),
        (['"published"', "nothing"], runs["a2"], reproduction, tmp_path / "nothing"),
        (["log_likelihood/trace"], runs["a2"], bare),
    ):
        said = refused(*wrong)
        assert all(part in said for part in parts)


def test_runs_of_different_data_are_named_both(runs, tmp_path):
    other = make_scored_run(tmp_path / "other", about={"input_hash": "f" * 64, "dataset": "heels"})
    said = refused(runs["a2"], other)
    for part in ("other", str(runs["a2"]), fit_run().about["input_hash"][:12], "ffffffff", "heels"):
        assert part in said
