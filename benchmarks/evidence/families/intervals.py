"""How exact the likelihoods are, and how often intervals hold the truth."""

from __future__ import annotations

import numpy as np
import pandas as pd
from scipy import stats

from bayestissue.studies.certificate.ranks import DRAWS, half_band, p_of_uniform
from evidence.registry import of_family
from evidence.texts import (
    Figure,
    Named,
    binomial_error,
    block,
    coverage,
    coverage_table,
    each_held,
    family,
    names,
    percent,
    power_of_ten,
    raw,
    table,
    trusted,
    with_error,
)

_MOST = 0.5
# Of calibration: ranks are below this, and are counted in so many bins.
RANKS, BINS = DRAWS + 1, 20


@family
def exactness() -> Named:
    lines = raw("exactness").drop(columns="each")
    difference = lines["largest_difference"]
    shown = lines.assign(largest_difference=difference.map(power_of_ten) + " " + lines["relative_to"])
    titles = {"largest_difference": "largest difference"}
    yield "table", block(table(shown.drop(columns="relative_to").rename(columns=titles)), "exactness")
    arma, motion, decelerations = (
        power_of_ten(difference[lines["what"].str.contains(words, regex=False)].max())
        for words in ("ARMA", "motion", "recorded decelerations")
    )
    text = (
        f"the largest differences from the oracles are {arma} of the log density of ARMA(2,1), {motion} of "
        f"the peak of a motion, and {decelerations} nats of a deceleration's"
    )
    yield "sentence", Figure(text, names("exactness"))


def coverage_of_fits() -> pd.DataFrame:
    """A line a likelihood, quantity and level."""
    return coverage(raw("coverage_fit"), ["each", "quantity"])


@family
def coverage_fit() -> Named:
    lines = coverage_of_fits()
    yield from each_held(lines, "coverage_fit")
    shown = coverage_table(lines, ["each", "quantity"]).rename(columns={"each": "likelihood"})
    yield "table", block(table(shown), "coverage_fit")
    own = lines[lines["quantity"].isin(["K", "C"])]
    own = own.assign(
        what=own["quantity"] + ", " + own["level"].astype(str) + " %",
        cell=with_error(own["share"], own["se"]),
    )
    short = own.pivot_table("cell", "each", "what", "first", sort=False)
    short = short.rename("`{}.toml`".format).rename_axis("model").rename_axis(columns=None)
    yield "short", block(table(short.reset_index()), "coverage_fit")
    for kind, part in own[own["level"] == 90].groupby("each", sort=False):
        held = " and ".join(f"{line.quantity} in {line.cell}" for line in part.itertuples())
        text = (
            f"of {part['impacts'].max()} impacts in {part['campaigns'].max()} simulated campaigns, "
            f"90 % intervals by `{kind}.toml` held {held}"
        )
        yield f"{kind}_sentence", Figure(text, (f"coverage_fit-{kind}",))
    K = own[(own["level"] == 90) & (own["each"] == "impact") & (own["quantity"] == "K")].iloc[0]
    text = f"90 % intervals of K held the truth in {K['cell']} of simulated impacts."
    yield "readme", Figure(text, ("coverage_fit-impact",))


@family
def coverage_point() -> Named:
    lines = raw("coverage_point")
    impacts = lines["impacts"]
    shown = pd.DataFrame({"noise": lines["unit"], "impacts": impacts})
    unflagged, most = lines["unflagged"], []
    for q in "KC":
        held = lines[f"{q}_held"] / unflagged.replace(0, np.nan)
        shown[f"{q} held"] = held.map(percent).where(held.notna())
        with_bounds = lines[f"{q}_held_with_bounds"] / lines[f"{q}_bounded"]
        shown[f"{q} held, bounds included"] = with_bounds.map(percent)
        # Where few impacts tell K those that do are a selection.
        most.append(held[unflagged / impacts >= _MOST])
    shown["unflagged"] = (unflagged / impacts).map(percent)
    yield "table", block(table(shown), "coverage_point")
    held = pd.concat(most)
    yield "range", Figure(f"{100 * held.min():.0f} to {100 * held.max():.0f} %", names("coverage_point"))


@family
def drops() -> Named:
    lines = raw("drops").set_index("unit")
    impacts, share = lines["impacts"], {q: lines[f"{q}_held"] / lines["impacts"] for q in "KC"}
    shown = pd.DataFrame({"drops": lines.index, "impacts": impacts.to_numpy()})
    for q in "KC":
        shown[f"{q} held"] = with_error(share[q], binomial_error(share[q], impacts))
        shown[f"{q} off by"] = [percent(off, 2) for off in lines[f"{q}_bias"]]
    shown["gravity flagged"] = lines["gravity_named"].to_numpy()
    yield "table", block(table(shown), "drops")
    declared = lines.index.str.startswith("declared, ")
    held = 100 * pd.concat([share[q][declared] for q in "KC"])
    wrong, right = lines.loc["declared as none"], lines.loc["none, declared as none"]
    named, alarms = (f"{each['gravity_named']:.0f} of {each['impacts']:.0f}" for each in (wrong, right))
    text = (
        f"90 % intervals of vertical drops held K and C in {held.min():.0f} to {held.max():.0f} %; of drops "
        f"declared as none K came out {percent(wrong['K_bias'], 0)} too large, and {named} were flagged, as "
        f"were {alarms} impacts without gravity"
    )
    yield "sentence", Figure(text, names("drops"))


