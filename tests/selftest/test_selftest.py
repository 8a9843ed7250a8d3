"""The self-test: each part by itself, what becomes of what it finds, and the command."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from bayestissue.base.results.tables import read_table
from bayestissue.recordings.dataset.recorders import SUFFIXES
from bayestissue.studies.selftest import fits, selftest_checks
from bayestissue.studies.selftest.fits import Compared, differing
from bayestissue.studies.selftest.selftest_checks import Part, run, verdict
from command_line import bayestissue

GOOD, BAD = Compared("one", "1", "1", True), Compared("two", "2", "3", False)


def silent(stage: str, done: int, total: int) -> None:
    """Say nothing."""


def test_every_format_is_read(tmp_path: Path) -> None:
    comparisons = selftest_checks.read_back(tmp_path)
    assert [finding for finding in comparisons if not finding.passed] == []
    assert [finding.what for finding in comparisons] == list(SUFFIXES)


def test_a_format_that_is_read_wrong_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    samples = shutil.copytree(selftest_checks.SAMPLES, tmp_path / "samples")
    text = (samples / "recording.csv").read_text()
    (samples / "recording.csv").write_text(text.replace(",17.16", ",17.17"))
    assert text != (samples / "recording.csv").read_text()
    monkeypatch.setattr(selftest_checks, "SAMPLES", samples)
    (tmp_path / "read").mkdir()
    assert [f.what for f in selftest_checks.read_back(tmp_path / "read") if not f.passed] == [".csv"]


def test_a_check_that_ends_by_an_error_is_one_that_failed(tmp_path: Path) -> None:
    def broken(folder: Path) -> Iterator[Compared]:
        (folder / "seen").touch()
        yield GOOD
        raise ValueError("no such thing")

    table = run(
        [Part("a", lambda _: [GOOD]), Part("b", broken), Part("c", lambda _: [BAD])], tmp_path, silent
    )
    assert table["passed"].tolist() == [1, 0, 0]
    assert table["found"].tolist() == ["1", "ValueError: no such thing", "3"]
    passed, words = verdict(table)
    assert not passed
    assert words == "The self-test failed: 2 of 3 checks (b, c). Trust no result."
    assert verdict(table[:1])[1].startswith("The self-test passed: 1 checks in")


def test_coverage_fails_where_a_correct_program_hardly_ever_does() -> None:
    of_thirty = [fits.coverage(np.arange(30) < hits).passed for hits in range(31)]
    assert of_thirty == [hits >= 20 for hits in range(31)]


def test_tables_differ_by_their_last_digit() -> None:
    here = pd.DataFrame({"a": [1.0, np.nan]})
    assert differing("t", here, here.copy()).passed
    assert differing("t", here, here * (1 + 2e-16)).found == "1 differ"
    assert not differing("t", here, here[:1]).passed


def test_checks_that_take_long_are_thorough_ones(tmp_path: Path) -> None:
    names = {check.name: check.thorough for check in selftest_checks.checks(tmp_path)}
    assert names["published: sleepstudy"]
    assert names["recovery by maxwell"]
    assert not names["recovery by impact"]
    assert not names["a killed fit goes on"]
    assert 12 < sum(not thorough for thorough in names.values()) < 20


@pytest.mark.parametrize(("finding", "status"), [(GOOD, 0), (BAD, 3)])
def test_the_command_writes_what_it_found_and_ends_by_its_verdict(
    finding: Compared, status: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(selftest_checks, "checks", lambda _: [Part("part", lambda _: [GOOD, finding])])
    monkeypatch.chdir(tmp_path)
    ended = bayestissue("selftest", "--quiet")
    assert ended.status == status, ended.err
    assert (
        ended.out.strip().splitlines()[-1].startswith("The self-test " + ("failed" if status else "passed"))
    )
    table = read_table(tmp_path / "selftest", "selftest")
    assert table["passed"].tolist() == [1, int(finding.passed)]
    record = json.loads((tmp_path / "selftest" / "run.json").read_text(encoding="utf-8"))
    assert record["verdict"]["passed"] == finding.passed
    page = (tmp_path / "selftest" / "selftest.md").read_text(encoding="utf-8")
    assert record["versions"]["jax"] in page
    assert f"| part | {finding.what} | {finding.expected} | {finding.found} |" in page
    # The files of the test are gone.
    assert {path.name for path in (tmp_path / "selftest").iterdir()} == {
        *("selftest.csv", "selftest.md", "run.json", ".bayestissue.json")
    }
    assert [path.name for path in tmp_path.iterdir()] == ["selftest"]


@pytest.mark.long
def test_the_self_test_passes_here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    ended = bayestissue("selftest")
    assert ended.status == 0, ended.out
