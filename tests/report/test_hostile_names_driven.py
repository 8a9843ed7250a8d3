"""Every page in a browser with names that are HTML, scripts and templates: all is text, nothing runs."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
import xarray as xr
from test_estimates_page import make_estimates_run

import bayestissue as bt
from bayestissue.base.errors import InputError
from bayestissue.base.results.tables import declared_files
from bayestissue.recordings.dataset import read_dataset, write_dataset
from bayestissue.recordings.signal import displacements
from bayestissue.reports.pages import write_report
from bayestissue.reports.pages.answers_page import predictions_page, questions_page
from bayestissue.reports.pages.plan_page import page_of
from bayestissue.reports.pages.recordings_pages import init_page
from bayestissue.studies.certificate.certificate import Certificate
from bayestissue.studies.checking import check
from dataset_bench import SETTINGS, tables
from make_fit_run import fit_run, make_fit_run, make_scored_run
from make_published_run import make_published_run
from stand_in_planner import kernel

browser = pytest.importorskip(
    "browser", reason="drives a browser by websocket-client, which is not installed"
)
pytestmark = [
    pytest.mark.skipif(browser.CHROMIUM is None, reason="no Chromium is installed"),
    pytest.mark.slow,
]

RUNS = "hurt=1"
HOSTILE = f"""'"><img src=x onerror="{RUNS}"><script>{RUNS}</script></script>{{{{7*7}}}}javascript:{RUNS}"""
# What a run folder of an attacker says, past all that a dataset.toml is checked for.
WORDS = dict.fromkeys(("subject", "subjects", "trial", "trials", "impact", "impacts"), HOSTILE)
NAMES = re.compile(r"\b(t\d-s\d|[tsi]\d+|<b>|left|right|made up)(?!\w)")


def hostile(value: Any) -> Any:
    """Every name of a value with what would run behind it."""
    if isinstance(value, dict):
        return {key: hostile(inner) for key, inner in value.items()}
    if isinstance(value, list):
        return [hostile(inner) for inner in value]
    return NAMES.sub(lambda match: match[0] + HOSTILE, value) if isinstance(value, str) else value


def hostile_table(table: pd.DataFrame) -> pd.DataFrame:
    texts = table.select_dtypes(["object", "string", "category"])
    return table.assign(**{name: texts[name].astype(object).map(hostile) for name in texts})


def hostile_run(folder: Path) -> Path:
    """A run whose every name is hostile."""
    for path in folder.glob("*.csv"):
        if path.stat().st_size:
            hostile_table(pd.read_csv(path, keep_default_na=False)).to_csv(path, index=False)
    about = json.loads((folder / "run.json").read_text())
    about |= {"words": WORDS, "dataset": HOSTILE, "description": HOSTILE, "left_out": [HOSTILE]}
    (folder / "run.json").write_text(json.dumps(hostile(about)))
    draws = folder / "posterior.nc"
    if draws.exists():
        with xr.open_datatree(draws, engine="h5netcdf") as tree:
            groups = {name: part.to_dataset().load() for name, part in tree.children.items()}
        for data in groups.values():
            for name, texts in data.variables.items():
                if texts.dtype.kind in "OUT" and texts.ndim == 1:
                    data[name] = texts.dims, [hostile(str(text)) for text in texts.to_numpy()]
        draws.unlink()
        xr.DataTree.from_dict(groups).to_netcdf(draws, engine="h5netcdf")
    return folder


def dataset(folder: Path) -> Path:
    impacts, traces = tables()
    for name in ("subject", "trial", "sex"):
        impacts[name] += HOSTILE
    impacts["impact"] += HOSTILE
    traces["impact"] = traces["impact"].astype(str) + HOSTILE
    settings = SETTINGS | {"name": HOSTILE, "description": HOSTILE}
    write_dataset(folder / "data", settings=settings, impacts=impacts, traces=traces)
    return folder / "data"


def saved(folder: Path, html: str) -> Path:
    page = folder / "page.html"
    page.write_text(html, encoding="utf-8")
    return page


def checked(folder: Path) -> Path:
    return saved(folder, check(dataset(folder)).page())


def started(folder: Path) -> Path:
    understood, notes = [(HOSTILE, HOSTILE)], [HOSTILE]
    data = read_dataset(dataset(folder))
    return saved(
        folder, init_page(data, displacements(data), understood=understood, left_out=[], notes=notes)
    )


