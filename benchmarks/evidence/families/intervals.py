"""How exact the likelihoods are, and how often intervals hold the truth."""

from __future__ import annotations

import numpy as np
import pandas as pd
from scipy import stats

from bayestissue.studies.certificate.ranks import DRAWS, half_band, p_of_uniform
from evidence.texts import (
    Figure,
    Named,
    binomial_error,
    coverage,
    coverage_table,
    ends,
    percent,
    power_of_ten,
    sentence,
    wide,
    with_error,
)

# Where fewer impacts tell K, those that do are a selection.
_MOST = 0.5
# Of calibration: ranks are below this, and are counted in so many bins.
RANKS, BINS = DRAWS + 1, 20


def exactness(rows: pd.DataFrame) -> Named:
    difference = rows["largest_difference"]
    sizes = difference.map(power_of_ten) + " " + rows["relative_to"]
    yield "table", rows[["what", "oracle"]].assign(**{"largest difference": sizes})
    words = {"arma": "ARMA", "motion": "motion", "decelerations": "recorded decelerations"}
    of = {name: difference[rows["what"].str.contains(word)] for name, word in words.items()}
    yield "sentence", {name: power_of_ten(each.max()) for name, each in of.items()}


def coverage_fit(rows: pd.DataFrame) -> Named:
    lines = coverage(rows, ["each", "quantity"])
    names = lines["each"] + "_" + lines["quantity"] + "_" + lines["level"].astype(str)
    held = dict(zip(names, lines["cell"], strict=True))
    yield from held.items()
    yield "table", coverage_table(lines, "likelihood")
    own = lines[lines["quantity"].isin(["K", "C"])]
    own = own.assign(
        what=own["quantity"] + ", " + own["level"].astype(str) + " %",
        model="`" + own["each"] + ".toml`",
    )
    yield "short", wide(own, "model", "what").reset_index()
    yield "readme", held


def coverage_point(rows: pd.DataFrame) -> Named:
    shown, enough = rows[["unit", "impacts"]].rename(columns={"unit": "noise"}), []
    for q in "KC":
        held = rows[f"{q}_held"] / rows["unflagged"].replace(0, np.nan)
        shown[f"{q} held"] = held.map(percent)
        bounded = rows[f"{q}_held_with_bounds"] / rows[f"{q}_bounded"]
        shown[f"{q} held, bounds included"] = bounded.map(percent)
        enough.append(held[rows["unflagged"] / rows["impacts"] >= _MOST])
    yield "table", shown.assign(unflagged=(rows["unflagged"] / rows["impacts"]).map(percent))
    yield "range", ends(pd.concat(enough))


def drops(rows: pd.DataFrame) -> Named:
    share = {q: rows[f"{q}_held"] / rows["impacts"] for q in "KC"}
    shown = rows[["unit", "impacts"]].rename(columns={"unit": "drops"})
    for q in "KC":
        shown[f"{q} held"] = with_error(share[q], binomial_error(share[q], rows["impacts"]))
        shown[f"{q} off by"] = [percent(off, 2) for off in rows[f"{q}_bias"]]
    yield "table", shown.assign(**{"gravity flagged": rows["gravity_named"]})
    lines = rows.set_index("unit")
    wrong, right = lines.loc["declared as none"], lines.loc["none, declared as none"]
    yield (
        "sentence",
        ends(pd.concat(each[rows["unit"].str.startswith("declared, ")] for each in share.values()))
        | {"bias": 100 * wrong["K_bias"], "named": wrong["gravity_named"], "of": wrong["impacts"]}
        | {"alarms": right["gravity_named"], "of_right": right["impacts"]},
    )


def many_impacts(rows: pd.DataFrame) -> Named:
    row = rows.iloc[0]
    held = {q: 100 * row[f"{q}_held_90"] / row["impacts"] for q in "KC"}
    yield "sentence", row.to_dict() | held


