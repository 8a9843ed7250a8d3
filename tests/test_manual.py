"""The manual builds strictly: no broken link, no unknown name, no equation that can't be shown."""

from __future__ import annotations

import html
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import typer
from pydantic import BaseModel
from pydantic.fields import FieldInfo

import bayestissue as bt
from bayestissue.base.remedies import entries
from bayestissue.base.results.tables import declared_files
from bayestissue.base.settings import _table_in
from bayestissue.cli import app
from bayestissue.inference.results.labels import GROUPS, variables
from bayestissue.model.hierarchy.priors import Pair, _Prior
from bayestissue.model.hierarchy.specification import ModelSpecification
from bayestissue.recordings.dataset.dataset_file import Settings
from bayestissue.recordings.dataset.impact_table import COLUMNS, RESERVED
from bayestissue.studies.bench.campaign_file import CampaignSpecification
from bayestissue.studies.planning.design_prior import Known
from bayestissue.studies.planning.plan_file import PlanSpecification
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


def test_reading_it_fetches_nothing(manual):
    fetched = re.compile(r'<(?:script|img|iframe)[^>]*\ssrc="(?:https?:)?//|<link[^>]*\shref="(?:https?:)?//')
    for page in manual.rglob("*.html"):
        assert not fetched.search(page.read_text(encoding="utf-8")), page.name
    for style in manual.rglob("*.css"):
        assert not re.search(r"url\(['\"]?(?:https?:)?//", style.read_text(encoding="utf-8")), style.name


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
    for name, about in variables().items():
        if not name.startswith("linear_") and name not in PUBLISHED:
            assert name in shown
            assert about.attrs["unit"], name
            assert about.attrs["long_name"], name
    assert set(GROUPS) <= shown
    assert {"ICC_A1_K", "MDC95_C_C", "repeats_A90_K"} <= shown


PUBLISHED = {f"{q}_{name}" for q in ("K", "C") for name in ("observed", "average", "sd", "cell")}


def test_the_reference_has_every_result_file(manual):
    shown = code(manual, "results")
    for name, file in FILES.items():
        assert {name, *file.columns} <= shown


def test_the_page_of_warnings_has_every_entry(manual):
    page = html.unescape((manual / "how-to" / "warnings.html").read_text(encoding="utf-8"))
    text = " ".join(re.sub(r"<[^>]*>", "", page).split())
    for code, entry in entries().items():
        assert f'id="explain-{code}"' in page
        for words in (entry.title, *(heading for heading, _ in entry.parts[1:])):
            assert words.replace("`", "") in text, code