def estimates(folder: Path) -> Path:
    return write_report(hostile_run(make_estimates_run(folder)))


def published(folder: Path) -> Path:
    return write_report(hostile_run(make_published_run(folder / "run")))


def fitted(folder: Path) -> Path:
    return write_report(hostile_run(make_fit_run(folder / "run", two_sides=True)))


def comparison(folder: Path) -> Path:
    runs = [
        hostile_run(make_scored_run(folder / f"{HOSTILE[:9]}{worse}", worse=worse)) for worse in (0.0, 2.0)
    ]
    bt.compare(*runs).report(folder / "out")
    return folder / "out" / "report.html"


def answers(folder: Path) -> Path:
    fit = fit_run(two_sides=True)
    table = fit.ask("K[side=left] / K[side=right] > 1.1", "K[subject=s1]")
    return saved(folder, questions_page(hostile_table(table), record(fit)))


def predictions(folder: Path) -> Path:
    fit = fit_run(two_sides=True)
    new = pd.DataFrame({"mass_kg": [0.6, 1.0], "velocity_m_s": [1.2, 2.0], "side": ["left", "right"]})
    return saved(folder, predictions_page(hostile_table(fit.predict(new)), record(fit)))


def record(fit: bt.Fit) -> dict[str, Any]:
    return hostile(fit.about) | {"words": WORDS, "dataset": HOSTILE}


def plan(folder: Path) -> Path:
    with kernel():
        made = bt.plan(people=6, masses_kg=[0.5, 1.0], ask="mass_exponent_K < 0.5", studies=100, seed=2)
    content = made.content
    content["plan"] |= {"name": HOSTILE, "description": HOSTILE}
    content |= {"words": WORDS}
    return saved(folder, page_of(content, made.designs, {"program": "bayestissue", "command": HOSTILE}))


def certificate(folder: Path) -> Path:
    made = {
        name: pd.DataFrame(
            [
                {
                    column: (1.0 if kind.kind != "text" else HOSTILE)
                    for column, kind in declared_files()[f"{name}.csv"].columns.items()
                }
            ]
        )
        for name in Certificate.table_names
    }
    about = {"dataset": HOSTILE, "started": "2026-01-01", "refits": 20, "refits_failed": 1, "words": WORDS}
    about |= {
        "program": "bayestissue",
        "command": HOSTILE,
        "against": HOSTILE,
        "run": {"started": "2026-01-01"},
    }
    about |= {"verdict": {"passed": False, "words": HOSTILE, "prior": HOSTILE}}
    return saved(folder, Certificate(about, **made).page())


@pytest.fixture(scope="module")
def tab():
    with browser.Browser() as opened:
        yield opened


@pytest.mark.parametrize(
    "page",
    [checked, started, estimates, published, fitted, comparison, answers, predictions, plan, certificate],
)
def test_names_are_text_on_a_page(page: Callable[[Path], Path], tab, tmp_path: Path) -> None:
    """Wide and narrow, every figure is drawn and nothing is cut."""
    tab.read(page(tmp_path))
    tab.js("document.querySelectorAll('details').forEach(part => { part.open = true; })")
    tab.until(browser.DRAWN)
    assert tab.js("typeof hurt") == "undefined"
    assert tab.js("document.querySelectorAll('[onerror], [href^=javascript], [src=x]').length") == 0
    assert tab.js("document.body.innerText.includes('{{7*7}}')")
    assert tab.errors == []


def test_the_policy_of_a_page_refuses_all_but_its_own_script(tab, tmp_path: Path) -> None:
    page = checked(tmp_path)
    text = page.read_text(encoding="utf-8")
    assert text.index("Content-Security-Policy") < text.index("<title>")
    for injected in (f"<script>{RUNS}</script>", f'<img src=x onerror="{RUNS}">'):
        tab.open(saved(tmp_path, text.replace("<main>", f"<main>{injected}", 1)))
        tab.until(browser.DRAWN)
        assert tab.js("typeof hurt") == "undefined"
        assert "Content Security Policy" in " ".join(tab.errors)


def test_a_noun_holds_no_html(tmp_path: Path) -> None:
    folder = dataset(tmp_path)
    settings = folder / "dataset.toml"
    settings.write_text(settings.read_text() + f"\n[words]\nimpact = '<script>{RUNS}</script>'\n")
    with pytest.raises(InputError, match="without <"):
        read_dataset(folder)
