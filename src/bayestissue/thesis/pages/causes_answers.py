"""A finished `causes` run, and why K grows with the mass in words that follow from its tables."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

import pandas as pd

from bayestissue.dataset.chain import STANDARD_GRAVITY
from bayestissue.errors import InputError
from bayestissue.report.wording import likelihood_words, listed, number, probability, significant
from bayestissue.results import read_tables
from bayestissue.results.tables import wrong_in
from bayestissue.thesis.causes.design import LEVEL, WORDS
from bayestissue.thesis.causes.specification import MECHANISMS

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
        sentences.append(
            f"No change of the tissue does it, not even the best of them, “{best['title']}” "
            f"(p {_relation(best)}){missed}."
        )
    return sentences


def _question(run: CausesRun) -> str:
    exponents = [
        f"{quantity} to the power {number(run.value(f'mass_exponent_{quantity}'), 2)}"
        for quantity in ("K", "C")
        if f"mass_exponent_{quantity}" in run.statistics
    ]
    exponents_words = listed(exponents).replace("K to", "K goes with the mass to", 1)
    return f"In {run.record['subject']['title']} {exponents_words}."


def _method_or_tissue(run: CausesRun, best: Row) -> list[str]:
    """Method or tissue, and the likeliest cause."""
    if fixed := _fixed_tissue(run, best):
        return [
            f"That needs no cause: “{fixed['title']}” makes such numbers (p {_relation(fixed)}, posterior "
            f"probability {_probability(fixed)})."
        ]
    how = f"“{best['title']}” ({_probability(best)}): {MECHANISMS[run.mechanism(best['cause'])]['how']}."
    share = float(run.causes.loc[run.in_method, "probability"].sum())
    places = ["how K was found", "the tissue"]
    if share < 0.5:
        share, places = 1 - share, places[::-1]
    return [
        f"If one of the {len(run.causes)} proposed causes made that, it {likelihood_words(share)} lies in "
        f"{' and not in '.join(places)} (posterior probability {probability(share)}).",
        f"The likeliest is {how}",
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
        return f"But none of them, acting alone, makes all {count} numbers compared (every p below 0.01)."
    named = listed([f"“{row['title']}” (p {_relation(row)})" for row in left])
    ending = "; every other misses" if len(left) < len(run.causes) else ""
    if any(row["verdict"] == "possible" for row in left):
        misses = f"{ending} some" if ending else ""
        return f"Acting alone {named} can have made all {count} numbers compared{misses}."
    return (
        f"Acting alone even {named} would rarely make all {count} numbers compared at once"
        f"{', and every other more rarely than once in a hundred times' if ending else ''}."
    )


def _relation(row: Row) -> str:
    words = p_words(row)
    return words if words.startswith("below") else f"= {words}"


def _probability(row: Row) -> str:
    return f"{probability(row['probability'])} ± {number(row['probability_error'], 2)}"


def ruled_out(run: CausesRun) -> list[str]:
    """What the numbers exclude, cause by cause."""
    refuted = run.causes[run.causes["verdict"] == "refuted"].to_dict("records")
    return [
        f"{row['title']}: misses the {failing(row)}"
        if row["fails"]
        else f"{row['title']}: can make each number by itself, not all together"
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
    named = "; ".join(f"“{a}” and “{b}”" for a, b in confused_pairs(run))
    words = "These look alike, and no such table of estimates can tell one from the other"
    return f"{words}: {named}." if named else ""


def _hindsight(run: CausesRun) -> str:
    """What becomes of the answer without the likeliest cause, if that was proposed in view of the data."""
    best, *others = run.causes.sort_values("probability", ascending=False).to_dict("records")
    if not others or not run.record["model"]["causes"][best["cause"]].get("after_the_fact"):
        return ""
    left = sum(float(row["probability"]) for row in others)
    share = f", with {probability(others[0]['probability'] / left)} of what is left" if left > 0 else ""
    return (
        f"How probable “{best['title']}” was beforehand: it was proposed, and its ranges set, with these "
        f"numbers in view. Without it the likeliest is “{others[0]['title']}” "
        f"(p {_relation(others[0])}){share}."
    )


def cannot_tell(run: CausesRun) -> list[str]:
    """What the numbers leave open."""
    words = [hindsight] if (hindsight := _hindsight(run)) else []
    words += [
        "Whether several causes acted together, or one that is not in the list: probabilities compare the "
        "listed ones, p-values judge each by itself."
    ]
    if all(row["verdict"] != "possible" for row in standing(run)):
        words.append(
            "How far to trust the probabilities: what was observed lies at the edge of every cause’s "
            "campaigns, where few decide."
        )
    if LEVEL not in run.compared:
        length = STANDARD_GRAVITY / run.value(LEVEL)
        words.append(
            "What the size of K means: no unit was printed. Were it N/m, K/M would also be that of a pendulum"
            f" of {number(100 * length, 0)} cm swinging freely; the pendulum’s length was not printed either."
        )
        words.append(
            "Recordings would settle it: they show where each window ended and how its time was counted."
        )
    return words
