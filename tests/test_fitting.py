from __future__ import annotations

import json
import tomllib
from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pandas as pd
import pytest
import scipy.linalg  # noqa: F401 - so that its BLAS is there
import xarray as xr
from threadpoolctl import threadpool_info, threadpool_limits

import bayestissue as bt
from bayestissue.base.resources import shared
from bayestissue.inference.checking.findings import ELEMENT_ALONE, Finding, of_element_alone
from bayestissue.inference.fit import TraceAnalysis
from bayestissue.inference.single.impact_estimates import estimate
from bayestissue.model.hierarchy.specification import Sampler, read_specification
from bayestissue.model.hierarchy.trace_data import prepare
from bayestissue.reports.pages.fit.fit_run import TABLES
from bayestissue.studies import fitting
from bayestissue.studies.fitting import FitJob, resolve
from bayestissue.studies.simulation import Simulation, simulate
from campaigns import FOUR_BY_FOUR, RECORDER, simulated, spreads
from make_fit_run import fit_of_drops, fit_run, groups_of, stored_fit

WORST = {"r_hat": 1.003, "ess_bulk": 1200.0, "ess_tail": 900.0}


@pytest.fixture(scope="module")
def dataset():
    """A dozen impacts of the example, in every condition."""
    whole, some = bt.read_dataset(shared("data", "example")), slice(None, None, 8)
    impacts = whole.impacts.iloc[some].reset_index(drop=True)
    return replace(whole, impacts=impacts, traces=whole.traces[some])


@pytest.fixture(scope="module")
def fitted(dataset):
    """A fit whose results are made up: the notebook of traces is the test of a real one."""
    run = fit_run()
    tables = {name: run.table(name) for name in TABLES}
    diagnostics = run.diagnostics | {"worst": {name: {"value": v} for name, v in WORST.items()}}
    specification = read_specification(shared("models", "a2.toml"))
    prepared = prepare(dataset, specification, source="a2")
    return FitJob(dataset, specification, prepared, 4).finished(
        TraceAnalysis(run.posterior, diagnostics, tables),
        estimate(dataset, method="dds"),
        (datetime(2026, 1, 1, tzinfo=UTC), 61.54),
    )


@pytest.mark.parametrize(
    ("argument", "wrong"),
    [
        ("model", lambda dataset: bt.fit(dataset, model=3)),
        ("C", lambda dataset: bt.fit(dataset, K="side", C=3)),
        ("file", lambda _: bt.plan(3)),
        ("path", lambda _: bt.read_run(3)),
        ("folder", lambda _: bt.init_dataset(3)),
    ],
)
def test_an_argument_of_another_type_is_named(dataset, argument, wrong):
    with pytest.raises(bt.InputError, match=f"arguments, column {argument}: found 3; expected"):
        wrong(dataset)


@pytest.mark.parametrize("seed", [-1, "a", True, 2**63])
def test_a_seed_that_is_none_is_refused_before_anything_else(seed):
    with pytest.raises(bt.InputError, match=r"column seed: .*a whole number from 0 to \d+. Pass"):
        bt.fit("no folder", seed=seed)


def test_questions_in_a_list_are_refused_by_name(fitted):
    with pytest.raises(bt.InputError, match=r"column questions: .*each by itself"):
        fitted.ask(["K > 3000"])


def test_it_is_shown_in_a_few_lines(fitted):
    evil = replace(fitted, about=fitted.about | {"dataset": "<b>\x1b[2J" + "long" * 100})
    told, page = repr(evil), evil._repr_html_()
    assert max(len(line) for line in told.splitlines()) < 200
    assert "R-hat at most 1.003" in told
    for text in (told, page):
        assert "K of the impacts" in text
        assert "\x1b" not in text
    assert "<b>" not in page
    assert "&lt;b&gt;" in page


def test_its_report_is_the_folder_of_a_finished_run(fitted, tmp_path):
    page = fitted.report(tmp_path / "run")
    assert page == tmp_path / "run" / "report.html"
    about = json.loads((tmp_path / "run" / "run.json").read_text())
    assert (about["kind"], about["seed"], about["wall_time_s"]) == ("fit", 4, 61.5)
    with pytest.raises(bt.InputError, match="empty folder"):
        fitted.report(tmp_path / "run")
    alone = fitted.report(tmp_path / "page.html")
    assert alone.read_text() == page.read_text()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["page.html", "run"]
    with pytest.raises(bt.InputError, match="overwrite=True"):
        fitted.report(alone)


