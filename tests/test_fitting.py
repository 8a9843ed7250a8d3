from __future__ import annotations

import json
from datetime import UTC, datetime

import jax
import pandas as pd
import pytest
import xarray as xr

import bayestissue as bt
from bayestissue.fitting import TABLES, Fit, resolve
from bayestissue.hierarchy.specification import read_specification
from bayestissue.hierarchy.trace_data import prepare
from bayestissue.inference.traces import TraceAnalysis
from bayestissue.resources import shared
from make_fit_run import make_fit_run

WORST = {"r_hat": 1.003, "ess_bulk": 1200.0, "ess_tail": 900.0}


@pytest.fixture(scope="module")
def dataset():
    return bt.read_dataset(shared("data", "example"))


@pytest.fixture(scope="module")
def fitted(dataset, tmp_path_factory):
    """A fit whose results are made up: the notebook of traces is the test of a real one."""
    folder = make_fit_run(tmp_path_factory.mktemp("made") / "run")
    with xr.open_datatree(folder / "posterior.nc", engine="h5netcdf") as stored:
        tree = stored.load()
    tables = {name: pd.read_csv(folder / f"{name}.csv", keep_default_na=False) for name in TABLES}
    diagnostics = json.loads((folder / "diagnostics.json").read_text())
    diagnostics["worst"] = {name: {"value": v} for name, v in WORST.items()}
    specification = read_specification(shared("models", "a2.toml"))
    return Fit(
        dataset,
        specification,
        prepare(dataset, specification, source="a2"),
        TraceAnalysis(tree=tree, diagnostics=diagnostics, **tables),
        4,
        datetime(2026, 1, 1, tzinfo=UTC),
        61.54,
    )


def test_a_fit_hands_out_its_posterior_summary_and_diagnostics(fitted):
    assert "posterior" in fitted.posterior.children
    assert "mass_exponent_K" in set(fitted.summary["variable"])
    assert fitted.diagnostics["passed"] is True
    assert "effective sample sizes at least 900" in fitted.verdict


def test_its_report_is_the_folder_of_a_finished_run(fitted, tmp_path):
    page = fitted.report(tmp_path / "run")
    assert page == tmp_path / "run" / "report.html"
    about = json.loads((tmp_path / "run" / "run.json").read_text())
    told = {key: about[key] for key in ("kind", "seed", "dataset", "wall_time_s", "started")}
    assert told == {
        "kind": "fit",
        "seed": 4,
        "dataset": "example",
        "wall_time_s": 61.5,
        "started": "2026-01-01T00:00:00+00:00",
    }
    with xr.open_datatree(tmp_path / "run" / "posterior.nc", engine="h5netcdf") as stored:
        assert set(stored.children) == set(fitted.posterior.children)
    with pytest.raises(bt.InputError, match="empty folder"):
        fitted.report(tmp_path / "run")
    alone = fitted.report(tmp_path / "page.html")
    assert alone.read_text() == page.read_text()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["page.html", "run"]
    with pytest.raises(bt.InputError, match="overwrite=True"):
        fitted.report(alone)


def test_what_the_caller_set_up_is_as_it_was(dataset):
    jax.config.update("jax_enable_x64", False)
    try:
        with pytest.raises(bt.InputError):
            bt.fit(dataset, read_specification(shared("models", "published.toml")))
        assert not jax.config.jax_enable_x64
    finally:
        jax.config.update("jax_enable_x64", True)


def test_a_model_is_a_name_a_path_or_a_specification(tmp_path):
    specification, source = resolve("impact")
    assert specification.likelihood == "impact"
    assert source.endswith("impact.toml")
    assert resolve(shared("models", "impact.toml"))[0] == specification
    assert resolve(specification) == (specification, f"model {specification.name}")
    with pytest.raises(bt.InputError, match=r"nowhere\.toml"):
        resolve(str(tmp_path / "nowhere.toml"))