@family
def many_impacts() -> Named:
    row = raw("many_impacts").iloc[0]
    text = (
        f"{row['impacts']:.0f} impacts took {row['minutes']:.1f} minutes ({row['processor_minutes']:.1f} of "
        f"processor time) and {row['memory_GiB']:.1f} GiB; 90 % intervals held K of "
        f"{percent(row['K_held_90'] / row['impacts'])} and C of "
        f"{percent(row['C_held_90'] / row['impacts'])} of them"
    )
    yield "sentence", Figure(text, names("many_impacts"))


def spread(u: np.ndarray) -> tuple[float, float]:
    """Standard deviation of ranks [data set, quantity] over a uniform's, and its error between data sets."""
    square = (12 * (u - 0.5) ** 2).mean(1)
    return float(np.sqrt(square.mean())), float(square.std(ddof=1) / np.sqrt(len(square)) / 2)


@family
def calibration() -> Named:
    cells, said, every = {}, [], []
    for piece in of_family("calibration"):
        rows = piece.rows()
        if rows.empty:
            continue
        ranks = rows.drop(columns=["unit", "pareto_k", "passed"], errors="ignore").astype(int)
        p = {}
        for name in ranks:
            bins = np.bincount(ranks[name] * BINS // RANKS, minlength=BINS)
            p[name] = float(stats.chisquare(bins).pvalue), p_of_uniform(ranks[name].to_numpy())
        cells[piece.each] = pd.Series({name: f"{a:.3f} / {b:.3f}" for name, (a, b) in p.items()})
        every += [each for pair in p.values() for each in pair]
        wide, error = spread((ranks.to_numpy() + 0.5) / RANKS)
        text = (
            f"`{piece.each}`: {len(ranks)} data sets, {(~trusted(rows)).sum()} of them not to "
            f"be trusted by their diagnostics; the least of {2 * len(p)} p-values is "
            f"{min(map(min, p.values())):.3f}; the "
            f"ranks spread {wide:.3f} ± {error:.3f} times as far as they should; the ECDF's test sees a "
            f"share of ranks that is {percent(half_band(len(ranks)), 0)} off"
        )
        said.append(f"- {text}.")
        yield f"{piece.each}_sentence", Figure(text, (piece.name,))
    rows = pd.DataFrame(cells)
    yield "table", block(table(rows.rename_axis("quantity").reset_index()), "calibration")
    yield "list", block("\n".join(said), "calibration")
    small = sum(each < 0.01 for each in every)
    text = f"{small} of {len(every)} p-values are below 0.01, where {0.01 * len(every):.1f} are expected"
    yield "sentence", Figure(text, names("calibration"))


@family
def posteriors() -> Named:
    rows = raw("posteriors")
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
    yield "table", block(table(shown.reset_index().rename(columns={"unit": "case"})), "posteriors")
    number, apart = len(z) // rows["statistic"].nunique(), np.sqrt((z**2).mean())
    text = (
        f"means, standard deviations and quantiles of {number} quantities by a fit's sampler are "
        f"{apart:.2f} Monte Carlo errors from those of 10,000 draws by another one (root "
        f"mean square; 1 is expected), and at most {z.abs().max():.1f}; none is off by more than "
        f"{percent(rows['off'].max())} of its posterior standard deviation"
    )
    yield "sentence", Figure(text, names("posteriors"))
    text = f"{number} quantities are {apart:.2f} Monte Carlo errors apart, where 1 is expected"
    yield "short", Figure(text, names("posteriors"))


@family
def recorder() -> Named:
    lines = raw("recorder")
    counts = ["impacts", "K held", "C held", "suspected"]
    shown = lines.drop(columns=["unit", "each"]).assign(
        declared=lines["declared"].map({True: "yes", False: "no"}),
        **{name: lines[name].astype("Int64") for name in counts},
    )
    yield "table", block(table(shown), "recorder")
    analog = lines["filter"].str.endswith(", taken as analog")
    filtered = lines[lines["K held"].notna() & (lines["filter"] != "none") & ~analog]
    declared, left_out = (filtered[filtered["declared"] == value] for value in (True, False))

    def held(rows: pd.DataFrame, names: tuple[str, ...] = ("K held", "C held")) -> str:
        share = 100 * rows[list(names)].to_numpy() / rows[["impacts"]].to_numpy()
        return f"{share.min():.0f} to {share.max():.0f} %"

    sound = lines[lines["K held"].isna()]
    false_alarms = f"{int(sound['suspected'].sum())} of {sound['impacts'].sum()}"
    text = (
        f"behind a declared low-pass 90 % intervals held K and C in {held(declared)} of impacts, behind one "
        f"that is not C in {held(left_out, ('C held',))}, behind software's taken as analog K and C in "
        f"{held(lines[analog])}; `check` suspected {false_alarms} recordings "
        "without one"
    )
    yield "sentence", Figure(text, names("recorder"))


@family
def recordings() -> Named:
    rows = raw("recordings")
    p = rows["below"].astype(str) + " of " + rows["tested"].astype(str)
    shown = pd.DataFrame(
        {
            "recordings": rows["unit"],
            "recorded": rows["recorded"],
            "impacts": rows["impacts"],
            "left out": rows["left_out"],
            "flagged": rows["flagged"],
            "p below 0.01": p.where(rows["tested"] > 0, ""),
        }
    )
    yield "table", block(table(shown), "recordings")