def test_a_run_that_is_read_back_is_the_fit_that_was_made(fitted, tmp_path):
    fitted.report(tmp_path / "run")
    again = bt.read_run(tmp_path / "run")
    for name in (*TABLES, "agreement", "questions"):
        made, read = getattr(fitted, name, None), getattr(again, name, None)
        if isinstance(made, pd.DataFrame):
            pd.testing.assert_frame_equal(read, made, check_dtype=False, check_exact=False, rtol=1e-12)
    for name in ("seed", "started", "wall_time_s", "verdict", "diagnostics"):
        assert getattr(again, name) == getattr(fitted, name), name
    # A folder says where its dataset lies from it.
    assert again.about == fitted.about | {"dataset_folder": again.about["dataset_folder"]}
    assert again.dataset_folder == fitted.dataset_folder
    xr.testing.assert_equal(again.posterior["posterior"].dataset, fitted.posterior["posterior"].dataset)
    pd.testing.assert_frame_equal(again.ask("K_new > 2500"), fitted.ask("K_new > 2500"))
    # Its report is written anew, and a copy of the run.
    copied = again.report(tmp_path / "copy")
    assert copied.read_bytes() == (tmp_path / "run" / "report.html").read_bytes()


def test_a_model_is_a_name_a_path_or_a_specification(tmp_path):
    specification, source = resolve("impact")
    assert specification.likelihood == "impact"
    assert source.endswith("impact.toml")
    assert resolve(shared("models", "impact.toml"))[0] == specification
    assert resolve(specification) == (specification, f"model {specification.name}")
    with pytest.raises(bt.InputError, match=r"nowhere\.toml"):
        resolve(str(tmp_path / "nowhere.toml"))


def test_the_model_that_is_not_named_follows_what_was_recorded():
    assert resolve(None, "deceleration")[0].likelihood == "impact"
    assert resolve(None, "acceleration")[0].likelihood == "impact"
    assert resolve(None, "displacement")[0].likelihood == "arma"


def test_a_model_needs_no_file(dataset, monkeypatch):
    """Formulas and questions beside a model's own; a dict in place of a file; a folder in place of data."""
    asked = {"formulas": {"K": "side", "C": "side"}, "questions": ["K > 0", "C > 0"]}
    for model in (None, {"likelihood": "impact"}):
        specification, _ = resolve(model, **asked)
        assert dict(specification.formula) == asked["formulas"]
        assert specification.questions == {"question_1": "K > 0", "question_2": "C > 0"}
    # Priors of a group term are those of the formula that is fitted.
    file = resolve({"likelihood": "impact", "formula": {"K": "(1|side)"}})[0]
    assert resolve(file, formulas={"K": "1", "C": "1"})[0].priors.sd_group == {}
    assert fitting.formulas_of("side", None) == {"K": "side", "C": "side"}
    assert fitting.formulas_of(None, "side") == {"C": "side"}
    with pytest.raises(bt.InputError, match="model, column likelihood"):
        bt.fit(dataset, {"likelihood": "none"})
    with pytest.raises(bt.InputError, match="a column that K depends on here: none"):
        bt.fit(dataset, "impact", K="1", ask="K[side=left] > 0")
    with pytest.raises(bt.InputError, match="nowhere"):
        bt.fit("nowhere")
    with pytest.raises(bt.InputError, match="a dataset's folder"):
        bt.fit(pd.DataFrame())


@pytest.mark.parametrize("choice", ["automatic", "none"])
@pytest.mark.slow
def test_structured_residuals_ask_for_a_second_fit(dataset, fitted, monkeypatch, tmp_path, choice):
    """The fits themselves are made up: what is asked for, told and kept is not."""
    form = {"score": 9.0, "structured": True, "words": "first"}
    posterior = fitted.posterior["posterior"].dataset
    further = {"discrepancy": 0.05 * posterior["K"] ** 0, "K_secant": posterior["K"]}
    further["log_gain_mean"] = posterior["intercept_K"] - posterior["intercept_K"].mean()
    tree = xr.DataTree.from_dict({"posterior": posterior.assign(further)})
    made = TraceAnalysis(tree, fitted.diagnostics | {"model_form": form}, fitted.tables)
    seen, said, asked = [], [], []

    def fit_traces(job, specification, beginning):
        seen.append((job.prepared.model.discrepancy, job.checkpoints))
        if beginning is None:
            job.progress("summarising each trace", 0, 1)
        return made

    def judge(prepared, expansions, log_gain):
        asked.append(prepared.model.discrepancy)
        impacts = [str(posterior["impact"].to_numpy()[0])]
        first = "the traces contradict the measuring chain"
        finding = Finding("measuring-chain", False, "The zero is off.", first, impacts)
        return finding.record(error="offset", structure_left=0.1, impacts=impacts)

    monkeypatch.setattr(fitting, "fit_traces", fit_traces)
    monkeypatch.setattr(fitting, "judge", judge)
    monkeypatch.setattr(fitting.model_form, "model_form", lambda tree, name: {"score": 0.5})
    specification = read_specification(shared("models", "impact.toml"))
    specification = specification.model_copy(update={"discrepancy": choice})
    prepared = prepare(dataset, specification, source="impact")
    job = FitJob(dataset, specification, prepared, 1)
    found = job.fit(lambda stage, *_: said.append(stage), checkpoints=tmp_path)
    told, about = found.diagnostics["model_form"], found.about
    # The chain is asked without a discrepancy, and speaks first.
    assert asked == [False]
    assert "WARNING: The zero is off." in found.verdict
    assert "contradict the measuring chain" in about["verdict"]["headline"]
    impact = found.diagnostics["measuring_chain"]["impacts"][0]
    assert found.summary.set_index("label")["note"][impact].ne("").all()
    own = found.summary["variable"].map(of_element_alone) & (choice == "automatic")
    notes = found.summary["note"][found.summary["label"] != impact]
    assert (notes == np.where(own[notes.index], ELEMENT_ALONE, "")).all()
    if choice == "automatic":
        assert seen == [(False, tmp_path), (True, tmp_path / "discrepancy")]
        assert (tmp_path / "discrepancy").is_dir()
        assert said[::2] == ["summarising each trace", "again with a discrepancy: summarising each trace"]
        assert "a second fit begins" in said[1]
        assert (told["score"], told["left"], round(told["discrepancy"], 12)) == (9.0, 0.5, 0.05)
        assert "5 % of the peak" in found.verdict
        assert found.prepared.model.discrepancy
        assert about["discrepancy"] == {"rms_of_peak": pytest.approx(0.05), "score_without": 9.0}
    else:
        assert (seen, said) == ([(False, tmp_path)], ["summarising each trace"])
        assert told["structured"]
        assert "discrepancy" not in about


