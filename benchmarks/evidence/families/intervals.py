"""How exact the likelihoods are, and how often intervals hold the truth."""

from __future__ import annotations

import pandas as pd

from evidence.registry import of_family, pieces
from evidence.texts import (
    LEVELS,
    Figure,
    Named,
    block,
    coverage,
    each_held,
    family,
    in_order,
    names,
    percent,
    power_of_ten,
    read,
    table,
    with_error,
)

_MOST = 0.5


@family
def exactness() -> Named:
    lines = read("exactness.csv")
    difference = lines["largest_difference"].astype(float)
    shown = lines.assign(largest_difference=difference.map(power_of_ten) + " " + lines["relative_to"])
    titles = {"largest_difference": "largest difference"}
    yield "table", block(table(shown.drop(columns="relative_to").rename(columns=titles)), "exactness")
    for name, words in (("arma", "ARMA"), ("motion", "motion"), ("decelerations", "recorded decelerations")):
        largest = difference[lines["what"].str.contains(words, regex=False)].max()
        yield name, Figure(power_of_ten(largest), names("exactness"))


@family
def coverage_fit() -> Named:
    kinds = [piece.where["likelihood"] for piece in of_family("coverage_fit")]
    lines = in_order(read("coverage_fit.csv"), "likelihood", kinds)
    yield from each_held(lines, "coverage_fit", "likelihood")
    yield "table", block(table(coverage(lines, ["likelihood", "quantity"])), "coverage_fit")
    own = lines[lines["quantity"].isin(["K", "C"])]
    cells = own.assign(
        what=own["quantity"] + ", " + own["level"].astype(str) + " %",
        cell=with_error(own["share"], own["campaign_se"]),
    )
    short = cells.pivot_table("cell", "likelihood", "what", "first", sort=False)
    short = short.rename("`{}.toml`".format).rename_axis("model").rename_axis(columns=None)
    yield "short", block(table(short.reset_index()), "coverage_fit")
    for kind, part in own[own["level"] == LEVELS[-1]].groupby("likelihood", sort=False):
        held = " and ".join(f"{row.quantity} in {percent(row.share)}" for row in part.itertuples())
        text = (
            f"of {part['impacts'].max()} impacts in {part['campaigns'].max()} simulated campaigns, "
            f"{LEVELS[-1]} % intervals by `{kind}.toml` held {held}"
        )
        yield f"{kind}_sentence", Figure(text, (f"coverage_fit-{kind}",))


@family
def coverage_point() -> Named:
    lines = read("coverage_point.csv")
    shown = pd.DataFrame({"noise": lines["noise"], "impacts": lines["impacts"]})
    for q in "KC":
        shown[f"{q} held by `exact`"] = lines[f"{q}_held"].map(percent)
        shown[f"{q} off by"] = lines[f"{q}_off"].map(lambda off: percent(off, 2))
        shown[f"{q} standard error"] = lines[f"{q}_se"].map(lambda off: percent(off, 2))
        by_impact = lines[f"{q}_held_by_impact"]
        shown[f"{q} held by `impact`"] = by_impact.map(percent).where(by_impact.notna())
        with_bounds = lines[f"{q}_held_with_bounds"]
        shown[f"{q} held, bounds included"] = with_bounds.map(percent).where(with_bounds.notna())
    unflagged = lines["unflagged_by_impact"]
    shown["unflagged by `impact`"] = unflagged.map(percent).where(unflagged.notna())
    yield "table", block(table(shown), "coverage_point")
    recorded = lines[lines["K_held_by_impact"].notna()]
    # Where few impacts tell K those that do are a selection.
    most = recorded[~(unflagged[recorded.index] < _MOST)]
    for name, ending, chosen in (
        ("impact_range", "_held_by_impact", most),
        ("exact_range", "_held", recorded),
    ):
        held = chosen[[f"K{ending}", f"C{ending}"]].to_numpy()
        text = f"{100 * held.min():.0f} to {100 * held.max():.0f} %"
        yield name, Figure(text, names("coverage_point"))


