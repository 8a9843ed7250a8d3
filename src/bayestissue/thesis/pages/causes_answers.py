"""A finished `causes` run, and why K grows with the mass in words that follow from its tables."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

import pandas as pd

from bayestissue.dataset.chain import STANDARD_GRAVITY
from bayestissue.declarations import sentences
from bayestissue.errors import InputError
from bayestissue.report.wording import likelihood_words, listed, number, probability, significant
from bayestissue.results import read_tables
from bayestissue.results.tables import wrong_in
from bayestissue.thesis.causes.design import LEVEL, WORDS
from bayestissue.thesis.causes.specification import MECHANISMS

said = sentences(__package__)
_AGAIN = "Make the run anew with `bayestissue causes`."
_TABLES = ("causes", "predictive", "observed", "confusion", "causes/reliability")
# What lies in how K was found, and not in what was hit.
_OF_METHOD = [name for name, entry in MECHANISMS.items() if entry["lies_in"] == "method"]


@dataclass(frozen=True)
class CausesRun:
    """What the files of a `causes` run say; tables keep the columns of their files."""

    record: dict[str, Any]
    causes: pd.DataFrame
    predictive: pd.DataFrame
    observed: pd.DataFrame
    confusion: pd.DataFrame
    reliability: pd.DataFrame

    @property
    def statistics(self) -> list[str]:
        """The statistics that are drawn: those of the comparison, and the size of K/M."""
        return [name for name in self.observed["statistic"] if name in WORDS and name != "without_estimate"]

    @property
    def compared(self) -> list[str]:
        """The statistics of the joint comparison."""
        return list(self.observed.loc[self.observed["compared"] == "yes", "statistic"])

    def value(self, statistic: str) -> float:
        """The observed value of a statistic."""
        values = dict(zip(self.observed["statistic"], self.observed["value"], strict=True))
        return float(values[statistic])

    def mechanism(self, cause: str) -> str:
        """What acts in a cause."""
        return str(self.record["model"]["causes"][cause]["mechanism"])

    @property
    def in_method(self) -> pd.Series:
        """For each cause whether it lies in the method."""
        return self.causes["cause"].map(self.mechanism).isin(_OF_METHOD)


def read_causes_run(folder: Path, record: dict[str, Any]) -> CausesRun:
    """Read every file of the run in ``folder``, whose ``run.json`` holds ``record``.

    Raises:
        InputError: a file lacks or isn't what a run writes; all such files are named at once.
    """
    lacking = [key for key in ("model", "subject") if not isinstance(record.get(key), dict)]
    if lacking or "causes" not in record["model"]:
        column = (*lacking, "model")[0]
        raise InputError(wrong_in(folder / "run.json", "what every such run writes", _AGAIN, column=column))
    return CausesRun(record=record, **read_tables(folder, _TABLES))


_CONFUSED = 0.2
Row = dict[Any, Any]


def p_words(row: Row) -> str:
    """A joint p-value, or "below" the next above the smallest that so many campaigns can give."""
    p = float(row["p_joint"])
    if p <= float(row["smallest_p"]) * 1.001:
        return f"below {significant(2 * p, 1)}"
    return number(p, 3 if p < 0.1 else 2)


def failing(row: Row, most: int = 3) -> str:
    """The statistics that a cause misses, worst first, in words."""
    names = [name for name in str(row["fails"]).split(", ") if name]
    words = [WORDS[name] for name in names[:most]]
    more = len(names) - len(words)
    return listed([*words, f"{more} more"] if more > 0 else words)


def standing(run: CausesRun) -> list[Row]:
    """Causes that are not ruled out, the most probable first."""
    left = run.causes[run.causes["verdict"] != "refuted"]
    return left.sort_values("probability", ascending=False).to_dict("records")


def answer(run: CausesRun) -> list[str]:
    """The whole answer, a sentence each: what was found, where its cause lies, and how sure that is."""
    rows = run.causes.sort_values("probability", ascending=False).to_dict("records")
    sentences = [_question(run), *_method_or_tissue(run, rows[0]), _single_causes(run)]
    tissue = run.causes[~run.in_method]
    if not _fixed_tissue(run, rows[0]) and len(tissue) and (tissue["verdict"] == "refuted").all():
        best = max(tissue.to_dict("records"), key=lambda row: row["probability"])
        missed = f": it misses the {failing(best)}" if best["fails"] else ""
        sentences.append(_said("not_of_tissue", best, missed=missed))
    return sentences


def _said(name: str, row: Row, **values: object) -> str:
    """A sentence on a cause, with its title, p-value and probability."""
    of_cause = {"title": row["title"], "p": _relation(row), "probability": _probability(row)}
    return said(f"causes.{name}", **of_cause, **values)


def _question(run: CausesRun) -> str:
    exponents = [
        f"{quantity} to the power {number(run.value(f'mass_exponent_{quantity}'), 2)}"
        for quantity in ("K", "C")
        if f"mass_exponent_{quantity}" in run.statistics
    ]
    exponents_words = listed(exponents).replace("K to", "K goes with the mass to", 1)
    return said("causes.exponents", subject=run.record["subject"]["title"], exponents=exponents_words)


def _method_or_tissue(run: CausesRun, best: Row) -> list[str]:
    """Method or tissue, and the likeliest cause."""
    if fixed := _fixed_tissue(run, best):
        return [_said("no_cause", fixed)]
    share = float(run.causes.loc[run.in_method, "probability"].sum())
    places = ["how K was found", "the tissue"]
    if share < 0.5:
        share, places = 1 - share, places[::-1]
    where = {"likely": likelihood_words(share), "places": " and not in ".join(places)}
    return [
        said("causes.lies_in", count=len(run.causes), probability=probability(share), **where),
        _said("likeliest", best, how=MECHANISMS[run.mechanism(best["cause"])]["how"]),
    ]


def _fixed_tissue(run: CausesRun, best: Row) -> Row | None:
    """The cause that is none, if it is not ruled out and the likeliest or not to be told from that."""
    for row in run.causes.to_dict("records"):
        if run.mechanism(row["cause"]) == "none" and row["verdict"] != "refuted":
            confused_with_best = {row["title"], best["title"]} in [set(pair) for pair in confused_pairs(run)]
            return row if row["cause"] == best["cause"] or confused_with_best else None
    return None


def _single_causes(run: CausesRun) -> str:
    left, count = standing(run), len(run.compared)
    if not left:
        return said("causes.no_single", count=count)
    named = listed([f"“{row['title']}” (p {_relation(row)})" for row in left])
    possible = any(row["verdict"] == "possible" for row in left)
    can, others = ("single", "others_miss") if possible else ("single_rarely", "others_more_rarely")
    of_others = said(f"causes.{others}") if len(left) < len(run.causes) else ""
    return said(f"causes.{can}", named=named, count=count, others=of_others)


def _relation(row: Row) -> str:
    words = p_words(row)
    return words if words.startswith("below") else f"= {words}"


def _probability(row: Row) -> str:
    return f"{probability(row['probability'])} ± {number(row['probability_error'], 2)}"


def ruled_out(run: CausesRun) -> list[str]:
    """What the numbers exclude, cause by cause."""
    refuted = run.causes[run.causes["verdict"] == "refuted"].to_dict("records")
    return [
        _said("misses" if row["fails"] else "not_together", row, statistics=failing(row))
        for row in sorted(refuted, key=lambda row: -row["probability"])
    ]


def confused_pairs(run: CausesRun) -> list[tuple[str, str]]:
    """Pairs of causes that these statistics confuse: each gives the other a fifth of its probability."""
    table: pd.DataFrame = run.confusion.set_index("truth")
    titles = run.causes.set_index("cause")["title"]
    return [
        (str(titles[a]), str(titles[b]))
        for a, b in combinations(table.index, 2)
        if min(float(table.loc[a, b]), float(table.loc[b, a])) > _CONFUSED
    ]


def confusion_words(run: CausesRun) -> str:
    """Which causes can't be told from each other; empty if all can."""
    pairs = "; ".join(f"“{a}” and “{b}”" for a, b in confused_pairs(run))
    return said("causes.alike", pairs=pairs) if pairs else ""


def _hindsight(run: CausesRun) -> str:
    """What becomes of the answer without the likeliest cause, if that was proposed in view of the data."""
    best, *others = run.causes.sort_values("probability", ascending=False).to_dict("records")
    if not others or not run.record["model"]["causes"][best["cause"]].get("after_the_fact"):
        return ""
    left = sum(float(row["probability"]) for row in others)
    share = f", with {probability(others[0]['probability'] / left)} of what is left" if left > 0 else ""
    return _said("hindsight", others[0], best=best["title"], share=share)


def cannot_tell(run: CausesRun) -> list[str]:
    """What the numbers leave open."""
    words = [hindsight] if (hindsight := _hindsight(run)) else []
    words.append(said("causes.together"))
    if all(row["verdict"] != "possible" for row in standing(run)):
        words.append(said("causes.edge"))
    if LEVEL not in run.compared:
        length = STANDARD_GRAVITY / run.value(LEVEL)
        words += [said("causes.size", length_cm=number(100 * length, 0)), said("causes.recordings")]
    return words