def spread(u: np.ndarray) -> tuple[float, float]:
    """Standard deviation of ranks [data set, quantity] over a uniform's, and its error between data sets."""
    square = (12 * (u - 0.5) ** 2).mean(1)
    return float(np.sqrt(square.mean())), float(square.std(ddof=1) / np.sqrt(len(square)) / 2)


def calibration(rows: pd.DataFrame) -> Named:
    cells, said, every = {}, [], []
    for each, part in rows.groupby("each", sort=False):
        ranks = part.drop(columns=["unit", "each", "passed"]).dropna(axis=1).astype(int)
        p = {}
        for name in ranks:
            bins = np.bincount(ranks[name] * BINS // RANKS, minlength=BINS)
            p[name] = float(stats.chisquare(bins).pvalue), p_of_uniform(ranks[name].to_numpy())
        cells[each] = pd.Series({name: f"{a:.3f} / {b:.3f}" for name, (a, b) in p.items()})
        values = [value for pair in p.values() for value in pair]
        every += values
        times, error = spread((ranks.to_numpy() + 0.5) / RANKS)
        of_one = {"each": each, "sets": len(ranks), "refused": (~part["passed"].astype(bool)).sum()}
        of_one |= {"tests": len(values), "least": min(values), "wide": times, "error": error}
        of_one["band"] = 100 * half_band(len(ranks))
        said.append(f"- {sentence('calibration', 'of_one', of_one)}.")
    yield "table", pd.DataFrame(cells).rename_axis("quantity").reset_index()
    yield "list", Figure("\n".join(said), block=True)
    small = sum(value < 0.01 for value in every)
    yield "sentence", {"small": small, "tests": len(every), "expected": 0.01 * len(every)}


def posteriors(rows: pd.DataFrame) -> Named:
    z = rows["difference"] / rows["mcse"]
    rows = rows.assign(square=z**2, apart=z.abs(), off=(rows["difference"] / rows["sd"]).abs())
    groups = rows.groupby(["unit", "statistic"], sort=False)
    shown = pd.DataFrame(
        {
            "quantities": groups.size(),
            "apart, root mean square": np.sqrt(groups["square"].mean()).map("{:.2f}".format),
            "apart, at most": groups["apart"].max().map("{:.1f}".format),
            "off at most, of the sd": groups["off"].max().map(percent),
        }
    )
    yield "table", shown.reset_index().rename(columns={"unit": "case"})
    said = {"number": len(z) // rows["statistic"].nunique(), "apart": np.sqrt((z**2).mean())}
    said |= {"most": z.abs().max(), "off": 100 * rows["off"].max()}
    yield "sentence", said
    yield "short", said


def recorder(rows: pd.DataFrame) -> Named:
    counts = ["impacts", "K held", "C held", "suspected"]
    shown = rows.drop(columns=["unit", "each"]).astype(dict.fromkeys(counts, "Int64"))
    yield "table", shown.assign(declared=rows["declared"].map({True: "yes", False: "no"}))
    analog = rows["filter"].str.endswith(", taken as analog")
    filtered = rows["K held"].notna() & (rows["filter"] != "none") & ~analog

    def held(which: pd.Series, of: str = "KC") -> str:
        shares = pd.concat(rows[f"{q} held"][which] / rows["impacts"][which] for q in of)
        return f"{100 * shares.min():.0f} to {100 * shares.max():.0f} %"

    sound = rows[rows["K held"].isna()]
    yield (
        "sentence",
        {"declared": held(filtered & rows["declared"]), "analog": held(analog)}
        | {"left_out": held(filtered & ~rows["declared"], "C")}
        | {"suspected": sound["suspected"].sum(), "sound": sound["impacts"].sum()},
    )


def recordings(rows: pd.DataFrame) -> Named:
    columns = {"unit": "recordings", "recorded": "recorded", "impacts": "impacts", "left_out": "left out"}
    p = rows["below"].astype(str) + " of " + rows["tested"].astype(str)
    shown = rows[[*columns, "flagged"]].rename(columns=columns)
    yield "table", shown.assign(**{"p below 0.01": p.where(rows["tested"] > 0, "")})