@family
def drops() -> Named:
    lines = read("drops.csv")
    shown = lines[["drops", "impacts"]].copy()
    for q in "KC":
        shown[f"{q} held"] = lines[f"{q}_held"].map(percent)
        shown[f"{q} off by"] = lines[f"{q}_bias"].map(lambda off: percent(off, 2))
    shown["gravity flagged"] = lines["gravity_named"]
    yield "table", block(table(shown), "drops")
    rows = lines.set_index("drops")
    declared = rows[rows.index.str.startswith("declared, ")]
    held = 100 * declared[["K_held", "C_held"]].to_numpy()
    wrong, right = rows.loc["declared as none"], rows.loc["none, declared as none"]
    named, alarms = (f"{each['gravity_named']:.0f} of {each['impacts']:.0f}" for each in (wrong, right))
    text = (
        f"90 % intervals of vertical drops held K and C in {held.min():.0f} to {held.max():.0f} %; of drops "
        f"declared as none K came out {percent(wrong['K_bias'], 0)} too large, and {named} were flagged, as "
        f"were {alarms} impacts without gravity"
    )
    yield "sentence", Figure(text, names("drops"))


@family
def many_impacts() -> Named:
    row = pieces()["many_impacts"].rows().iloc[0]
    text = (
        f"{row['impacts']} impacts took {row['minutes']:.1f} minutes ({row['processor_minutes']:.1f} of "
        f"processor time) and {row['memory_GiB']:.1f} GiB; 90 % intervals held K of "
        f"{percent(row['K_held_90'])} and C of {percent(row['C_held_90'])} of them"
    )
    yield "sentence", Figure(text, names("many_impacts"))
    yield "minutes", Figure(f"{row['minutes']:.1f} minutes", names("many_impacts"))


@family
def calibration() -> Named:
    kinds = [piece.where["likelihood"] for piece in of_family("calibration")]
    lines = in_order(read("calibration.csv"), "likelihood", kinds)
    both = lines["chi_square_p"].map("{:.3f}".format) + " / " + lines["ecdf_p"].map("{:.3f}".format)
    cells = lines.assign(p=both).pivot_table("p", "quantity", "likelihood", "first", sort=False)
    rows = cells[[kind for kind in kinds if kind in cells]].reset_index().rename_axis(columns=None)
    yield "table", block(table(rows), "calibration")
    said = []
    for kind, own in lines.groupby("likelihood", sort=False):
        least, refused = own[["chi_square_p", "ecdf_p"]].min().min(), own["pareto_k_above_0.7"].max()
        text = (
            f"`{kind}`: {own['data_sets'].max()} data sets, {refused} of them with a Pareto k above 0.7; "
            f"the least of {2 * len(own)} p-values is {least:.3f}"
        )
        said.append(f"- {text}.")
        yield f"{kind}_sentence", Figure(text, (f"calibration-{kind}",))
    yield "list", block("\n".join(said), "calibration")
    p = lines[["chi_square_p", "ecdf_p"]].to_numpy()
    text = f"{(p < 0.01).sum()} of {p.size} p-values are below 0.01, where {0.01 * p.size:.1f} are expected"
    yield "sentence", Figure(text, names("calibration"))


@family
def heelstrike() -> Named:
    rows = read("heelstrike.csv")

    def between(name: str, scale: float, digits: int) -> list[str]:
        ends = (rows[f"{name}_{end}"] / scale for end in ("median", "low", "high"))
        return [f"{m:.{digits}f} ({a:.{digits}f} to {b:.{digits}f})" for m, a, b in zip(*ends, strict=True)]

    shown = pd.DataFrame(
        {
            "person": rows["subject"],
            "rank": [f"{a:.0f} to {b:.0f}" for a, b in rows[["rank_low", "rank_high"]].to_numpy()],
            "K, kN/m": between("K", 1e3, 0),
            "K over the typical person's": between("ratio", 1, 2),
            "C, N s/m": between("C", 1, 0),
        }
    )
    yield "table", block(table(shown), "heelstrike")
    width = (rows["K_high"] / rows["K_low"]).median()
    yield "factor", Figure(f"{width:.1f}", names("heelstrike"))


@family
def recorder() -> Named:
    lines = read("recorder.csv")
    counts = ["impacts", "K held", "C held", "suspected"]
    shown = lines.assign(
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
