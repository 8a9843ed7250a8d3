"""Methods and results of a fit as the paragraphs of a paper, of nothing but what the run's files hold."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
import pandas as pd

from bayestissue.base.declarations import declared
from bayestissue.base.outcome_table import DECLARED
from bayestissue.base.words import PLAIN, Words
from bayestissue.inference.answers.contrasts import INTERACTION
from bayestissue.inference.answers.study import Study
from bayestissue.inference.checking.findings import findings
from bayestissue.inference.results.meanings import TOGETHER, meaning, outcome_name
from bayestissue.reports.pages.fit import answers, study_answers
from bayestissue.reports.pages.fit.fit_run import FitRun
from bayestissue.reports.pages.page import written
from bayestissue.reports.pages.posterior import QUANTITIES, exponent, levels, spread
from bayestissue.reports.pages.wording import SENTENCES, Spread, listed


@dataclass
class Text:
    """A text with headings, one table and numbered references.

    Attributes:
        title: of the whole.
        sections: paragraphs by heading, in order.
        table: the main numbers, as text.
        references: in the order in which they are cited first.
        nouns: what the dataset calls people, conditions and impacts.
    """

    title: str
    sections: dict[str, list[str]] = field(default_factory=dict)
    table: pd.DataFrame = field(default_factory=pd.DataFrame)
    references: list[str] = field(default_factory=list)
    nouns: Words = PLAIN

    def cite(self, *names: str, **details: str) -> str:
        """Numbers of references in brackets, such as "[1, 2]"."""
        texts = [declared(__package__, "references.toml")[name].format(**details) for name in names]
        self.references += [text for text in texts if text not in self.references]
        return f"[{', '.join(str(self.references.index(text) + 1) for text in texts)}]"


def text_of(run: FitRun, study: Study | None = None) -> Text:
    """Methods and results of a fit; with what questions need of it, also what an impact does.

    Where its diagnostics failed, or no element describes the recordings, that is the first sentence of the
    results. Where the fit does not have something, such as repeats or a mass exponent, nothing is said of it.
    """
    text = Text(f"Methods and results: {run.record['dataset']}", nouns=run.nouns)
    further = {"computation": text.cite, "repeatability": text.cite, "results": study}
    for heading, macro in SENTENCES["methods"].items():
        values = [further[macro]] if macro in further else []
        if paragraphs := written("methods", macro, run, *values):
            text.sections[heading] = [run.nouns(words) for words in paragraphs]
    if not run.undescribed:
        text.table = _table(run).map(run.nouns)
    return text


# Of all recorded impacts.
together = meaning(TOGETHER).level


def span(values: np.ndarray) -> str:
    """The least and the greatest number, or the one that all are."""
    low, high = (f"{value:.4g}" for value in (np.nanmin(values), np.nanmax(values)))
    return low if low == high else f"{low} to {high}"


def stated_errors(run: FitRun) -> list[str]:
    """The standard deviations of the measuring chain that the dataset states, in words."""
    stated = run.record.get("uncertainty", {})
    of_signal = "m" if run.shown == "displacement" else "m/s²"
    return [
        f"{name} {factor * stated[key]:.3g} {unit or of_signal}"
        for key, (name, factor, unit) in SENTENCES["errors_in_paper"].items()
        if stated.get(key)
    ]


def left_out(run: FitRun) -> tuple[int, list[str]]:
    """How many recordings were left out, and which, with the reasons."""
    reasons: dict[str, list[str]] = {}
    names: dict[str, list[str]] = {}
    for line in run.record.get("exclusions", []):
        reasons.setdefault(str(line["impact"]), []).append(str(line["reason"]))
    for impact, why in reasons.items():
        names.setdefault("; ".join(dict.fromkeys(why)), []).append(impact)
    known = run.record.get("left_out", [])
    count = len(reasons or known) if known else 0
    return count, [f"{listed(who)} ({why})" for why, who in names.items()]


def verdict(run: FitRun) -> str:
    """Whether the run can be trusted; what is said of single recordings stands with the measurements."""
    verdict = run.record.get("verdict", {})
    return f"{verdict.get('headline', '')} {_without_commands(verdict.get('doubts', ''))}".strip()


def flags(run: FitRun) -> str:
    """What is said of single recordings."""
    said = (one.words.removeprefix("NOTE: ") for one in findings(run.diagnostics) if one.passed)
    return " ".join(_without_commands(words[:1].upper() + words[1:]) for words in said if words)


def _without_commands(words: str) -> str:
    """Without sentences that advise a command of the program."""
    return " ".join(sentence for sentence in re.split(r"(?<=\.)\s+(?=[A-Z`])", words) if "`" not in sentence)


def reference_outcomes(study: Study | None) -> Iterator[tuple[str, list[str]]]:
    """The reference impact, and what it does on a typical person; nothing without a law or a velocity."""
    if study is None or not (values := study.of_reference_impact([{}])):
        return
    parts = []
    for name, draws in values.items():
        _, unit, factor = DECLARED[str(name)].shown
        shown = spread(factor * draws.to_numpy().ravel())
        parts.append(f"{outcome_name(str(name))} {shown.value} {unit} ({shown.range})")
    mass, velocity = (float(study.motion([{}])[name][0]) for name in ("mass_kg", "velocity_m_s"))
    yield study_answers.impact_words(mass, velocity), parts


def _table(run: FitRun) -> pd.DataFrame:
    """K and C of a typical and a new person, ratios, mass exponents and repeatability, as text."""
    by, rows = answers.answering(run), []
    if len(run.impacts) > 1:
        who = answers.person_words(run)
        if run.element_alone:
            rows.append([f"K_secant, {meaning(TOGETHER).level}", _cell(levels(run)[0].new), ""])
        for name in ("typical", "new"):
            shown = ["" if level.these else _cell(getattr(level, name)) for level in levels(run)]
            rows.append([who[name], *shown])
    compared = run.contrasts[run.contrasts["quantity"].isin(run.of_tissue)]
    for (factor, level, against), part in compared.groupby(["factor", "level", "against"], sort=False):
        same_levels = run.contrasts[(run.contrasts["level"] == level) & (run.contrasts["against"] == against)]
        of_factor = f" of {factor}" if (same_levels["factor"] != factor).any() else ""
        name = "ratio of ratios" if part["kind"].iloc[0] == INTERACTION else "ratio"
        rows.append([f"{level} over {against}{of_factor}, {name}", *_cells(part, "ratio")])
    rows.append(["mass exponent", *(_cell(exponent(run, by[q])) for q in QUANTITIES)])
    forms = run.reliability.set_index(["measure", "form", "unit"]).sort_index()
    for (measure, form, unit), title in _REPEATABILITY.items():
        part = forms.loc[[(measure, form, unit)]] if (measure, form, unit) in forms.index else forms[:0]
        rows.append([title, *_cells(part, "median")])
    return pd.DataFrame([row for row in rows if any(row[1:])], columns=["", "K, N/m", "C, N s/m"])


_REPEATABILITY = {
    (study_answers.ICC, "ICC(C,1)", "1"): "ICC(C,1)",
    (study_answers.ICC, "ICC(A,1)", "1"): "ICC(A,1)",
    (study_answers.MDC, "repeat", "%"): "minimal detectable change (95 %), %",
}


def _cells(part: pd.DataFrame, value: str) -> list[str]:
    """A cell for K and for C of rows with ``value``, ``low`` and ``high``; empty where there is none."""
    by = part.drop_duplicates("quantity").set_index("quantity").to_dict("index")
    return [_cell(Spread.of(by[q], value) if q in by else None) for q in QUANTITIES]


def _cell(spread: Spread | None) -> str:
    return "" if spread is None else spread.words
