"""The manual builds strictly: no broken link, no unknown name, no equation that can't be shown."""

from __future__ import annotations

import html
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pandas as pd
import pytest
import typer
from pydantic import BaseModel
from pydantic.fields import FieldInfo

import bayestissue as bt
from bayestissue.base.remedies import entries
from bayestissue.base.results.tables import declared_files
from bayestissue.base.settings import _table_in
from bayestissue.cli import app
from bayestissue.inference.results.labels import ATTRIBUTES, GROUPS, element_attributes
from bayestissue.model.hierarchy.priors import Pair, _Prior
from bayestissue.model.hierarchy.specification import ModelSpecification
from bayestissue.recordings.dataset.dataset_file import Settings
from bayestissue.recordings.dataset.impact_table import COLUMNS, RESERVED
from bayestissue.studies.bench.campaign_file import CampaignSpecification
from bayestissue.studies.planning.plan_file import PlanSpecification
from bayestissue.studies.planning.planned_population import Known
from bayestissue.studies.simulation.simulation_file import Simulation

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parents[1]
FILES = declared_files()


def build(out: Path, source: Path = ROOT / "docs") -> subprocess.CompletedProcess[str]:
    strict = ["--fail-on-warning", "--nitpicky", "--keep-going", "--quiet"]
    command = [sys.executable, "-m", "sphinx", *strict, "--doctree-dir", str(out.with_name("doctrees"))]
    return subprocess.run([*command, str(source), str(out)], capture_output=True, text=True, check=False)  # noqa: S603


