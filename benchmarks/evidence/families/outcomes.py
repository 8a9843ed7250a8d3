"""What impacts come to: whether intervals hold it, and what probabilities of being best are worth."""

from __future__ import annotations

import itertools

import numpy as np
import pandas as pd

from evidence.texts import Figure, Named, binomial_error, family, wide, with_error

# Of probabilities of being best, in which levels are counted together.
BINS = (0.0, 0.05, 0.2, 0.4, 0.6, 0.8, 0.95, 1.0)
CHOSEN = "best "
LEVEL = 0.9
# Of the diagram, in pixels: its side, and what stands left and below.
_SIDE, _MARGIN = 240, 46


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
    """Of levels of like probability of being best the mean one, and the share that are.

    ``se`` is the standard error between studies of the share less the probability: probabilities of a study
    add up to 1.
    """
    stems = found.filter(regex=rf"^{CHOSEN}.*\|p$").columns.str.removesuffix("|p")
    p, true = (found[[f"{stem}|{what}" for stem in stems]].to_numpy(float) for what in ("p", "true"))
    lines = []
    for low, high in itertools.pairwise(BINS):
        inside = (p >= low) & ((p < high) | (high == BINS[-1]))
        count, off = inside.sum(), np.where(inside, true - p, 0.0).sum(axis=1)
        if count:
            se = float(off.std(ddof=1) * np.sqrt(len(off)) / count)
            means = {"probability": p[inside].mean(), "share": true[inside].mean(), "se": se}
            lines.append({"from": low, "to": high, "levels": count, **means})
    return pd.DataFrame(lines)


def diagram(lines: pd.DataFrame) -> str:
    """The share that is best over the probability of it, with a standard error either way, as a picture."""

    def x(p: float) -> str:
        return f"{_MARGIN + _SIDE * p:.1f}"

    def y(share: float) -> str:
        return f"{10 + _SIDE * (1 - min(max(share, 0.0), 1.0)):.1f}"

    drawn = [
        f'<line x1="{x(0)}" y1="{y(0)}" x2="{x(1)}" y2="{y(1)}" stroke="#6b7280" stroke-dasharray="4 3"/>',
        f'<path d="M{x(0)} {y(1)}V{y(0)}H{x(1)}" fill="none" stroke="currentColor"/>',
    ]
    for tick in (0.0, 0.5, 1.0):
        drawn += [
            f'<text x="{x(tick)}" y="{10 + _SIDE + 16}" text-anchor="middle">{tick:.0%}</text>',
            f'<text x="{_MARGIN - 5}" y="{y(tick)}" dy="4" text-anchor="end">{tick:.0%}</text>',
        ]
    for line in lines.itertuples():
        at, low, high = x(line.probability), y(line.share - line.se), y(line.share + line.se)
        drawn += [
            f'<path d="M{at} {low}V{high}" stroke="#1f5f99"/>',
            f'<circle cx="{at}" cy="{y(line.share)}" r="4" fill="#1f5f99"/>',
        ]
    middle = _MARGIN + _SIDE / 2
    drawn.append(
        f'<text x="{middle}" y="{10 + _SIDE + 34}" text-anchor="middle">probability of being best</text>'
    )
    label = 'role="img" aria-label="share that is best over its probability"'
    size = f'width="{_MARGIN + _SIDE + 20}" height="{_SIDE + 52}" font-size="12" fill="currentColor"'
    caption = "The share of levels that are best over the probability of it, with its standard error."
    inner = "\n".join([f"<svg {label} {size}>", *drawn, "</svg>", f"<figcaption>{caption}</figcaption>"])
    return f"<figure>\n{inner}\n</figure>"


@family
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
    claims = pd.DataFrame(
        {
            "probability of being best": [f"{one['from']:g} to {one['to']:g}" for _, one in bins.iterrows()],
            "levels": bins["levels"],
            "mean probability": bins["probability"].map("{:.1%}".format).str.replace("%", " %"),
            "best": with_error(bins["share"], bins["se"]),
        }
    )
    yield "best", claims
