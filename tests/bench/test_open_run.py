"""A finished fit on a page that a server answers: questions, impacts left out or accepted, kept addresses."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from urllib.parse import quote

import pandas as pd
import pytest
from opened import Client, address, contents, run_and_dataset, served

from bayestissue.base.errors import InputError
from bayestissue.base.runtime import FORMAT
from bayestissue.recordings.dataset import read_dataset
from bayestissue.recordings.dataset.left_out import FILE, reasons, write_left_out
from bayestissue.reports.pages.wording import interval, significant
from bayestissue.studies.bench.run_view import RunView, decisions_on
from bayestissue.studies.bench.server import HOST
from bayestissue.studies.bench.views import Decisions
from bayestissue.studies.finished import read_run
from command_line import bayestissue

pytestmark = pytest.mark.slow

browser = pytest.importorskip(
    "browser", reason="drives a browser by websocket-client, which is not installed"
)
needs_browser = pytest.mark.skipif(browser.CHROMIUM is None, reason="no Chromium is installed")

CLAIM, QUANTITY, WRONG = "K[side=left] / K[side=right] > 1.1", "K[mass_kg=1.2]", "K[side=middle]"
READY = (
    "document.querySelectorAll('#explorer .drawing svg.marks').length === 2 "
    "&& !document.querySelector('#impact').disabled && !document.querySelector('#decide').hidden"
)


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    return run_and_dataset(tmp_path_factory.mktemp("opened"))


@pytest.fixture(scope="module")
def view(folders: tuple[Path, Path]) -> RunView:
    fit = read_run(folders[0])
    return RunView(fit, decisions_on(fit, None))


@pytest.fixture(scope="module")
def port(view: RunView) -> Iterator[int]:
    with served(view) as port:
        yield port


@pytest.fixture(scope="module")
def tab() -> Iterator[browser.Browser]:
    with browser.Browser() as opened:
        yield opened


@pytest.fixture
def nothing_left_out(folders: tuple[Path, Path], view: RunView) -> Iterator[None]:
    """Whatever the test before decided is taken back, and nothing but decisions was written."""
    before = contents(*folders)
    yield
    write_left_out(folders[1], {})
    view.decisions = Decisions(folders[1], view.decisions.changed)
    assert contents(*folders) == before


def text(tab: browser.Browser, selector: str) -> str:
    return tab.js(f"document.querySelector({selector!r}).innerText")


def ask(tab: browser.Browser, question: str) -> None:
    tab.js("document.querySelector('#question').focus()")
    tab.type(question)
    count = tab.js("document.querySelectorAll('#answers .card').length")
    tab.key("Enter")
    tab.until(f"document.querySelectorAll('#answers .card').length === {count + 1}")


@needs_browser
def test_questions_are_answered_refused_and_kept_in_the_address(tab, port, folders) -> None:
    tab.open(address(port))
    tab.until(READY)
    for question in (CLAIM, QUANTITY, WRONG):
        ask(tab, question)
    shown = text(tab, "#answers").replace(",", "")
    # The same as the command says.
    answer = json.loads(bayestissue("ask", folders[0], QUANTITY, "--json").out)["questions"][0]
    assert significant(answer["median"]) in shown
    assert interval(answer["low"], answer["high"]) in shown
    refused = bayestissue("ask", folders[0], WRONG)
    (problem,) = re.findall(r"  question 1.*?\^", refused.err, flags=re.DOTALL)
    on_page = tab.js("document.querySelector('#answers .refused').textContent")
    assert on_page.split() == problem.replace("question 1", "question 3").split()
    assert text(tab, "#question") == ""
    assert tab.js("document.querySelector('#question').value") == WRONG, "what was refused is there to mend"
    # The address opens the same answers, also without a script; a question is taken off again.
    kept = tab.js("location.href")
    assert "token" not in kept
    tab.open(kept, scripts=False)
    assert tab.js("document.querySelectorAll('#answers .card').length") == 3
    assert CLAIM in text(tab, "#answers")
    tab.open(kept)
    tab.until(READY)
    tab.js("document.querySelector('#answers .card:nth-child(3) .off').click()")
    tab.until("document.querySelectorAll('#answers .card').length === 2")
    assert quote("middle") not in tab.js("location.search")
    assert tab.errors == []
    assert all(url.startswith((f"http://{HOST}:{port}/", "blob:", "data:")) for url in tab.requests)


@needs_browser
@pytest.mark.usefixtures("nothing_left_out")
def test_keys_alone_leave_an_impact_out_and_undo_it(tab, port, folders) -> None:
    tab.open(address(port, f"?q={quote(QUANTITY)}"))
    tab.until(READY)
    tab.tab_to("document.activeElement.matches('[data-name=K-over-C] .drawing')")
    tab.key("ArrowRight")
    impact = tab.js("document.querySelector('#impact').value")
    tab.tab_to("document.activeElement.id === 'reason'")
    tab.key("Enter")
    tab.until("document.querySelector('#decide-said').textContent === 'give the reason first'")
    tab.type("hit the frame, undoubtedly")
    tab.key("Enter")
    tab.until("!document.querySelector('#decisions').hidden")
    assert reasons(folders[1]) == {impact: "hit the frame, undoubtedly"}
    words = text(tab, "#decisions")
    assert f"{impact} is left out: hit the frame, undoubtedly. The fit shown still contains it." in words
    assert f"Fit anew: bayestissue fit {folders[1].resolve()} --model" in words
    # A letter that is typed into a field is no command.
    tab.key("u")
    tab.until("document.querySelector('#reason').value.endsWith('u')")
    assert reasons(folders[1]) != {}
    tab.tab_to("document.activeElement.tagName === 'SUMMARY'")
    tab.key("u")
    tab.until("document.querySelector('#decided').children.length === 0")
    assert reasons(folders[1]) == {}
    assert not (folders[1] / FILE).exists()
    assert tab.errors == []


@pytest.mark.usefixtures("nothing_left_out")
def test_what_was_left_out_before_the_fit_is_accepted_again(folders: tuple[Path, Path]) -> None:
    write_left_out(folders[1], {"t0-s0": "late"})
    problems = [str(problem) for problem in read_dataset(folders[1]).left_out]
    fit = read_run(folders[0])
    fit = replace(fit, about=fit.about | {"left_out": problems})
    view = RunView(fit, decisions_on(fit, None))
    view._impacts = [name for name in view._impacts if name != "t0-s0"]
    assert view.state()["left_out"] == [{"impact": "t0-s0", "reason": "late", "fitted": False}]
    assert view.state()["anew"] == "", "the fit shown is of these impacts"
    view.act("decide", {"impact": "t0-s0", "reason": ""})
    assert view.state()["accepted"] == ["t0-s0"]
    assert view.state()["anew"].startswith("bayestissue fit ")
    with pytest.raises(KeyError):
        view.act("decide", {"impact": "nobody", "reason": "x"})
    for impact in list(view.decisions.changed)[1:]:
        view.act("decide", {"impact": impact, "reason": "all of them"})
    with pytest.raises(InputError, match="none left"):
        view.act("decide", {"impact": "t0-s0", "reason": "all of them"})


@pytest.mark.usefixtures("nothing_left_out")
def test_a_phantom_that_is_left_out_asks_for_a_new_fit(folders: tuple[Path, Path]) -> None:
    fit = read_run(folders[0])
    view = RunView(fit, decisions_on(fit, None))
    # As in a fit with phantoms, whose impacts are none of the posterior's.
    view._impacts = [name for name in view._impacts if name != "t0-s0"]
    view.act("decide", {"impact": "t0-s0", "reason": "slipped"})
    assert view.state()["anew"] == ""
    view.fit = replace(fit, diagnostics=fit.diagnostics | {"reference": {"phantoms": ["t0-s0"]}})
    assert view.state()["left_out"] == [{"impact": "t0-s0", "reason": "slipped", "fitted": True}]
    assert view.state()["anew"].startswith("bayestissue fit ")


def test_a_dataset_that_moved_or_changed_leaves_questions_alone(tmp_path: Path) -> None:
    run, dataset = run_and_dataset(tmp_path)
    write_left_out(dataset, {"t0-s0": "late"})
    fit = read_run(run)
    assert decisions_on(fit, None).folder.resolve() == dataset.resolve(), "left_out.csv may change"
    moved = dataset.rename(tmp_path / "moved")
    with pytest.raises(InputError, match="no such folder"):
        decisions_on(fit, None)
    assert decisions_on(fit, moved).folder == moved
    impacts = pd.read_csv(moved / "impacts.csv")
    impacts.assign(mass_kg=impacts["mass_kg"] * 2).to_csv(moved / "impacts.csv", index=False)
    with pytest.raises(InputError, match="has changed since"):
        decisions_on(fit, moved)
    view = RunView(fit, None, "changed")
    with pytest.raises(KeyError):
        view.act("decide", {"impact": "t0-s1", "reason": "x"})
    assert view.state()["why_not"] == "changed"
    assert "N/m" in view.answers([QUANTITY])
    about = {name: value for name, value in fit.about.items() if name != "dataset_folder"}
    with pytest.raises(InputError, match="where the dataset of this run lies"):
        decisions_on(replace(fit, about=about), None)


@pytest.fixture
def client(port: int) -> Iterator[Client]:
    with (opened := Client(port)).opened:
        yield opened


def test_the_page_is_for_whom_has_the_cookie_and_there_is_no_file_but_it(client: Client) -> None:
    for path in ("/", "/answers.html?q=K", "/questions.csv?q=K", "/state", "/library.js"):
        assert client.ask(path, Cookie=None).status == 403
        assert client.ask(path).status == 200
    for path in ("/../run.json", "/run.json", "/posterior.nc", "/%2e%2e/set/impacts.csv"):
        assert client.ask(path).status == 404


def test_the_saved_answers_are_those_of_the_command(client, folders, tmp_path) -> None:
    questions = [CLAIM, QUANTITY]
    saved = client.ask("/questions.csv?" + "&".join(f"q={quote(text)}" for text in (*questions, WRONG)))
    assert saved.status == 200
    bayestissue("ask", folders[0], *questions, "--out", tmp_path / "out")
    assert saved.read().decode() == (tmp_path / "out" / "questions.csv").read_text()


def test_open_says_what_is_wrong_with_a_folder(tmp_path: Path) -> None:
    def refused(folder: Path) -> str:
        ended = bayestissue("open", folder)
        assert ended.status == 2
        return ended.err

    assert "neither" in refused(tmp_path)
    assert "no such folder" in refused(tmp_path / "none")
    (tmp_path / "run.json").write_text(json.dumps({"kind": "estimates", "format": FORMAT}))
    assert "[not-a-fit]" in refused(tmp_path)


def test_the_command_serves_a_run_until_it_is_stopped(tmp_path: Path) -> None:
    run, dataset = run_and_dataset(tmp_path)
    before = contents(run, dataset)
    command = [sys.executable, "-u", "-m", "bayestissue", "open", str(run)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:  # noqa: S603 - this program
        try:
            assert process.stdout is not None
            line = process.stdout.readline()
            shown = re.fullmatch(rf"open http://{HOST}:(\d+)(/\?token=.+)\n", line)
            assert shown is not None, line
            with (client := Client(int(shown[1]))).opened:
                answer = client.ask(shown[2], Cookie=None)
                assert answer.status == 200
                assert b"Ask this fit" in answer.read()
            process.send_signal(signal.SIGINT)
            assert process.wait(60) == 130
        finally:
            process.kill()
    assert contents(run, dataset) == before, "nothing is written by looking"
