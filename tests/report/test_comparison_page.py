from __future__ import annotations

import json
import re
import shutil

import pytest

import bayestissue as bt
from bayestissue.base.errors import InputError
from bayestissue.base.results.tables import table_of_rows
from bayestissue.base.runtime import FORMAT
from bayestissue.inference.model_comparison import same_questions
from bayestissue.reports.pages import write_report
from bayestissue.reports.pages.comparison import answers_figure, answers_table
from make_fit_run import fit_run, make_scored_run
from page_reader import figures, require_whole

pytestmark = pytest.mark.usefixtures("read_once")


def made(folder, **runs):
    paths = [make_scored_run(folder / name, **options) for name, options in runs.items()]
    bt.compare(*paths).report(folder / "out")
    return folder / "out"


def plain(html):
    return re.sub(r"\s+", " ", re.sub(r"<[^>]+>", "", html)).replace("\N{NO-BREAK SPACE}", " ")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return made(
        tmp_path_factory.mktemp("comparison"),
        arma={"likelihood": "arma"},
        a2={"likelihood": "a2", "worse": 2.0},
        impact={"likelihood": "impact", "passed": False, "exponent": None},
    )


@pytest.fixture(scope="module")
def html(folder):
    return (folder / "report.html").read_text(encoding="utf-8")


def test_it_says_what_predicts_best_what_cannot_be_compared_and_what_failed(html):
    require_whole(html)
    text = plain(html[: html.index("<nav")])
    assert "DIAGNOSTICS FAILED in impact" in text
    assert "Densities of displacement: Leave one impact out: “arma” predicts best" in text
    assert "different numbers: “arma” and “a2” of displacement; “impact” of deceleration" in text
    assert "K: not in this model (impact)" in text
    assert re.search(r"K = 2\d{3} N/m [\d ]+to [\d ]+ \(a2\)", text)


def test_warnings_come_first_and_different_elements_are_compared_by_what_means_the_same(folder, tmp_path):
    about = json.loads((folder / "run.json").read_text(encoding="utf-8"))
    for run in about["runs"]:
        run["verdict"] = {"passed": True, "words": "", "warned": run["name"] == "a2", "headline": "Not so."}
    about["runs"][1]["model"]["element"] = "maxwell"
    out = shutil.copytree(folder, tmp_path / "other")
    # With its mark the run would be refused as changed.
    (out / ".bayestissue.json").unlink()
    (out / "run.json").write_text(json.dumps(about), encoding="utf-8")
    html = write_report(out).read_text(encoding="utf-8")
    text = plain(html)
    assert "The sampler passed in every run, but 1 of them is warned of. a2: Not so." in text
    assert "Diagnostics passed in every run" not in text
    assert "whose K and C are different things" in text
    assert "interval of a new impact on a new person" not in text
    assert "secant K of these impacts together (geometric mean) (N/m)" in " ".join(figures(html))


def test_runs_answer_the_same_questions_side_by_side() -> None:
    compared = fit_run(two_sides=True).contrasts
    other = compared.assign(ratio=1.01 * compared["ratio"])
    tables = {"one": {"contrasts": compared}, "two": {"contrasts": other}}
    claim = {"question": "K > 1", "posterior": 0.9, "unit": "", "level": ""}
    tables["two"]["questions"] = table_of_rows("questions", [claim])
    answers = same_questions(tables)
    table = answers_table(answers, ["one", "two"])
    cells = {row.cells[0]: row.cells[1:] for row in table.rows}
    (first,) = (row for question, row in cells.items() if question.startswith("K, side left over right"))
    assert first[0].startswith(f"{compared['ratio'].iloc[0]:.2f} (")
    assert cells["K > 1"] == ("not in this run", "probability 0.90")
    drawn = answers_figure(answers)
    assert set(drawn.data["series"]) == {"one", "two"}
    assert answers_figure(answers[answers["run"] == "two"]) is None


def test_what_lacks_is_named(folder, tmp_path):
    out = shutil.copytree(folder, tmp_path / "lacks")
    (out / "posteriors.csv").unlink()
    with pytest.raises(InputError, match=r"posteriors\.csv"):
        write_report(out)
    (out / ".bayestissue.json").unlink()
    (out / "run.json").write_text(json.dumps({"kind": "comparison", "format": FORMAT}))
    with pytest.raises(InputError, match="runs"):
        write_report(out)
