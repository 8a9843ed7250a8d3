"""The page of a finished fit with what a server can do: questions answered, impacts left out or accepted."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from threading import Lock
from typing import Any
from urllib.parse import urlencode

import pandas as pd
from markupsafe import Markup

from bayestissue.base.errors import InputError, printable
from bayestissue.base.resources import shared
from bayestissue.base.results.tables import csv_text, table_of_rows
from bayestissue.base.words import Words
from bayestissue.inference.answers.grammar import LONGEST
from bayestissue.inference.answers.questions import Question, ask, numbered
from bayestissue.recordings.dataset import read_dataset
from bayestissue.recordings.dataset.left_out import FILE
from bayestissue.reports.pages.answers_page import answered, question_lines
from bayestissue.reports.pages.fit.fit_page import page_of
from bayestissue.reports.pages.page import assets
from bayestissue.studies.bench.views import Decisions, page_file
from bayestissue.studies.finished import Fit

# Behind these the page has the questions that were asked, and their answers.
_ASKED, _ANSWERS = '<span id="asked" hidden>', '<div id="answers" aria-live="polite">'
# Of questions, whose answers are kept.
_KEPT = 500


class RunView:
    """The report of a fit; see `bayestissue.studies.bench.server.View`."""

    has_figures = True

    def __init__(self, fit: Fit, decisions: Decisions | None, why_not: str = "") -> None:
        """Draw the page.

        Args:
            fit: read back from its folder.
            decisions: of the dataset that was fitted; None where there can be none.
            why_not: why.

        Raises:
            InputError: a file of the run lacks or isn't what a run writes.
        """
        self.fit, self.decisions, self.why_not = fit, decisions, why_not
        self._study, self._asking = fit.study, Lock()
        self._answer = lru_cache(_KEPT)(self._answered)
        self._impacts, self._nouns = fit.impacts, fit.nouns
        self._page = page_of(fit.complete(), served=True, longest=LONGEST, examples=self._examples())
        self._files = assets("explorer.js")
        self._files["page.js"] += "".join(map(page_file, ("server.js", "run.js")))

    @property
    def version(self) -> int:
        """Of the decisions."""
        return 1 if self.decisions is None else self.decisions.version

    def read(self, name: str, query: Mapping[str, Sequence[str]]) -> Any:
        """The page with the answers to its address's questions, a part or a file of it, or its state.

        Raises:
            KeyError: there is nothing of that name.
        """
        questions = query.get("q", ())
        match name:
            case "index.html":
                return self._with_answers(questions)
            case "answers.html":
                return self.answers(questions)
            case "questions.csv":
                return csv_text(self._table(questions))
            case "state":
                return self.state()
            case _:
                return self._files[name]

    def act(self, action: str, content: dict[str, Any]) -> None:
        """Leave an impact out of the dataset, accept it again, or undo the last of these decisions."""
        if self.decisions is None:
            raise KeyError(action)
        self.decisions.act(action, content)

    def _with_answers(self, texts: Sequence[str]) -> str:
        """The page, whose form sends the questions of its address along with the next one."""
        sent = Markup().join(Markup('<input type="hidden" name="q" value="{}">').format(t) for t in texts)
        page = self._page.replace(_ASKED, f"{_ASKED}{sent}", 1)
        return page.replace(_ANSWERS, f"{_ANSWERS}{self.answers(texts)}", 1)

    def answers(self, texts: Sequence[str]) -> str:
        """The answers to questions, or why one is refused, as a part of the page; empty without any."""
        lines = []
        for number, question in enumerate(numbered(texts)):
            rows, problem = self._answer(question)
            others = [*texts[:number], *texts[number + 1 :]]
            (line,) = question_lines(table_of_rows("questions", rows)) if rows else [{"problem": problem}]
            lines.append(line | {"question": question.text, "without": _address("./", others)})
        part = answered(lines, self._table(texts), _address("questions.csv", texts)) if lines else ""
        return Words(self._nouns.nouns, {*self._nouns.unchanged, *texts}).page(str(part))

    def _table(self, texts: Sequence[str]) -> pd.DataFrame:
        """The table that `bayestissue ask` makes, of the questions that have an answer."""
        answers = (self._answer(question) for question in numbered(texts))
        return table_of_rows("questions", [row for rows, _ in answers for row in rows])

    def _answered(self, question: Question) -> tuple[list[dict[str, Any]], str]:
        """The rows of an answer and nothing, or no row and why."""
        try:
            # One at a time: draws are read from the run's file.
            with self._asking:
                rows = ask(self._study, [question]).to_dict("records")
        except InputError as error:
            return [], "\n".join(problem.with_code for problem in error.problems)
        return [{str(name): value for name, value in row.items()} for row in rows], ""

    def state(self) -> dict[str, Any]:
        """What is left out or accepted, other than in the fit that is shown, and how to fit anew."""
        if self.decisions is None:
            return {"version": 1, "dataset": "", "why_not": self.why_not, "left_out": [], "accepted": []}
        version, reasons = self.decisions.version, self.decisions.reasons
        # Impacts of phantoms are none of the people's, and the fit rests on them.
        fitted = {*self._impacts, *self.fit.diagnostics.get("reference", {}).get("phantoms", ())}
        accepted = [i for i in self.decisions.changed if i not in fitted | set(reasons) and self._by_hand(i)]
        differs = bool(accepted or fitted & set(reasons))
        return {
            "version": version,
            "dataset": str(self.decisions.folder),
            "why_not": "",
            "left_out": [
                {"impact": impact, "reason": reason, "fitted": impact in fitted}
                for impact, reason in reasons.items()
            ],
            "accepted": accepted,
            "undone": version > 1,
            "anew": self._anew(self.decisions.folder) if differs else "",
        }

    def _by_hand(self, impact: str) -> bool:
        """Whether somebody had left an impact out of the fit, which was not spoilt or too short."""
        problem = f"{FILE}, column reason, impact {printable(impact)}: "
        return any(words.startswith(problem) for words in self.fit.about.get("left_out", []))

    def _anew(self, folder: Path) -> str:
        """The command that fits the dataset in ``folder`` as it is now, by the model of this run."""
        model = self.fit.about["model"]
        try:
            name = shared("models", f"{model.get('name', '')}.toml").stem
        except FileNotFoundError:
            name = "YOUR-MODEL-FILE"
        formulas = [word for q in ("K", "C") for word in (f"--{q}", model["formula"][q])]
        words = ["bayestissue", "fit", str(folder), "--model", name, *formulas, "--seed", str(self.fit.seed)]
        return shlex.join([*words, "--out", f"{self.fit.folder}-2"])

    def _examples(self) -> list[str]:
        """Questions that this fit has an answer to."""
        recorded = self._study.recorded
        pairs = [
            (column, levels[0], levels[1])
            for column in dict.fromkeys((*recorded.response("K").categories, "subject"))
            if len(levels := recorded.levels(column)) > 1
        ]
        examples = [f"K[{c}={_quoted(a)}] / K[{c}={_quoted(b)}] > 1.1" for c, a, b in pairs]
        if "mass_exponent_K" in self._study.draws:
            examples.append("mass_exponent_K between -0.1 and 0.1")
        return [*examples, "K", "C", f"K[impact={_quoted(self._impacts[0])}]", "K[subject=new]"]


def decisions_on(fit: Fit, dataset: Path | None) -> Decisions:
    """Decisions on the impacts of the dataset that was fitted.

    Args:
        fit: read back from its folder.
        dataset: its folder; where the run says that it lay, unless given.

    Raises:
        InputError: it is not known where it lies, or it is another one, or was changed, but for what is left
            out.
    """
    folder = dataset or fit.dataset_folder
    if folder is None:
        raise InputError.stated("no-dataset.unsaid", str(fit.folder), value="no dataset_folder in run.json")
    data = read_dataset(folder, skip_bad=True, whole=True)
    if data.whole_hash != fit.about.get("whole_hash"):
        raise InputError.stated("no-dataset.changed", str(folder), value="other files")
    names = [*data.impacts["impact"], *(problem.impact for problem in data.left_out if problem.impact)]
    return Decisions(folder, names)


def _address(path: str, texts: Sequence[str]) -> str:
    return f"{path}?{urlencode([('q', text) for text in texts])}" if texts else path


def _quoted(name: str) -> str:
    return name if name.replace("-", "").replace("_", "").isalnum() else f'"{name}"'
