from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from typer.testing import CliRunner

from bayestissue.base.errors import InputError
from bayestissue.base.runtime import FORMAT
from bayestissue.cli import app
from bayestissue.reports.pages import write_report
from make_fit_run import changed, fit_run, make_fit_run

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def copied(published_run_folder, tmp_path):
    return shutil.copytree(published_run_folder, tmp_path / "run")


def problems_of(folder):
    with pytest.raises(InputError) as caught:
        write_report(folder)
    return caught.value.problems


def places_of(folder):
    return {(Path(problem.file).name, problem.column) for problem in problems_of(folder)}


def test_every_missing_column_and_wrong_cell_is_named_at_once(copied):
    hypotheses = (copied / "hypotheses.csv").read_text().replace("probability", "chance", 1)
    (copied / "hypotheses.csv").write_text(hypotheses)
    sensitivity = (copied / "sensitivity.csv").read_text().replace(",0.0016,", ",much,", 1)
    (copied / "sensitivity.csv").write_text(sensitivity)
    found = {(problem.column, problem.row) for problem in problems_of(copied)}
    assert found == {("probability", 1), ("prior", 2)}


@pytest.mark.parametrize("content", [None, "[]", "{", '{"kind": 3}'])
def test_a_run_json_that_no_run_wrote_is_refused(copied, content):
    if content is None:
        (copied / "run.json").unlink()
    else:
        (copied / "run.json").write_text(content)
    assert problems_of(copied)[0].file.endswith("run.json")


def test_a_kind_of_run_that_has_no_report_is_refused(copied):
    (copied / "run.json").write_text(json.dumps({"kind": "poem", "format": FORMAT}))
    (problem,) = problems_of(copied)
    assert (problem.column, problem.value) == ("kind", "poem")


def test_a_broken_posterior_is_refused_and_the_old_page_stays(copied):
    (copied / "report.html").write_text("old")
    (copied / "posterior.nc").write_bytes(b"not netCDF at all")
    assert problems_of(copied)[0].file.endswith("posterior.nc")
    assert (copied / "report.html").read_text() == "old"


def test_all_that_is_damaged_is_named_at_once(tmp_path):
    folder = tmp_path / "run"
    drawn = fit_run().posterior["posterior"].to_dataset()
    made = changed(fit_run(), groups={"posterior": drawn.drop_vars("K_new")})
    folder.mkdir()
    made.write(folder)
    (folder / "sensitivity.csv").write_text("variable,diagnosis,prior\n", encoding="utf-8")
    (folder / "diagnostics.json").write_text("{}", encoding="utf-8")
    damaged = {("posterior.nc", None), ("sensitivity.csv", "likelihood"), ("diagnostics.json", None)}
    assert places_of(folder) == damaged
    (folder / "posterior.nc").write_bytes(b"not a file of draws")
    assert places_of(folder) == damaged
    lacking = ("summary.csv", "estimates_dds.csv")
    for name in lacking:
        (folder / name).unlink()
    assert places_of(folder) == {(name, None) for name in lacking}
    assert not (folder / "report.html").exists()


def test_the_command_writes_the_page_and_says_where(copied):
    result = CliRunner().invoke(app, ["report", str(copied)])
    assert result.exit_code == 0
    assert str(copied / "report.html") in result.output.replace("\n", "")
    quiet = CliRunner().invoke(app, ["report", str(copied), "--quiet"])
    assert quiet.output == ""


@pytest.mark.parametrize(
    ("words", "written"),
    [
        ("report RUN", None),
        ("ask RUN K", 0),
        ("predict RUN --at new.csv", 99),
        ("export RUN --out out", None),
        ("open RUN", 0),
        ("certify RUN --out out", 99),
        ("compare RUN OTHER", 0),
        ("fit data --continue RUN --out out", 99),
    ],
)
def test_a_run_of_another_version_is_refused_with_how_to_make_it_anew(
    words: str, written: int | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run, other = make_fit_run(tmp_path / "run"), make_fit_run(tmp_path / "other")
    about = json.loads((run / "run.json").read_text()) | {"format": written}
    (run / "run.json").write_text(json.dumps({k: v for k, v in about.items() if v is not None}))
    monkeypatch.chdir(tmp_path)
    (tmp_path / "new.csv").write_text("mass_kg\n0.5\n")
    shutil.copytree(ROOT / "data" / "example", tmp_path / "data")
    named = {"RUN": str(run), "OTHER": str(other)}
    told = CliRunner().invoke(app, [named.get(word, word) for word in words.split()])
    (problem,) = told.exception.problems
    assert problem.code == "another-version"
    assert (problem.column, problem.value) == ("format", "none" if written is None else written)
    assert "`bayestissue fit DATASET --out DIR`" in problem.remedy
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("words", ["report RUN", "ask RUN peak_force"])
def test_a_run_of_an_element_that_this_version_lacks_is_refused(
    words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = make_fit_run(tmp_path / "run")
    about = json.loads((run / "run.json").read_text())
    about["model"]["element"] = "soap"
    (run / "run.json").write_text(json.dumps(about))
    monkeypatch.chdir(tmp_path)
    told = CliRunner().invoke(app, [{"RUN": str(run)}.get(word, word) for word in words.split()])
    (problem,) = told.exception.problems
    assert (problem.code, problem.column, problem.value) == ("another-version", "model.element", "soap")
    assert "kelvin_voigt" in problem.expected
