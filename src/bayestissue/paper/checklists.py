"""The checklists that journals ask for, answered as far as a run knows the answer: BARG and GRRAS."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pandas as pd

from bayestissue.declarations import declared
from bayestissue.outline import counted, markdown_rows
from bayestissue.paper.text import Text
from bayestissue.report.fit.run import FitRun
from bayestissue.report.posterior import prior_remark
from bayestissue.results.tables import table_of_rows

_FILE = "checklists.toml"


def checklists(run: FitRun, text: Text, certified: Mapping[str, Any] | None = None) -> pd.DataFrame:
    """The table ``checklists.csv``: what each item asks, what the run answers, and what it leaves to people.

    Args:
        run: a finished fit.
        text: `text_of` it, whose sections answer items.
        certified: the ``verdict`` of its certificate, if it has one.
    """
    known = _answers(run, certified or {})
    rows = []
    for guideline, content in declared(__package__, _FILE).items():
        for item in content["items"]:
            found = [known[key] if key in known else _section(text, key) for key in item.get("answers", [])]
            answer = " ".join(filter(None, found))
            question = item.get("ask", "") or ("" if answer else item.get("ask_without", ""))
            rows.append((guideline, item["number"], item["item"], int(bool(answer)), answer, question))
    table = table_of_rows("checklists", rows)
    words = ["item", "answer", "question"]
    return table.assign(**{name: [text.nouns(words) for words in table[name]] for name in words})


def checklists_markdown(table: pd.DataFrame) -> list[str]:
    """The lines of both lists, each with its source."""
    lines = []
    for guideline, rows in table.groupby("guideline", sort=False):
        about = declared(__package__, _FILE)[str(guideline)]
        cells = ((row["number"], row["item"], _cell(row)) for row in rows.to_dict("records"))
        lines += [f"## {about['title']} ({guideline})", "", about["source"], ""]
        lines += [*markdown_rows(("", "item", "this study"), cells), ""]
    return lines


def _cell(row: Mapping[Any, Any]) -> str:
    question = f"**To say: {row['question']}**" if row["question"] else ""
    return " ".join(filter(None, [row["answer"], question]))


def _section(text: Text, heading: str) -> str:
    """What a section of methods.md says."""
    return " ".join(text.sections.get(heading, []))


def _answers(run: FitRun, certified: Mapping[str, Any]) -> dict[str, str]:
    """What sections do not say, by the keys of ``checklists.toml``; empty where the run does not know."""
    record, people = run.record, run.people_count
    model = record.get("model", {})
    questions = model.get("questions", {})
    formulas = model.get("formula", {})
    per_person = sorted(set(run.impacts_table["person"].value_counts()))
    of_person = f"{per_person[0]}" if len(per_person) == 1 else f"{per_person[0]} to {per_person[-1]}"
    near = model.get("practical_equivalence", {})
    regions = "; ".join(f"{name.replace('_', ' ')} {value}" for name, value in near.items())
    versions = ", ".join(f"{name} {number}" for name, number in record.get("versions", {}).items())
    moved = str(certified.get("prior", "") or prior_remark(run.sensitivity))
    return {
        "questions": f"Asked of the posterior: {'; '.join(questions.values())}." if questions else "",
        "formulas": f"Formulas: {'; '.join(f'log {q} ~ {f}' for q, f in formulas.items())}.",
        "priors": "All priors with their parameters stand in tables.xlsx and in the report.",
        "formal": f"The model as it was resolved, “{model.get('name', '')}”, is in run.json; its equations "
        "are in the manual's pages on the likelihood and the engine.",
        "prior_predictive": "The run has draws of the prior and traces predicted by it (groups prior and "
        "prior_predictive of posterior.nc); the report shows prior beside posterior.",
        "software": f"{versions}." if versions else "",
        "exact": "A Markov chain: no approximation of the posterior stands in its place.",
        "form": str(run.diagnostics.get("model_form", {}).get("words", "")),
        "decisions": f"Practically equivalent: {regions}." if regions else "",
        "sensitivity": f"{moved} Power scaling of each quantity is in sensitivity.csv.".strip(),
        "reproducible": f"Seed {record.get('seed')}; SHA-256 of the recordings "
        f"{record.get('input_hash', '')}; versions above. {certified.get('words', '')}".strip(),
        "numbers": f"{counted(people, 'person', 'people')}, {counted(len(run.impacts), 'impact')}, "
        f"{of_person} of each person.",
        "detailed": "summary.csv has every impact and every quantity.",
    }
