"""What impacts come to: whether intervals hold it, and what probabilities of being best are worth."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from evidence.texts import Figure, Named, binomial_error, by_probability, of_bins, wide, with_error

CHOSEN = "best "
LEVEL = 0.9
# Of the diagram of diagram.html, in pixels: its side, and where it begins.
_SIDE, _LEFT, _TOP = 240, 46, 10


def shares(found: pd.DataFrame) -> pd.DataFrame:
    """Of each kind of interval and outcome the shares that hold the truth, and that lie below and above it.

    ``se`` is the standard error between studies, whose intervals are not independent. A row whose outcome is
    "all" is of all outcomes together.
    """
    lines = []
    columns = found.filter(like="|below").columns.str.removesuffix("|below")
    kinds = {of: [one for one in columns if one.startswith(f"{of}|")] for of, _ in columns.str.split("|")}
    for of, stems in kinds.items():
        for outcome, those in {"all": stems, **{one.split("|")[1]: [one] for one in stems}}.items():
            below, above = (
                found[[f"{one}|{side}" for one in those]].mean(axis=1) for side in ("below", "above")
            )
            held = 1 - below - above
            line = {"of": of, "outcome": outcome, "studies": held.count(), "share": held.mean()}
            lines.append(line | {"se": held.sem(), "below": below.mean(), "above": above.mean()})
    return pd.DataFrame(lines)


def reliability(found: pd.DataFrame) -> pd.DataFrame:
    """Of levels of like probability of being best the mean one, and the share that are."""
    stems = found.filter(regex=rf"^{CHOSEN}.*\|p$").columns.str.removesuffix("|p")
    return by_probability(
        *(found[[f"{stem}|{what}" for stem in stems]].to_numpy(float) for what in ("p", "true"))
    )


def diagram(lines: pd.DataFrame) -> str:
    """The share that is best over the probability of it, with a standard error either way, as a picture."""
    points = []
    for x, share, se in lines[["probability", "share", "se"]].to_numpy():
        at = f"{_LEFT + _SIDE * x:.1f}"
        low, y, high = (
            f"{_TOP + _SIDE * (1 - min(max(value, 0.0), 1.0)):.1f}"
            for value in (share - se, share, share + se)
        )
        points += [f'<path d="M{at} {low}V{high}" stroke="#1f5f99"/>']
        points += [f'<circle cx="{at}" cy="{y}" r="4" fill="#1f5f99"/>']
    picture = Path(__file__).with_name("diagram.html").read_text(encoding="utf-8")
    return picture.rstrip("\n").format(points="\n".join(points))


def outcome_coverage(rows: pd.DataFrame) -> Named:
    parts = [shares(part).assign(element=element) for element, part in rows.groupby("each", sort=False)]
    lines = pd.concat([*parts, shares(rows).assign(element="all")])
    lines = lines.assign(cell=with_error(lines["share"], lines["se"]))
    yield "table", wide(lines.query("outcome == 'all'"), "element", "of").reset_index()
    yield "outcomes", wide(lines.query("element == 'all'"), "outcome", "of").reset_index()
    own = lines.query("outcome != 'all' and element != 'all'")
    # Of no misses the studies tell no error: that of their sixteen impacts is the least.
    far = (own["share"] - LEVEL).abs() / own["se"].clip(lower=binomial_error(LEVEL, 16 * own["studies"]))
    *first, last = lines.query("outcome == 'all' and element == 'all'")["share"].map("{:.0%}".format)
    held = f"{', '.join(first)} and {last}".replace("%", " %")
    said = {"studies": len(rows), "held": held, "shares": len(own), "within": (far <= 2).sum()}
    yield "sentence", said
    yield "short", said
    bins = reliability(rows)
    yield "diagram", Figure(diagram(bins), block=True)
    yield "best", of_bins(bins, "probability of being best", "levels", "best")
