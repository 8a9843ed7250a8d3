"""Methods and results of a fit as the paragraphs of a paper, of nothing but what the run's files hold."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd
from markupsafe import Markup

from bayestissue.base.declarations import declared
from bayestissue.base.words import PLAIN, Words
from bayestissue.inference.answers.contrasts import INTERACTION
from bayestissue.inference.answers.study import Study
from bayestissue.inference.checking.findings import findings
from bayestissue.inference.results.meanings import TOGETHER, UNITS, meaning, outcome_name
from bayestissue.mechanics.elements.outcomes import DECLARED
from bayestissue.reports.pages.answers_page import question_lines
from bayestissue.reports.pages.fit import answers, level_outcomes, model_words, study_answers
from bayestissue.reports.pages.fit.fit_run import FitRun
from bayestissue.reports.pages.fit.sentences import said
from bayestissue.reports.pages.page import worded
from bayestissue.reports.pages.posterior import QUANTITIES, exponent, levels, spread
from bayestissue.reports.pages.wording import Spread, listed

_ERRORS = {
    "relative_mass_sd": ("mass", 100.0, "%"),
    "velocity_sd_m_s": ("velocity", 1.0, "m/s"),
    "relative_gain_sd": ("gain of the sensor", 100.0, "%"),
    "offset_sd": ("offset of the sensor", 1.0, ""),
}


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

    def add(self, heading: str, *paragraphs: str) -> None:
        """Add the paragraphs that are not empty; without any there is no heading."""
        plain = [words.striptags() if isinstance(words, Markup) else words for words in paragraphs]
        if stated := [words for words in plain if words.strip()]:
            self.sections[heading] = [self.nouns(words) for words in stated]

    def cite(self, *names: str, **details: str) -> str:
        """Numbers of references in brackets, such as "[1, 2]"."""
        texts = [declared(__package__, "references.toml")[name].format(**details) for name in names]
        self.references += [text for text in texts if text not in self.references]
        return f"[{', '.join(str(self.references.index(text) + 1) for text in texts)}]"


def text_of(run: FitRun, asked: Study | None = None) -> Text:
    """Methods and results of a fit; with what questions need of it, also what an impact does.

    Where its diagnostics failed, or no element describes the recordings, that is the first sentence of the
    results. Where the fit does not have something, such as repeats or a mass exponent, nothing is said of it.
    """
    text = Text(f"Methods and results: {run.record['dataset']}", nouns=run.nouns)
    text.add("Measurements", _measurements(run), _uncertainty(run), _left_out(run), _flags(run))
    text.add("Model", f"{model_words.likelihood_words(run)} {model_words.signal_words(run)}", _formulas(run))
    text.add(
        "Computation",
        worded("methods", "computation", run, _verdict(run), text.cite),
        level_outcomes.pictures_words(run),
    )
    verdict = run.record.get("verdict", {})
    sound = verdict.get("passed", True) and not verdict.get("warned") and not run.undescribed
    doubt = "" if sound else f"These results are in doubt: {_verdict(run)}"
    if run.undescribed:
        text.add("Results", doubt, "No K or C is stated: no element of this program describes these traces.")
        return text
    text.add(
        "Results",
        doubt,
        "Numbers are posterior medians, with equal-tailed 90 % intervals in brackets.",
        _levels(run),
        answers.averaged_sentence(run),
        _outcomes(run, asked) if asked else "",
        *level_outcomes.best_words(run),
        *(_comparison(run, contrast) for contrast in study_answers.first_contrasts(run)),
        _mass(run),
    )
    text.add("Questions", *(_answer(line) for line in question_lines(run.questions, len(run.questions))))
    repeatability = study_answers.reliability_words(run)
    cited = f"Coefficients are named as by McGraw and Wong {text.cite('icc')}." if repeatability else ""
    text.add("Repeatability", *repeatability, cited, study_answers.another_day(run))
    text.add("What the model can't tell", model_words.chain_words(run), *model_words.limits(run))
    text.table = _table(run).map(run.nouns)
    return text


def _measurements(run: FitRun) -> str:
    conditions = len(set(run.groups["constant_data"]["impact_trial"].to_numpy().tolist()))
    time = run.times()
    measured = (run.constant("mass_kg"), run.constant("velocity_m_s"), 1e-3 / (time[:, 1] - time[:, 0]))
    return worded("methods", "measurements", run, conditions, *map(_range, measured))


def _range(values: np.ndarray) -> str:
    """The least and the greatest number, or the one that all are."""
    low, high = (f"{value:.4g}" for value in (np.nanmin(values), np.nanmax(values)))
    return low if low == high else f"{low} to {high}"


def _uncertainty(run: FitRun) -> str:
    stated = run.record.get("uncertainty", {})
    parts = [
        f"{name} {factor * stated[key]:.3g} {unit or _unit_of_signal(run)}".rstrip()
        for key, (name, factor, unit) in _ERRORS.items()
        if stated.get(key)
    ]
    return worded("methods", "uncertainty", parts)


def _unit_of_signal(run: FitRun) -> str:
    return "m" if run.shown == "displacement" else "m/s²"


def _left_out(run: FitRun) -> str:
    reasons: dict[str, list[str]] = {}
    names: dict[str, list[str]] = {}
    for line in run.record.get("exclusions", []):
        reasons.setdefault(str(line["impact"]), []).append(str(line["reason"]))
    for impact, why in reasons.items():
        names.setdefault("; ".join(dict.fromkeys(why)), []).append(impact)
    left_out = run.record.get("left_out", [])
    count = len(reasons or left_out) if left_out else 0
    return worded("methods", "left_out", run, count, [f"{listed(who)} ({why})" for why, who in names.items()])


def _formulas(run: FitRun) -> str:
    formulas = [f"log {name} ~ {formula}" for name, formula in run.record["model"]["formula"].items()]
    not_used = [column["column"] for column in run.record["columns_not_used"]]
    return worded("methods", "formulas", run, formulas, not_used)


def _verdict(run: FitRun) -> str:
    """Whether the run can be trusted; what is said of single recordings stands with the measurements."""
    verdict = run.record.get("verdict", {})
    return f"{verdict.get('headline', '')} {_without_commands(verdict.get('doubts', ''))}".strip()


def _flags(run: FitRun) -> str:
    said = (one.words.removeprefix("NOTE: ") for one in findings(run.diagnostics) if one.passed)
    return " ".join(_without_commands(words[:1].upper() + words[1:]) for words in said if words)


def _without_commands(words: str) -> str:
    """Without sentences that advise a command of the program."""
    return " ".join(sentence for sentence in re.split(r"(?<=\.)\s+(?=[A-Z`])", words) if "`" not in sentence)


def _levels(run: FitRun) -> str:
    if len(run.impacts) == 1:
        own = {name: answers.only_impact(run, name) for name in QUANTITIES}
        parts = [f"{name} {one.value} {UNITS[name]} ({one.range})" for name, one in own.items()]
        return f"Of this impact: {listed(parts)}."
    who = answers.person_words(run) | {"whose": _typical(run)}
    return worded("methods", "estimates", levels(run), who, meaning(TOGETHER).level)


def _typical(run: FitRun) -> str:
    who = answers.person_words(run)["typical"]
    return who if run.people_count == 1 else f"a {who}"


def _outcomes(run: FitRun, asked: Study) -> str:
    """What the reference impact does on a typical person; empty where there is no law or no velocity."""
    values = asked.of_reference_impact([{}])
    if not values:
        return ""
    parts = []
    for name, draws in values.items():
        _, unit, factor = DECLARED[str(name)].shown
        shown = spread(factor * draws.to_numpy().ravel())
        parts.append(f"{outcome_name(str(name))} {shown.value} {unit} ({shown.range})")
    mass, velocity = (float(asked.motion([{}])[name][0]) for name in ("mass_kg", "velocity_m_s"))
    return said(
        "study.outcomes",
        who=_typical(run),
        impact=study_answers.impact_words(mass, velocity),
        outcomes=listed(parts),
    )


def _comparison(run: FitRun, contrast: Mapping[str, Any]) -> str:
    interaction = contrast["kind"] == INTERACTION
    return worded("methods", "comparison", contrast, interaction, study_answers.reference_words(run))


def _mass(run: FitRun) -> str:
    by = answers.answering(run)
    slopes = {q: beta for q in QUANTITIES if (beta := exponent(run, by[q])) is not None}
    if not slopes:
        return ""
    parts = [f"{q} changed as its power {beta.words}" for q, beta in slopes.items()]
    return f"With the mass of the impactor {listed(parts)}. {answers.mass_conclusion(run)}"


def _answer(line: Mapping[str, str]) -> str:
    further = f" ({line['beside']})" if line["beside"] else ""
    return f"{line['question']}: {line['answer']}{further}."


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
    by = part.set_index("quantity")
    return [_cell(Spread(*by.loc[q, [value, "low", "high"]]) if q in by.index else None) for q in QUANTITIES]


def _cell(spread: Spread | None) -> str:
    return "" if spread is None else spread.words
