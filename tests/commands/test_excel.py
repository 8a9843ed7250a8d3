"""``--excel``: tables that a spreadsheet opens by itself, and that the program reads again as any others."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import typer

from bayestissue.dataset import write_dataset
from bayestissue.report import write_report
from bayestissue.results import read_table, write_table
from command_line import bayestissue
from dataset_bench import SETTINGS, tables
from make_fit_run import make_fit_run

pytestmark = pytest.mark.usefixtures("read_once")

MARK = b"\xef\xbb\xbf"
EXCELS = {"comma": {"sep": ";", "decimal": ","}, "point": {"sep": ",", "decimal": "."}}


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_fit_run(tmp_path_factory.mktemp("fit") / "run")


@pytest.mark.parametrize("excel", EXCELS)
def test_what_is_written_is_read_again(excel: str, tmp_path: Path) -> None:
    table = pd.DataFrame(
        {
            "name": ["Müller; A", "1,5", "", "x"],
            "K": [1234.5, np.nan, 1e-17, -0.1 + 0.2j.imag],
            "count": [1, 2, 3, 4],
            "flags": ["low by 3.5 %", "a, b", "", "1.5"],
        }
    )
    plain, spreadsheet = (tmp_path / kind for kind in ("plain", "excel"))
    for folder, option in ((plain, None), (spreadsheet, excel)):
        folder.mkdir()
        write_table(table, folder / "vary.csv", option)  # type: ignore[arg-type]
    data = (spreadsheet / "vary.csv").read_bytes()
    assert data.startswith(MARK + b"name" + EXCELS[excel]["sep"].encode())
    assert data.count(b"\r\n") == len(table) + 1
    pd.testing.assert_frame_equal(
        pd.read_csv(spreadsheet / "vary.csv", **EXCELS[excel]), pd.read_csv(plain / "vary.csv")
    )
    pd.testing.assert_frame_equal(read_table(spreadsheet, "vary"), read_table(plain, "vary"))


@pytest.mark.parametrize("excel", EXCELS)
def test_no_name_is_computed_by_a_spreadsheet(excel: str, tmp_path: Path) -> None:
    names = [
        "=1+1",
        "+A1",
        "-cmd|' /C calc'!A0",
        "@SUM(A1)",
        "\t=1",
        "'=kept",
        "-1.5",
        "+2",
        "-1,5",
        "plain",
        "=a",
    ]
    table = pd.DataFrame({"name": names, "=K": np.linspace(-1, 1, len(names))})
    write_table(table, tmp_path / "vary.csv", excel)  # type: ignore[arg-type]
    shown = pd.read_csv(tmp_path / "vary.csv", **EXCELS[excel], dtype={"name": str})
    assert list(shown) == ["name", "'=K"]
    computed = [name for name in shown["name"] if name.lstrip()[0] in "=+-@"]
    assert computed == ["-1.5", "+2", "-1,5"]
    again = read_table(tmp_path, "vary")
    assert list(again) == ["name", "=K"]
    np.testing.assert_array_equal(again["=K"], table["=K"])
    if excel == "point":
        assert again["name"].tolist() == names


def test_the_machine_says_which(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    table = pd.DataFrame({"a": [1.5], "b": ["x"]})
    for mark, written in ((",", "1,5;x"), (".", "1.5,x")):
        monkeypatch.setattr("locale.localeconv", lambda mark=mark: {"decimal_point": mark})
        write_table(table, tmp_path / "a.csv", "auto")
        assert (tmp_path / "a.csv").read_text("utf-8-sig").splitlines()[1] == written


def _page(folder: Path) -> str:
    """The page of a run without the times of day and of computing."""
    return re.sub(
        r"20\d\d-\d\d-\d\dT\S+|\d+(\.\d+)? s\b|src=\"[^\"]*\"", "", (folder / "report.html").read_text()
    )


@pytest.mark.slow
def test_estimates_open_in_a_german_excel_and_are_the_same(tmp_path: Path) -> None:
    impacts, traces = tables()
    write_dataset(tmp_path / "data", settings=SETTINGS, impacts=impacts, traces=traces)
    for name, option in (("plain", ()), ("excel", ("--excel", "comma"))):
        made = bayestissue("estimate", tmp_path / "data", "--out", tmp_path / name, "--quiet", *option)
        assert (made.status, made.err) == (0, "")
    pd.testing.assert_frame_equal(
        pd.read_csv(tmp_path / "excel" / "estimates.csv", sep=";", decimal=","),
        pd.read_csv(tmp_path / "plain" / "estimates.csv"),
    )
    assert bayestissue("report", tmp_path / "excel").status == 0
    assert _page(tmp_path / "excel") == _page(tmp_path / "plain")
    checked = bayestissue("check", tmp_path / "data", "--out", tmp_path / "check", "--excel", "comma")
    assert checked.status == 0
    assert (tmp_path / "check" / "quality.csv").read_bytes().startswith(MARK)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("command", "name"),
    [(("ask", "K > 1000", "K"), "questions"), (("predict", "--at", "at.csv"), "predictions")],
)
def test_answers(command: tuple[str, ...], name: str, run: Path, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    # And a table of a German spreadsheet is read.
    Path("at.csv").write_bytes("subject;mass_kg\r\nneu;1,25\r\n".encode("cp1252"))
    for out, option in (("plain", ()), ("excel", ("--excel", "comma"))):
        made = bayestissue(command[0], run, *command[1:], "--out", out, "--quiet", *option)
        assert (made.status, made.err) == (0, "")
    pd.testing.assert_frame_equal(
        pd.read_csv(f"excel/{name}.csv", sep=";", decimal=","), pd.read_csv(f"plain/{name}.csv")
    )
    assert Path(f"excel/{name}.csv").read_bytes().startswith(MARK)


@pytest.mark.slow
def test_a_fit_whose_tables_are_for_excel_is_reported_alike(run: Path, tmp_path: Path) -> None:
    folder = make_fit_run(tmp_path / "run")
    for path in folder.glob("*.csv"):
        write_table(pd.read_csv(path, keep_default_na=False), path, "comma")
    write_report(run)
    write_report(folder)
    assert _page(folder) == _page(run)


def test_a_fit_writes_them(tmp_path: Path) -> None:
    """By its own function, since a fit takes long: the command has the option."""
    from bayestissue import cli

    command = typer.main.get_command(cli.app).commands["fit"]
    parsed = command.make_context("fit", ["data", "--out", "out", "--excel", "point"])
    assert parsed.params["excel"] == "point"
