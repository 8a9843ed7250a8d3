"""Why K grows with the mass, in words that follow from the tables of a run."""

from __future__ import annotations

import pandas as pd

from bayestissue.causes.statistics import WORDS
from bayestissue.report.causes.run import CausesRun
from bayestissue.report.wording import listed, number, probability

_ALIKE = 0.2


def p_words(row: dict) -> str:
    """A joint p-value, or "below" the smallest that so many campaigns can give."""
    p = float(row["p_joint"])
    if p <= float(row["smallest_p"]) * 1.001:
        return f"below {number(2 * p, 3)}" if p < 0.1 else number(p, 2)
    return number(p, 3 if p < 0.1 else 2)


def failing(row: dict, most: int = 3) -> str:
    """The statistics that a cause misses, worst first, in words."""
    names = [name for name in str(row["fails"]).split(", ") if name]
    words = [WORDS[name] for name in names[:most]]
    more = len(names) - len(words)
    return listed([*words, f"{more} more"] if more > 0 else words)


def standing(run: CausesRun) -> pd.DataFrame:
    """Causes that are not refuted, the most probable first."""
    left = run.causes[run.causes["verdict"] != "refuted"]
    return left.sort_values("probability", ascending=False)


def question(run: CausesRun) -> str:
    """What is to be explained."""
    parts = []
    for quantity in ("K", "C"):
        name = f"mass_exponent_{quantity}"
        if name in run.statistics:
            parts.append(f"{quantity} grows as M to the power {number(run.value(name), 2)}")
    return (
        f"In {run.about['subject']['title']} {listed(parts)}." if parts else "The masses do not differ here."
    )


def answer(run: CausesRun) -> str:
    """The whole answer in one paragraph."""
    sentences = [question(run)]
    left = standing(run).to_dict("records")
    method = run.of_method
    tissue = run.causes[~method].sort_values(["p_joint", "probability"], ascending=False).to_dict("records")
    count = len(run.compared)
    if left:
        words = [f"“{row['title']}” (p = {p_words(row)})" for row in left]
        sentences.append(
            f"Of {len(run.causes)} proposed causes, each acting alone, {len(left)} can't be ruled out as the maker of all "
            f"{count} numbers compared: {listed(words)}."
        )
    else:
        sentences.append(
            f"None of the {len(run.causes)} proposed causes, acting alone, makes all {count} numbers compared."
        )
    best = run.causes.sort_values("probability", ascending=False).to_dict("records")[0]
    share = float(run.causes.loc[method, "probability"].sum())
    sentences.append(
        f"If one of them it was, the likeliest is “{best['title']}” (posterior probability "
        f"{probability(best['probability'])} ± {number(best['probability_error'], 2)}, all equally probable before), and "
        f"causes that lie in the method rather than in the tissue have {probability(share)} together."
    )
    if tissue and tissue[0]["verdict"] == "refuted":
        row = max(tissue, key=lambda row: row["probability"])
        sentences.append(
            "No change of the tissue does it alone: the best of those, "
            f"“{row['title']}”, misses the {failing(row)}."
        )
    return " ".join(sentences)


def can_tell(run: CausesRun) -> list[str]:
    """What the numbers exclude, cause by cause."""
    refuted = run.causes[run.causes["verdict"] == "refuted"].to_dict("records")
    return [f"“{row['title']}” misses the {failing(row)}." for row in refuted if row["fails"]] + [
        f"“{row['title']}” can make each number by itself, and not all of them together."
        for row in refuted
        if not row["fails"]
    ]


def alike(run: CausesRun) -> list[tuple[str, str]]:
    """Pairs of causes that these statistics confuse: each gives the other a fifth of its probability."""
    table = run.confusion.set_index("truth")
    titles = run.causes.set_index("cause")["title"]
    names = list(table.index)
    return [
        (str(titles[a]), str(titles[b]))
        for i, a in enumerate(names)
        for b in names[i + 1 :]
        if min(table.loc[a, b], table.loc[b, a]) > _ALIKE
    ]


def cannot_tell(run: CausesRun) -> list[str]:
    """What the numbers leave open."""
    words = [
        "Whether several causes acted together, or one that is not in the list: the probabilities compare the "
        "listed ones only, and the p-values judge each by itself."
    ]
    words += [f"“{a}” from “{b}”: their campaigns look alike." for a, b in alike(run)]
    if "K_over_M_mean" not in run.compared and "K_over_M_mean" in run.statistics:
        words.append(
            "What the size of K means: no unit was printed, so only numbers that no choice of unit changes are "
            "compared."
        )
    return words