@pytest.fixture(scope="module")
def manual(tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("manual") / "html"
    done = build(out)
    assert done.returncode == 0, done.stderr
    return out


def test_the_manual_builds_without_a_warning(manual):
    assert (manual / "index.html").exists()


def test_reading_it_fetches_nothing(manual):
    fetched = re.compile(r'<(?:script|img|iframe)[^>]*\ssrc="(?:https?:)?//|<link[^>]*\shref="(?:https?:)?//')
    for page in manual.rglob("*.html"):
        assert not fetched.search(page.read_text(encoding="utf-8")), page.name
    for style in manual.rglob("*.css"):
        assert not re.search(r"url\(['\"]?(?:https?:)?//", style.read_text(encoding="utf-8")), style.name


def test_a_long_message_is_wrapped_and_a_table_is_not(manual):
    page = (manual / "how-to" / "write-a-dataset.html").read_text(encoding="utf-8")
    marked = re.findall(r'<span class="long-line">(.*?)</span>\n', page)
    assert len(marked) == 1
    assert "[impossible-value]" in marked[0]
    assert ".long-line { white-space: pre-wrap" in (manual / "_static" / "manual.css").read_text()


def test_a_broken_link_and_an_equation_that_cannot_be_shown_fail(tmp_path):
    (tmp_path / "docs").mkdir()
    for name in ("_extensions", "_static", "conf.py"):
        (tmp_path / "docs" / name).symlink_to(ROOT / "docs" / name)
    (tmp_path / "docs" / "index.md").write_text("# Page\n\n[gone](gone.md)\n\n$\\frac{1}{2}$ $\\nonsense$\n")
    done = build(tmp_path / "html", tmp_path / "docs")
    assert done.returncode == 1
    assert "gone" in done.stderr
    assert "nonsense" in done.stderr
    assert "<mfrac>" in (tmp_path / "html" / "index.html").read_text(encoding="utf-8")


def code(manual: Path, page: str) -> set[str]:
    """What a page of the reference has as code, and the names that it links to."""
    text = html.unescape((manual / "reference" / f"{page}.html").read_text(encoding="utf-8"))
    shown = re.findall(r'<code class="docutils literal notranslate">(.*?)</code>', text)
    return {re.sub(r"<[^>]*>", "", each) for each in shown} | set(
        re.findall(r'id="(bayestissue\.\w+)"', text)
    )


def test_the_reference_has_every_command_and_option(manual):
    shown = code(manual, "commands")
    options = {part for each in shown for part in re.split(r",? ", each)}
    for name, command in typer.main.get_command(app).commands.items():
        assert f'id="{name}"' in (manual / "reference" / "commands.html").read_text(encoding="utf-8")
        assert command.help, name
        for each in command.params:
            assert each.help, f"{name} {each.name}"
            assert set(each.opts) <= options or each.metavar in shown, f"{name} {each.name}"


@pytest.mark.parametrize(
    ("page", "schema"),
    [
        ("model", ModelSpecification),
        ("dataset", Settings),
        ("plan", PlanSpecification),
        ("campaign", CampaignSpecification),
        ("simulate", Simulation),
    ],
)
def test_the_reference_has_every_key_with_its_meaning(manual, page, schema):
    shown = code(manual, page)
    for key, field in fields(schema):
        assert key in shown
        assert field.description, key


def fields(schema: type[BaseModel]) -> Iterator[tuple[str, FieldInfo]]:
    """Keys of a settings file; those of distributions are described once, by other words."""
    for name, field in schema.model_fields.items():
        yield name, field
        inner = _table_in(field.annotation)
        if inner is not None and not issubclass(inner, _Prior | Pair | Known):
            yield from fields(inner)


def test_the_reference_has_every_column_of_impacts(manual):
    assert set(COLUMNS) | {"trace"} <= code(manual, "dataset")
    assert set(RESERVED) <= set(COLUMNS)


def test_the_reference_has_every_public_name_and_its_docstring(manual):
    assert {f"bayestissue.{name}" for name in bt.__all__} <= code(manual, "python")
    assert all(getattr(bt, name).__doc__ for name in bt.__all__)


def test_the_reference_has_every_variable_with_unit_and_meaning(manual):
    shown = code(manual, "posterior")
    for name, about in (ATTRIBUTES | element_attributes()).items():
        if not name.startswith("linear_") and name not in PUBLISHED:
            assert name in shown
            assert about["unit"], name
            assert about["long_name"], name
    assert set(GROUPS) <= shown
    assert {"ICC_A1_K", "MDC95_C_C", "repeats_A90_K"} <= shown


PUBLISHED = {f"{q}_{name}" for q in ("K", "C") for name in ("observed", "average", "sd", "cell")}


def test_the_reference_has_every_result_file(manual):
    shown = code(manual, "results")
    for name, file in FILES.items():
        assert {name, *file.columns} <= shown
    assert {path.name for path in REPORTS} <= {*FILES, "truth.toml"}


def test_the_page_of_warnings_has_every_entry(manual):
    page = html.unescape((manual / "how-to" / "warnings.html").read_text(encoding="utf-8"))
    text = " ".join(re.sub(r"<[^>]*>", "", page).split())
    for code, entry in entries().items():
        assert f'id="explain-{code}"' in page
        for words in (entry.title, *(heading for heading, _ in entry.parts[1:])):
            assert words.replace("`", "") in text, code


def test_the_evidence_has_the_tables_that_were_measured(manual):
    asked = (ROOT / "docs" / "evidence.md").read_text(encoding="utf-8")
    page = (manual / "evidence.html").read_text(encoding="utf-8")
    # One is written there by hand, of what is promised.
    assert page.count("<table") > asked.count(".table.*\n") > 0
    assert "not measured yet" not in page


# The causes are the answer of an earlier version, which the page of the thesis shows.
REPORTS = [path for path in (ROOT / "docs" / "reports").glob("*/*") if path.parent.name != "causes"]
TABLES = sorted(f"{path.parent.name}/{path.name}" for path in REPORTS if path.suffix == ".csv")


@pytest.mark.parametrize("name", TABLES)
def test_tables_have_the_columns_that_the_reference_tells(name):
    path = ROOT / "docs" / "reports" / name
    found = pd.read_csv(path, nrows=1).columns
    told = list(FILES.get(name, FILES[path.name]).columns)
    if path.name == "comparison.csv":
        # Explanations of the thesis's tables are of one kind of data.
        told.remove("data")
    if path.parent.name == "published" and path.name == "summary.csv":
        told.remove("note")
    # What was written by an earlier version may lack a column.
    assert list(found) == [column for column in told if column in found]
