from __future__ import annotations

import json
from pathlib import Path

import pandas as pd
import pytest

from bayestissue.reports.pages.wording import estimated
from command_line import bayestissue
from make_fit_run import make_fit_run

pytestmark = pytest.mark.usefixtures("read_once")


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_fit_run(tmp_path_factory.mktemp("asked") / "run")


@pytest.mark.slow
def test_answers_are_printed_and_written(run: Path, tmp_path: Path) -> None:
    questions = ("K[subject=s1] / K[subject=s2] > 1.1", "K[mass_kg=1.2]")
    told = bayestissue("ask", run, *questions, "--out", tmp_path / "out")
    assert told.status == 0
    for words in ("probability of each claim", "median and 90 % interval", "200 draws of the posterior"):
        assert words in told.out
    table = pd.read_csv(tmp_path / "out" / "questions.csv")
    assert table["question"].tolist() == list(questions)
    assert list(table)[:5] == ["question", "posterior", "prior", "bayes_factor", "mcse"]
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "2 questions to a fit of made up" in page
    assert "<code>K[subject=s1] / K[subject=s2] &gt; 1.1</code>" in page
    # No question has a name, so that there is no column of names.
    assert ">name</th>" not in page
    shown = json.loads(bayestissue("ask", run, *questions, "--json").out)["questions"]
    assert shown[0]["posterior"] == table["posterior"][0]


def test_wrong_questions_are_refused_all_at_once(run: Path, tmp_path: Path) -> None:
    told = bayestissue("ask", run, "K[subject=s9]", "__import__('os')", "--out", tmp_path / "out")
    assert told.status == 2
    assert "2 problems; nothing was written." in told.err
    assert "question 1, column 11" in told.err
    assert "question 2, column 12" in told.err
    assert not (tmp_path / "out").exists()
    assert "problems" in json.loads(bayestissue("ask", run, "K[", "--json").err)


def test_answers_can_be_read_on_a_narrow_terminal(run: Path, monkeypatch) -> None:
    monkeypatch.setenv("COLUMNS", "20")
    told = bayestissue("ask", run, "K[subject=s1] / K[subject=s2] > 1.1", "K[mass_kg=1.2]")
    table = json.loads(bayestissue("ask", run, "K[mass_kg=1.2]", "--json").out)["questions"][0]
    median, *_ = estimated(*(table[name] for name in ("median", "low", "high")))
    for words in ("K[subject=s1] / K[subject=s2] > 1.1", "Monte Carlo error", f"median: {median}\n"):
        assert words in told.out
