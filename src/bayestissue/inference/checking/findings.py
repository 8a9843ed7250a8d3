"""What checks find of a fit's draws, model and data, and the verdict that follows.

An entry of ``diagnostics.json`` that has a ``code`` is a finding. What it says and how grave it is stands
with its code in `bayestissue.base.remedies`.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from bayestissue.base.errors import Coded
from bayestissue.base.remedies import Code, headlines
from bayestissue.inference.results.summary import UNSETTLED, names_of_rows

# Notes of a summary's rows.
NO_INTERVAL = Coded.stated("undescribed")
CONTRADICTED = Coded.stated("measuring-chain")
FORCE_CONTRADICTS = Coded.stated("channels-disagree.size")
FORCE_OTHER_LAW = Coded.stated("force-form")
PEAK_MISSED = Coded.stated("peak-missed")
ELEMENT_ALONE = Coded.stated("element-alone")
_NOTES = {
    note.code: note
    for note in (NO_INTERVAL, CONTRADICTED, FORCE_CONTRADICTS, FORCE_OTHER_LAW, PEAK_MISSED, ELEMENT_ALONE)
}
ALL_ROWS = ".*"
# Variables of K, of which those of element and discrepancy together are none.
OF_K = r"K(_(?!secant|common_depth).*)?|.*_K"


class Finding(NamedTuple):
    """What one check says of a fit.

    Attributes:
        code: of its entry in `bayestissue.base.remedies`.
        passed: whether there is nothing to warn of.
        words: all that is said; empty where only rows are marked.
        first: what the first line of the fit says of it, if it is the gravest; empty of what is no news.
        rows: of the summary, that have the flag of this code as their note: names of impacts, or a regular
            expression of variables.
    """

    code: Code
    passed: bool
    words: str = ""
    first: str = ""
    rows: Sequence[str] | str = ""

    def record(self, **numbers: Any) -> dict[str, Any]:
        """As it stands in ``diagnostics.json``, with the numbers of the check."""
        return {**numbers, **self._asdict()}


def findings(diagnostics: Mapping[str, Any]) -> list[Finding]:
    """All that the checks of ``diagnostics.json`` found, the gravest first."""
    records = (
        record
        for entry in diagnostics.values()
        for record in (entry if isinstance(entry, list) else [entry])
        if isinstance(record, dict) and "code" in record
    )
    stated = (Finding(**{name: r[name] for name in Finding._fields if name in r}) for r in records)
    order = list(headlines())
    return sorted(stated, key=lambda one: order.index(one.code))


def warnings(diagnostics: Mapping[str, Any]) -> list[Coded]:
    """What the model or its data leave in doubt, whatever the sampler did, the gravest first."""
    return [Coded(one.words, one.code) for one in findings(diagnostics) if one.words and not one.passed]


def remarks(diagnostics: Mapping[str, Any], without: Collection[Code] = ()) -> str:
    """What is not wrong but should be known, in sentences, less those of the codes ``without``."""
    passed = (one for one in findings(diagnostics) if one.passed and one.code not in without)
    return " ".join(one.words for one in passed if one.words)


def warned_codes(diagnostics: Mapping[str, Any]) -> list[Code]:
    """The entries that explain what a fit warns of, failed checks first, flags of recordings last."""
    warned = [one.code for one in findings(diagnostics) if not one.passed]
    flagged = diagnostics.get("recordings")
    return list(dict.fromkeys([*warned, *([flagged["code"], *flagged["codes"]] if flagged else [])]))


def headline(diagnostics: Mapping[str, Any]) -> str:
    """The verdict in one short sentence, for whoever reads no further."""
    if not diagnostics["passed"]:
        return headlines()["r-hat"]
    ranked = findings(diagnostics)
    for one in ranked:
        if not one.passed:
            return headlines()[one.code].format(first=one.first)
    news = [f"; {one.first}" for one in ranked if one.first][:1]
    return f"Diagnostics passed{''.join(news)}."


def verdict_in_words(diagnostics: Mapping[str, Any]) -> str:
    """Whether the run can be trusted, in a sentence; where the model can't, in another; and remarks."""
    return f"{doubts_in_words(diagnostics)} {remarks(diagnostics)}".strip()


def doubts_in_words(diagnostics: Mapping[str, Any]) -> str:
    """The same without the remarks."""
    warned = warnings(diagnostics)
    warning = "".join(f" WARNING: {words}" for words in warned)
    failed = [check["name"] for check in diagnostics["checks"] if not check["passed"]]
    if not failed:
        worst = diagnostics["worst"]
        size = min(worst["ess_bulk"]["value"], worst["ess_tail"]["value"])
        r_hat = worst["r_hat"]["value"]
        return f"R-hat at most {r_hat:.4f}, effective sample sizes at least {size:.0f}.{warning}"
    # Chains are slow where model and traces are at odds.
    why = f" {diagnostics['cause']}" if diagnostics.get("cause") else ""
    why += " The reason may be what the warning says." if warned else ""
    return f"Failed: {', '.join(failed)}. Do not use these numbers yet.{why}{warning}"


def of_element_alone(variable: str) -> bool:
    """Whether beside a discrepancy a variable is of the element's own K, which is not the tissue's."""
    return re.fullmatch(OF_K, variable) is not None


def noted(summary: pd.DataFrame, diagnostics: Mapping[str, Any]) -> pd.DataFrame:
    """The summary with a column ``note``: why a row's interval is none, empty where it is one.

    Of several findings a row has the gravest.
    """
    note = np.full(len(summary), "", dtype=object)
    note[names_of_rows(summary).isin(diagnostics.get("unsettled", ()))] = UNSETTLED
    for one in reversed(findings(diagnostics)):
        if isinstance(one.rows, str) and one.rows:
            note[summary["variable"].str.fullmatch(one.rows)] = _NOTES[one.code]
        elif one.rows:
            note[summary["label"].astype(str).isin(one.rows)] = _NOTES[one.code]
    return summary.assign(note=note)