@pytest.mark.long
def test_a_stiffening_tissue_fitted_by_spring_and_damper_keeps_its_secant_stiffness():
    tissue = {"element": "stiffening", "parameters": {"stiffening_depth_m": 0.02}, "K_N_per_m": 2000.0}
    made = simulated(
        tissue | spreads(subject=0.1, impact=0.1),
        RECORDER | {"before_contact_s": 0.005, "after_contact_s": 0.005},
        people=4,
        masses=(0.4, 0.7, 1.2),
        velocity=(1.5, 1.1, 0.8),
        seed=3,
    )
    specification = read_specification(shared("models", "impact.toml"))
    fewer = {"sampler": Sampler(chains=2, draws=500)}
    found = bt.fit(made.dataset("stiffening"), specification.model_copy(update=fewer), 1)
    assert "WARNING" in found.verdict
    assert found.diagnostics["model_form"]["score"] > 10
    posterior = found.posterior["posterior"].dataset
    low, high = posterior["K_secant"].quantile([0.05, 0.95], ("chain", "draw")).to_numpy()
    true = made.truth["K_secant_N_per_m"].to_numpy()
    # Of twelve 90 % intervals: more than four misses are a thousandth's chance.
    assert ((low <= true) & (true <= high)).sum() >= 8
    # The geometric mean of all of them, and the element's own K beside it.
    low, high = posterior["K_secant_of_impacts"].quantile([0.005, 0.995])
    assert low <= np.exp(np.log(true).mean()) <= high


def test_a_fit_has_one_blas_thread_and_gives_the_others_back() -> None:
    def threads() -> dict[str, int]:
        return {
            each["filepath"]: each["num_threads"] for each in threadpool_info() if each["user_api"] == "blas"
        }

    with threadpool_limits(2, user_api="blas"):
        before = threads()
        with fitting._set_up():
            assert set(threads().values()) == {1}
        assert threads() == before


@pytest.mark.slow
def test_the_stored_fit_of_other_tests_has_what_the_program_makes():
    def content(fit: bt.Fit) -> list[object]:
        variables = {name: set(group.variables) for name, group in groups_of(fit).items()}
        columns = {name: list(table) for name, table in fit.tables.items()}
        return [variables, columns, set(fit.about), set(fit.diagnostics)]

    assert content(stored_fit()) == content(fit_of_drops())


@pytest.mark.long
@pytest.mark.parametrize("model", ["impact", "arma"])
def test_a_fit_of_drops_finds_the_tissue(model):
    made = Simulation.model_validate(tomllib.loads(FOUR_BY_FOUR) | {"gravity": "drop"})
    campaign = simulate(made)
    true = campaign.truth["K_N_per_m"].to_numpy()

    def logs(gravity: float) -> np.ndarray:
        dataset = campaign.dataset(made.name).with_settings(gravity=gravity)
        draws = bt.fit(dataset, model).posterior["posterior"]["K"]
        return np.log(draws.transpose("impact", ...).to_numpy().reshape(len(true), -1) / true[:, None])

    found, without = logs(9.80665), logs(0.0)
    # Sixteen impacts, whose errors of mass and velocity are declared: 1.6 is the 0.1 % quantile of the rms.
    z = found.mean(1) / found.std(1)
    assert np.sqrt((z**2).mean()) < 1.6
    assert without.mean() > 0.1
