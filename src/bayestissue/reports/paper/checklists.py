"""The checklists that journals ask for, answered as far as a run knows the answer: BARG and GRRAS."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pandas as pd

from bayestissue.base.declarations import declared
from bayestissue.base.outline import markdown_rows
from bayestissue.base.results.tables import table_of_rows
from bayestissue.reports.pages.fit.fit_run import FitRun
from bayestissue.reports.pages.page import part, worded
from bayestissue.reports.pages.posterior import prior_remark
from bayestissue.reports.paper.text import Text

_FILE = "checklists.toml"


def checklists(run: FitRun, text: Text, certified: Mapping[str, Any] | None = None) -> pd.DataFrame:
    """The table ``checklists.csv``: what each item asks, what the run answers, and what it leaves to people.

    Args:
        run: a finished fit.
        text: `text_of` it, whose sections answer items.
        certified: the ``verdict`` of its certificate, if it has one.
    """
    known, rows = part("words/checklists.jinja"), []
    stated = {"prior": prior_remark(run.sensitivity)} | {
        name: text for name, text in (certified or {}).items() if text
    }
    for guideline, content in declared(__package__, _FILE).items():
        for item in content["items"]:
            answers = [
                worded("checklists", key, run, stated)
                if hasattr(known, key)
                else " ".join(text.sections.get(key, []))
                for key in item.get("answers", [])
            ]
            answer = " ".join(filter(None, answers))
            question = item.get("ask", "") or ("" if answer else item.get("ask_without", ""))
            rows.append((guideline, item["number"], item["item"], int(bool(answer)), answer, question))
    table = table_of_rows("checklists", rows)
    words = ["item", "answer", "question"]
    return table.assign(**{name: [text.nouns(words) for words in table[name]] for name in words})


def checklists_markdown(table: pd.DataFrame) -> list[str]:
    """The lines of both lists, each with its source."""
    lines = []
    for guideline, rows in table.groupby("guideline", sort=False):
        heading = declared(__package__, _FILE)[str(guideline)]
        cells = ((row["number"], row["item"], _cell(row)) for row in rows.to_dict("records"))
        lines += [f"## {heading['title']} ({guideline})", "", heading["source"], ""]
        lines += [*markdown_rows(("", "item", "this study"), cells), ""]
    return lines


def _cell(row: Mapping[Any, Any]) -> str:
    question = f"**To say: {row['question']}**" if row["question"] else ""
    return " ".join(filter(None, [row["answer"], question]))
