"""What a paper takes from a finished fit: text of nothing but its numbers, and typed tables."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import docx
import numpy as np
import pandas as pd
import pytest
from PIL import Image

import bayestissue as bt
from bayestissue.inference.answers.law import Law
from bayestissue.model.hierarchy.levels import design_at
from bayestissue.reports.pages.wording import Spread
from bayestissue.reports.paper.export import write_markdown, write_word
from bayestissue.reports.paper.text import Text, text_of
from bayestissue.reports.paper.workbook import people_wide, write_sheets
from command_line import bayestissue
from make_fit_run import changed, fit_run, make_fit_run

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("read_once")]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_fit_run(tmp_path_factory.mktemp("exported") / "run", two_sides=True)


@pytest.fixture(scope="module")
def run() -> bt.Fit:
    return fit_run(two_sides=True)


@pytest.fixture(scope="module")
def exported(folder: Path) -> Path:
    out = folder.with_name("paper")
    told = bayestissue("export", folder, "--out", out)
    assert told.status == 0, told.err
    return out


def test_word_and_markdown_say_the_same(exported: Path) -> None:
    markdown = (exported / "methods.md").read_text(encoding="utf-8")
    document = docx.Document(str(exported / "methods.docx"))
    plain = re.sub(r"\\([^\w\s])", r"\1", markdown)
    for paragraph in document.paragraphs:
        assert paragraph.text in plain
    cells = [cell.text for row in document.tables[0].rows for cell in row.cells]
    assert all(cell in markdown for cell in cells)
    cited = {int(number) for group in re.findall(r"\[([\d, ]+)\]", markdown) for number in group.split(", ")}
    references = re.findall(r"^(\d+)\. ", markdown.partition("## References")[2], flags=re.MULTILINE)
    assert cited == {int(number) for number in references}


def test_numbers_of_the_text_are_those_of_the_tables(folder: Path, exported: Path) -> None:
    markdown = (exported / "methods.md").read_text(encoding="utf-8")
    summary = pd.read_csv(folder / "summary.csv").set_index("variable")
    shown = re.search(r"K was (\d+) N/m", markdown)
    assert shown
    # Two digits of the width of its interval: to half a unit of the second.
    width = np.diff(summary.loc["K_typical_person", ["eti90_low", "eti90_high"]].astype(float))[0]
    assert abs(int(shown[1]) - summary.loc["K_typical_person", "median"]) <= width / 20
    record = json.loads((folder / "run.json").read_text(encoding="utf-8"))
    assert f"seed {record['seed']}" in markdown
    assert record["verdict"]["doubts"].rstrip(".") in markdown
    ratio = pd.read_csv(folder / "contrasts.csv").query("quantity == 'K' and factor == 'side'").iloc[0]
    assert f"{ratio['level']} over {ratio['against']}, ratio | {ratio['ratio']:.3f}"[:-2] in markdown


def test_the_text_says_what_an_impact_does(folder: Path, exported: Path) -> None:
    asked = bt.read_run(folder).ask("peak_force", "1000 * peak_depth", "energy_absorbed").to_dict("records")
    force, depth, energy = (Spread(row["median"], row["low"], row["high"]) for row in asked)
    ratio = {
        row["quantity"]: Spread(row["ratio"], row["low"], row["high"]).words
        for row in pd.read_csv(folder / "contrasts.csv").to_dict("records")
    }
    text = (exported / "methods.md").read_text(encoding="utf-8").replace("\\", "")
    assert "On a typical person an impact of 0.695 kg at 1.50 m/s comes to:" in text
    stated = (
        f"{what.value} {unit} ({what.range})" for what, unit in ((force, "N"), (depth, "mm"), (energy, "J"))
    )
    assert "peak force {}, peak depth {} and energy absorbed {}.".format(*stated) in text
    of_levels = "peak force {peak_force}, peak depth {peak_depth} and energy absorbed {energy_absorbed}"
    assert of_levels.format(**ratio) in text


def test_an_interaction_stands_in_text_and_table_and_factors_of_equal_levels_apart(run: bt.Fit) -> None:
    names = {"factor": "group:session", "level": "b:after/before", "against": "a:after/before", "note": ""}
    numbers = {"ratio": 1.22, "low": 1.1, "high": 1.35, "p_direction": 0.98, "p_equivalent": 0.12}
    sides = run.contrasts[run.contrasts["factor"] == "side"]
    further = pd.DataFrame([names | numbers | {"quantity": q, "kind": "interaction"} for q in "KC"])
    several = pd.concat([run.contrasts, sides.assign(factor="shoe"), further], ignore_index=True)
    text = text_of(changed(run, contrasts=several))
    words = "Ratio of ratios after over before, b over a: K 1.22 (1.10 to 1.35) and C 1.22 (1.10 to 1.35)."
    assert any(paragraph.startswith(words) for paragraph in text.sections["Results"])
    rows = dict(zip(text.table[""], text.table["K, N/m"], strict=True))
    assert rows["b:after/before over a:after/before, ratio of ratios"] == "1.22 (1.10 to 1.35)"
    assert rows["left over right of side, ratio"] == rows["left over right of shoe, ratio"]


def test_nothing_is_claimed_where_no_element_describes_the_recordings(run: bt.Fit) -> None:
    verdict = {
        "passed": True,
        "warned": True,
        "headline": "Diagnostics passed.",
        "doubts": "No element does.",
    }
    form = {"model_form": {"undescribed": True}}
    text = text_of(changed(run, diagnostics=form, record={"verdict": verdict}))
    assert text.sections["Results"][0] == "These results are in doubt: Diagnostics passed. No element does."
    assert "Questions" not in text.sections
    assert text.table.empty


def test_names_are_shown_and_not_obeyed(tmp_path: Path) -> None:
    odd = "<script>alert(1)</script> *a* `b` [c](http://d) &lt; _e_ K_new\n# no heading"
    methods = {"Methods": [f"{odd} was hit: log(mass_kg) + (1|subject), p < 0.05 [1, 2]."]}
    text = Text(odd, methods, pd.DataFrame([[odd.replace("\n", " "), "a|b"]], columns=["", "K"]))
    write_markdown(text, tmp_path / "text.md")
    write_word(replace(text, title=odd + "x" * 300), tmp_path / "text.docx")
    shown = r"\<script>alert(1)\</script> \*a\* \`b\` [c\](http://d) \&lt; \_e\_ K_new # no heading"
    written = (tmp_path / "text.md").read_text(encoding="utf-8")
    assert f"# {shown}\n" in written
    assert f"{shown} was hit: log(mass_kg) + (1|subject), p < 0.05 [1, 2]." in written
    assert f"| {shown} | a\\|b |" in written


def test_cells_of_the_workbook_are_typed(folder: Path, exported: Path) -> None:
    sheets = pd.read_excel(exported / "tables.xlsx", sheet_name=None, engine="calamine")
    summary = pd.read_csv(folder / "summary.csv")
    # A workbook holds 16 digits.
    np.testing.assert_allclose(sheets["summary"]["median"], summary["median"], rtol=1e-15)
    assert sheets["summary"]["variable"].tolist() == summary["variable"].tolist()
    described = set(zip(sheets["columns"]["sheet"], sheets["columns"]["column"], strict=True))
    assert {("people_wide", name) for name in sheets["people_wide"]} <= described
    assert {("summary", name) for name in summary} <= described
    impacts = sheets["impacts"].set_index("impact")
    K = summary[summary["variable"] == "K"].set_index("label")["median"]
    np.testing.assert_allclose(impacts["K"], K.reindex(impacts.index), rtol=1e-15)
    assert sheets["priors"].set_index("key").loc["priors.intercept.K.mean", "value"] == 5.0


def test_a_row_a_person_has_the_median_of_each_condition(folder: Path) -> None:
    fit = bt.read_run(folder)
    posterior, rows = fit.posterior["posterior"].dataset, fit.study.recorded.rows
    wide, meanings = people_wide(fit.study)
    assert list(meanings) == list(wide)
    assert all(re.fullmatch(r"\w{1,64}", name) for name in wide)
    first = rows.iloc[0]
    alike = np.flatnonzero(
        (rows["subject"] == first["subject"])
        & (rows["trial"] == first["trial"])
        & (rows["side"] == first["side"] if "side" in rows else True)
    )
    expected = np.exp(np.log(posterior["K"].isel(impact=alike)).mean("impact")).median()
    cells = wide.filter(regex="^K_").iloc[0]
    assert np.isclose(cells, float(expected), rtol=1e-12).sum() == 1


def test_a_row_a_person_has_the_outcomes_of_the_reference_impact_on_each_side(folder: Path) -> None:
    finished = bt.read_run(folder).study
    recorded = finished.recorded
    sides = np.where(recorded.rows.groupby("subject").cumcount() % 2, "left", "right")
    finished = replace(finished, recorded=replace(recorded, rows=recorded.rows.assign(side=sides)))
    wide, meanings = people_wide(finished)
    person, M = finished.recorded.levels("subject")[1], finished.recorded.reference_mass_kg
    V = finished.recorded.rows["velocity_m_s"].mean()
    K, C = (
        np.exp(design_at(finished.recorded, q, [{"subject": person, "side": "left"}]).log(finished.draws))
        for q in ("K", "C")
    )
    omega, zeta = np.sqrt(K / M), C / np.sqrt(4 * K * M)
    phi = np.arccos(zeta)
    # Spring and damper, of a damping ratio below 1/2.
    force = M * omega * V * np.exp(-zeta * (3 * phi - np.pi) / np.sin(phi))
    depth = V / omega * np.exp(-zeta * phi / np.sin(phi))
    lost = M * V**2 / 2 * (1 - np.exp(-4 * zeta * phi / np.sin(phi)))
    row = wide.set_index("subject").loc[person]
    for name, draws in {"peak_force_N": force, "peak_depth_m": depth, "energy_absorbed_J": lost}.items():
        cells = row[[f"{name}_left_low", f"{name}_left", f"{name}_left_high"]].astype(float)
        np.testing.assert_allclose(cells, np.quantile(draws, [0.05, 0.5, 0.95]))
    words = f"greatest force on the impactor of an impact of {M:.4g} kg at {V:.4g} m/s, N: side left; median"
    assert meanings["peak_force_N_left"] == words
    beside, _ = people_wide(replace(finished, law=Law(described=False)))
    assert list(beside) == [name for name in wide if not re.match("peak_|energy_", name)]


def test_a_cell_is_what_it_is_whatever_it_looks_like(tmp_path: Path) -> None:
    table = pd.DataFrame({"text": ["=1+1", "https://x", "7", ""], "number": [1.5, -np.inf, np.nan, 3]})
    write_sheets({"one": table}, tmp_path / "cells.xlsx")
    read = pd.read_excel(tmp_path / "cells.xlsx", engine="calamine", keep_default_na=False)
    assert read["text"].tolist() == ["=1+1", "https://x", "7", ""]
    assert read["number"].tolist() == [1.5, "−∞", "", 3]


def test_figures_are_as_wide_as_a_column_and_have_their_rows(exported: Path) -> None:
    figures = exported / "figures"
    names = {path.stem for path in figures.iterdir()}
    assert {"K-by-subject", "K-over-mass", "K-of-impacts", "recording"} <= names
    for name in names:
        svg = (figures / f"{name}.svg").read_text(encoding="utf-8")
        width = float(re.search(r'width="([\d.]+)"', svg)[1])
        # An inch has 96 pixels, and 300 dots.
        assert width == pytest.approx(85 / 25.4 * 96, abs=0.01)
        assert (figures / f"{name}.pdf").read_bytes().startswith(b"%PDF")
        with Image.open(figures / f"{name}.png") as image:
            assert image.width == pytest.approx(85 / 25.4 * 300, abs=1)
        assert len(pd.read_csv(figures / f"{name}.csv"))
        assert "NaN" not in svg


def test_what_is_there_is_not_replaced(folder: Path, exported: Path) -> None:
    assert bayestissue("export", folder, "--out", exported).status == 2
    assert bayestissue("export", folder, "--out", folder, "--overwrite").status == 2
    assert bayestissue("export", exported, "--out", exported.with_name("new")).status == 2


def test_exclusions_are_a_sentence(run: bt.Fit) -> None:
    def said(**record: list) -> list[str]:
        return text_of(changed(run, record=record)).sections["Measurements"]

    assert "No recording was left out." in said(left_out=[])
    why = [("a1", "the impactor touched the frame"), ("a2", "the recording is clipped: 9 samples at 4")]
    why += [("a3", "the impactor touched the frame"), ("a2", "a narrow peak")]
    exclusions = [{"impact": impact, "reason": reason} for impact, reason in why]
    assert (
        f"Of {len(run.impacts) + 3} recordings, 3 were left out of the analysis: a1 and a3 (the impactor "
        "touched the frame) and a2 (the recording is clipped: 9 samples at 4; a narrow peak)."
    ) in said(left_out=["expected impacts that nobody left out"], exclusions=exclusions)
    # A run of an earlier version has no words for a sentence.
    short = f"Of {len(run.impacts) + 1} recordings, 1 was left out of the analysis."
    assert short in said(left_out=["a"], exclusions=[])
