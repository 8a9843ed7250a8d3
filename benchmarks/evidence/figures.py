"""Tables, sentences and single figures, made of the result files."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import cache

import numpy as np
import pandas as pd

from evidence.registry import BENCHMARKS, of_family, pieces
from evidence.status import EARLIER, state_of

LEVELS = (50, 90)
_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
# Three standard errors and four nats of a difference in expected log predictive density: see the script.
DECIDES_SE, DECIDES_NATS = 2, 4


@dataclass(frozen=True)
class Figure:
    """A text of the documentation, and the pieces of evidence that it tells."""

    text: str
    pieces: tuple[str, ...]
    # Tables and paragraphs of their own; others stand within a sentence.
    block: bool = False

    def printed(self) -> str:
        """With a remark where a piece is stale."""
        stale = [name for name in self.pieces if state_of(pieces()[name]).kind != "fresh"]
        if not stale:
            return self.text
        if not self.block:
            return f"{self.text} ({EARLIER})"
        which = "" if len(stale) == len(self.pieces) else f": {', '.join(stale)}"
        return f"{self.text}\n\n*{EARLIER[0].upper()}{EARLIER[1:]}{which}.*"


Named = Iterator[tuple[str, Figure]]
_FAMILIES: dict[str, Callable[[], Named]] = {}


def _family(function: Callable[[], Named]) -> Callable[[], Named]:
    _FAMILIES[function.__name__] = function
    return function


@cache
def figures() -> dict[str, Figure]:
    """All of them by name, FAMILY.FIGURE; those of a family without its result file are not there."""
    found = {}
    for family, made in _FAMILIES.items():
        if all(not piece.rows().empty for piece in of_family(family)[:1]):
            found |= {f"{family}.{name}": figure for name, figure in made()}
    return found


def read(name: str) -> pd.DataFrame:
    """A result file."""
    return pd.read_csv(BENCHMARKS / name)


def table(rows: pd.DataFrame, *, words: bool = False) -> str:
    """As Markdown: the first column to the left, or all of ``words``; empty where a cell is missing."""
    aligned = ["---", *["---" if words else "---:"] * (rows.shape[1] - 1)]
    head = [" | ".join(map(str, rows.columns)), " | ".join(aligned)]
    cells = rows.astype(object).where(rows.notna(), "").astype(str)
    return "\n".join(f"| {line} |" for line in [*head, *(" | ".join(row) for row in cells.to_numpy())])


def power_of_ten(value: float) -> str:
    """Such as 3 · 10⁻⁹."""
    mantissa, exponent = f"{value:.0e}".split("e")
    return f"{mantissa} · 10{str(int(exponent)).translate(_RAISED)}"


def percent(share: float, digits: int = 1) -> str:
    """A share."""
    return f"{100 * share:.{digits}f} %"


def with_error(share: pd.Series, error: pd.Series) -> list[str]:
    """Shares and their standard errors, in percent."""
    return [f"{100 * each:.1f} ± {100 * sd:.1f} %" for each, sd in zip(share, error, strict=True)]


def names(family: str) -> tuple[str, ...]:
    """The pieces of a family."""
    return tuple(piece.name for piece in of_family(family))


def block(text: str, family: str) -> Figure:
    """Of all pieces of a family."""
    return Figure(text, names(family), block=True)


def in_order(lines: pd.DataFrame, column: str, order: Iterable[str]) -> pd.DataFrame:
    """Rows in the order in which the registry has their pieces."""
    place = list(order).index
    return lines.sort_values(column, key=lambda values: values.map(place), kind="stable")


def coverage(lines: pd.DataFrame, by: list[str]) -> pd.DataFrame:
    """Of each quantity: how often the intervals held it, how far off the median, how wide the widest."""
    lines = lines.assign(cell=with_error(lines["share"], lines["campaign_se"]))
    cells = lines.pivot_table("cell", by, "level", "first", sort=False).rename(columns="{} % held".format)
    widest = lines[lines["level"] == lines["level"].max()].set_index(by)
    cells["off by"], cells["90 % width"] = widest["median_error"], widest["median_width"]
    return cells.reset_index().rename_axis(columns=None)


def range_of_shares(lines: pd.DataFrame) -> str:
    """The least and the greatest share held, by level."""
    ends = lines.groupby("level")["share"].agg(["min", "max"]).itertuples()
    return " and ".join(f"{level} % intervals held {100 * a:.0f} to {100 * b:.0f} %" for level, a, b in ends)


def each_held(lines: pd.DataFrame, family: str, column: str) -> Named:
    """The share held of each quantity and level, named VALUE_QUANTITY_LEVEL."""
    for row in lines.itertuples():
        value = getattr(row, column)
        yield f"{value}_{row.quantity}_{row.level}", Figure(percent(row.share), (f"{family}-{value}",))


@_family
def exactness() -> Named:
    lines = read("exactness.csv")
    difference = lines["largest_difference"].astype(float)
    shown = lines.assign(largest_difference=difference.map(power_of_ten) + " " + lines["relative_to"])
    titles = {"largest_difference": "largest difference"}
    yield "table", block(table(shown.drop(columns="relative_to").rename(columns=titles)), "exactness")
    for name, words in (("arma", "ARMA"), ("motion", "motion"), ("decelerations", "recorded decelerations")):
        largest = difference[lines["what"].str.contains(words, regex=False)].max()
        yield name, Figure(power_of_ten(largest), names("exactness"))


@_family
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


@_family
def coverage_point() -> Named:
    lines = read("coverage_point.csv")
    shown = pd.DataFrame({"noise": lines["noise"], "impacts": lines["impacts"]})
    for q in "KC":
        shown[f"{q} held by `exact`"] = lines[f"{q}_held"].map(percent)
        shown[f"{q} off by"] = lines[f"{q}_off"].map(lambda off: percent(off, 2))
        shown[f"{q} standard error"] = lines[f"{q}_se"].map(lambda off: percent(off, 2))
        by_impact = lines[f"{q}_held_by_impact"]
        shown[f"{q} held by `impact`"] = by_impact.map(percent).where(by_impact.notna())
    yield "table", block(table(shown), "coverage_point")
    recorded = lines[lines["K_held_by_impact"].notna()]
    for name, ending in (("impact_range", "_held_by_impact"), ("exact_range", "_held")):
        held = recorded[[f"K{ending}", f"C{ending}"]].to_numpy()
        text = f"{100 * held.min():.0f} to {100 * held.max():.0f} %"
        yield name, Figure(text, names("coverage_point"))


@_family
def many_impacts() -> Named:
    row = pieces()["many_impacts"].rows().iloc[0]
    text = (
        f"{row['impacts']} impacts took {row['minutes']:.1f} minutes ({row['processor_minutes']:.1f} of "
        f"processor time) and {row['memory_GiB']:.1f} GiB; 90 % intervals held K of "
        f"{percent(row['K_held_90'])} and C of {percent(row['C_held_90'])} of them"
    )
    yield "sentence", Figure(text, names("many_impacts"))
    yield "minutes", Figure(f"{row['minutes']:.1f} minutes", names("many_impacts"))


@_family
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


@_family
def calibration_answers() -> Named:
    lines = read("calibration_answers.csv")
    own = lines["which"] != "all"
    rows = []
    for kind, part in lines[own].dropna(subset="held").groupby("kind", sort=False):
        pooled = lines[~own & (lines["kind"] == kind)].iloc[0]
        least, most = (part.loc[place] for place in (part["held"].idxmin(), part["held"].idxmax()))
        row = {"90 % intervals": kind, "quantities": len(part)}
        row["held"] = with_error(*(pooled[[name]] / 100 for name in ("held", "se")))[0]
        row |= {"least": f"{least['held']:.1f} %, {least['which']}"}
        row |= {"most": f"{most['held']:.1f} %, {most['which']}"}
        rows.append(row)
    yield "intervals", block(table(pd.DataFrame(rows)), "calibration_answers")
    claims = lines[lines["kind"] == "claims of probability"]
    bins = pd.DataFrame(
        {
            "claims of probability": claims["which"],
            "claims": claims["answers"].astype(int),
            "mean probability": claims["probability"].map("{:.1f} %".format),
            "true": with_error(claims["true"] / 100, claims["se"] / 100),
        }
    )
    yield "claims", block(table(bins), "calibration_answers")
    prior = lines.dropna(subset="prior")
    error = np.sqrt(prior["prior"] * (100 - prior["prior"]) / prior["studies"])
    off = ((prior["true"] - prior["prior"]) / error).abs().max()
    text = (
        f"the prior probabilities of the {len(prior)} claims that were asked are the shares of studies in "
        f"which they are true, within {off:.1f} standard errors"
    )
    yield "priors", Figure(text, names("calibration_answers"))
    held = lines[own]["held"].dropna()
    text = (
        f"in {int(lines['studies'].max())} simulated studies the 90 % intervals of {len(held)} answers held "
        f"{held.min():.0f} to {held.max():.0f} %, {held.mean():.1f} % in the mean; of claims given a probability "
        f"of 80 to 95 % {claims['true'].iloc[-2]:.0f} % were true"
    )
    yield "sentence", Figure(text, names("calibration_answers"))


@_family
def coverage_elements() -> Named:
    elements = [piece.where["element"] for piece in of_family("coverage_elements")]
    lines = in_order(read("coverage_elements.csv"), "element", elements)
    yield from each_held(lines, "coverage_elements", "element")
    exponent = lines["quantity"].str.startswith("mass_exponent")
    impacts = lines[~exponent]
    yield "table", block(table(coverage(impacts, ["element", "quantity"])), "coverage_elements")
    text = (
        f"of the {int(lines[exponent]['campaigns'].min())} mass exponents of each element, "
        f"{range_of_shares(lines[exponent])}"
    )
    yield "exponents", Figure(text, names("coverage_elements"))
    first = lines.groupby("element").first()
    text = (
        f"in {int(impacts['impacts'].min())} simulated impacts of each, {range_of_shares(impacts)} (of the "
        f"corrections of {first['campaigns'].sum()} fits {first['pareto_k_above_0.7'].sum()} had a Pareto k "
        "above 0.7)"
    )
    yield "sentence", Figure(text, names("coverage_elements"))


def compared(rows: pd.DataFrame, ending: str = "") -> pd.DataFrame:
    """By element and over all: how often the right one wins where the difference decides, and loses there."""

    def line(part: pd.DataFrame) -> dict[str, float]:
        difference, se = part[f"difference{ending}"], part[f"se{ending}"]
        told = (difference.abs() > DECIDES_SE * se) & (difference.abs() > DECIDES_NATS)
        return {
            "campaigns": len(part),
            "first": int((difference > 0).sum()),
            "differ": int(told.sum()),
            "right": int((told & (difference > 0)).sum()),
            "wrong": int((told & (difference < 0)).sum()),
            "weight": round(float(part[f"weight{ending}"].median()), 3),
            "held": int(part["K_of_weights_held"].sum()),
        }

    lines = {name: line(part) for name, part in rows.groupby("element", sort=False)}
    return pd.DataFrame(lines | {"all": line(rows)}).T.astype(object)


@_family
def compare_elements() -> Named:
    elements = [piece.where["element"] for piece in of_family("compare_elements")]
    rows = in_order(read("compare_elements.csv"), "element", elements)
    by_impact, by_person = compared(rows), compared(rows, "_people").loc["all"]
    whole = by_impact.astype(dict.fromkeys(by_impact.columns.drop("weight"), int))
    of = " of " + whole["campaigns"].astype(str)
    shown = pd.DataFrame(
        {
            "first": whole["first"].astype(str) + of,
            "differ": whole["differ"],
            "right where they differ": whole["right"],
            "weight of the right one": whole["weight"],
            "K held": whole["held"].astype(str) + of,
        }
    )
    yield "table", block(table(shown.rename_axis("tissue").reset_index()), "compare_elements")
    refused = (~rows[[f"trusted_{name}" for name in elements]].astype(bool)).sum()
    own = sum(not row[f"trusted_{row['element']}"] for _, row in rows.iterrows())
    every = whole.loc["all"]
    text = (
        f"with people left out instead of impacts {by_person['differ']:.0f} differ and "
        f"{by_person['right']:.0f} of them are right. Refused corrections, of {every['campaigns']} fits by "
        f"each element: {', '.join(f'{name} {n}' for name, n in zip(elements, refused, strict=True))}; of "
        f"the element that made the data {own}"
    )
    yield "refused", Figure(text, names("compare_elements"))
    text = (
        f"of {every['campaigns']} simulated campaigns of 20 impacts, as many of each element, the one that "
        f"made the data won by more than two standard errors and four nats in {every['right']}, and lost so "
        f"in {every['wrong']}; the secant stiffness that the weights imply held the truth in {every['held']}"
    )
    yield "sentence", Figure(text, names("compare_elements"))


def _common_depth(lines: pd.DataFrame) -> str:
    exponents = ["mass_exponent_K_common_depth", "mass_exponent_K_secant"]
    shown = lines[lines["quantity"].isin(exponents)]
    shown = shown.assign(cell=shown["held"].astype(str) + " of " + shown["campaigns"].astype(str))
    cells = shown.pivot_table("cell", "case", "quantity", "first", sort=False).reindex(columns=exponents)
    cells.columns = ["at one common depth", "at each impact's own greatest depth"]
    return table(cells.reset_index())


@_family
def common_depth() -> Named:
    lines = read("common_depth.csv")
    own = lines[lines["case"] != "discrepancy_on_ball"]
    yield "table", block(_common_depth(own), "common_depth")
    common = own[own["quantity"] == "mass_exponent_K_common_depth"]
    text = f"{common['held'].min()} to {common['held'].max()} of {common['campaigns'].min()}"
    yield "range", Figure(text, names("common_depth"))
    secant = own[own["quantity"] == "mass_exponent_K_secant"]
    text = f"{secant['held'].min()} to {secant['held'].max()} of {secant['campaigns'].min()}"
    yield "range_secant", Figure(text, names("common_depth"))


@_family
def common_depth_on_ball() -> Named:
    rows = pieces()["common_depth_on_ball"].rows()
    given = "an" if "mass_exponent_K_common_depth" in set(rows["quantity"]) else "no"
    text = f"{given} exponent at a common depth was given in {rows['campaigns'].max()} campaigns"
    yield "sentence", Figure(text, names("common_depth_on_ball"))
    yield "table", block(_common_depth(rows), "common_depth_on_ball")


@_family
def model_form() -> Named:
    lines = read("model_form.csv")
    plain, count = lines["fit"] == "plain", lines["campaigns"].astype(str)
    scores = lines["least_score"].astype(str) + " to " + lines["greatest_score"].astype(str)
    shown = pd.DataFrame(
        {
            "tissue": lines["tissue"],
            "fit": lines["fit"].replace("plain", "without a discrepancy"),
            "warned": (lines["warned"].astype(str) + " of " + count).where(plain),
            "score": scores.where(plain),
            "K_secant held, 90 %": lines["held_90"].astype(str) + " of " + lines["impacts"].astype(str),
            "width": lines["median_width"].map(percent),
            "by exact path": lines["by_exact_path"].astype(str) + " of " + count,
        }
    )
    yield "table", block(table(shown), "model_form")
    row = lines.set_index(["tissue", "fit"]).loc
    without, beside = row[("stiffening", "plain")], row[("stiffening", "discrepancy")]
    right = row[("kelvin_voigt", "plain")]
    stiffening, same = ("model_form-stiffening",), ("model_form-kelvin_voigt",)
    yield "warned", Figure(f"{without['warned']} of {without['campaigns']}", stiffening)
    yield "false_alarms", Figure(f"{right['warned']} of {right['campaigns']}", same)
    text = (
        f"of stiffening tissue fitted as a spring and damper 90 % intervals held the secant stiffness in "
        f"{beside['held_90']} of {beside['impacts']} impacts with the discrepancy, "
        f"{percent(beside['median_width'], 0)} wide, and in {without['held_90']} without it"
    )
    yield "sentence", Figure(text, stiffening)


@_family
def measuring_chain() -> Named:
    lines = read("measuring_chain.csv")
    cells = lines["alarms"].astype(str) + " of " + lines["sets"].astype(str)
    shown = lines.assign(cell=cells).pivot_table("cell", "spoilt", "likelihood", "first", sort=False)
    shown = shown.rename(columns="alarms by `{}`".format).reset_index().rename_axis(columns=None)
    yield "table", block(table(shown), "measuring_chain")
    right = lines[lines["spoilt"] == "nothing"]
    yield (
        "false_alarms",
        Figure(f"{right['alarms'].sum()} of {right['sets'].sum()}", names("measuring_chain")),
    )
    wrong = lines[~lines["spoilt"].str.contains("nothing|mass")]
    share = f"{wrong['alarms'].min()} to {wrong['alarms'].max()} of {wrong['sets'].max()}"
    yield "found", Figure(share, names("measuring_chain"))


@_family
def recorder() -> Named:
    lines = read("recorder.csv")
    counts = ["impacts", "K held", "C held", "suspected"]
    shown = lines.assign(
        declared=lines["declared"].map({True: "yes", False: "no"}),
        **{name: lines[name].astype("Int64") for name in counts},
    )
    yield "table", block(table(shown), "recorder")
    filtered = lines[lines["K held"].notna() & (lines["filter"] != "none")]
    declared, left_out = (filtered[filtered["declared"] == value] for value in (True, False))

    def held(rows: pd.DataFrame, names: tuple[str, ...] = ("K held", "C held")) -> str:
        share = 100 * rows[list(names)].to_numpy() / rows[["impacts"]].to_numpy()
        return f"{share.min():.0f} to {share.max():.0f} %"

    sound = lines[lines["K held"].isna()]
    false_alarms = f"{int(sound['suspected'].sum())} of {sound['impacts'].sum()}"
    text = (
        f"behind a declared low-pass 90 % intervals held K and C in {held(declared)} of impacts, behind one "
        f"that is not C in {held(left_out, ('C held',))}; `check` suspected {false_alarms} recordings "
        "without one"
    )
    yield "sentence", Figure(text, names("recorder"))


@_family
def spoilt_impacts() -> Named:
    rows = read("spoilt_impacts.csv")
    shown = pd.DataFrame(
        {
            "recording": rows["kind"],
            "impacts": rows["impacts"],
            "flagged": [percent(each) for each in rows["flagged"] / rows["impacts"]],
            "K or C off by more than 5 %": rows["off"],
            "of these flagged": (rows["off_and_flagged"] / rows["off"]).map(
                lambda share: "" if np.isnan(share) else percent(share, 0)
            ),
            "K off, median": rows["K_off_median"].map(percent).where(rows["K_off_median"].notna()),
            "C off, median": rows["C_off_median"].map(percent).where(rows["C_off_median"].notna()),
            "commonest flag": rows["commonest_flag"],
        }
    )
    yield "table", block(table(shown), "spoilt_impacts")
    own, sound = names("spoilt_impacts"), rows["kind"].str.startswith("sound")
    spoilt = rows[~sound]
    off, caught = spoilt["off"].sum(), spoilt["off_and_flagged"].sum()
    yield "found", Figure(percent(caught / off), own)
    least = spoilt[spoilt["off"] >= 20].assign(share=lambda t: t["off_and_flagged"] / t["off"])
    weakest = ", ".join(
        f"{row.kind} {percent(row.share, 0)}" for row in least.nsmallest(3, "share").itertuples()
    )
    text = (
        f"of {spoilt['impacts'].sum()} impacts spoilt in {len(spoilt)} ways, K or C of {off} is off by more "
        f"than 5 %, and {percent(caught / off)} of these are flagged or refused (the least of the kinds: "
        f"{weakest})"
    )
    yield "sentence", Figure(text, own)
    for row in rows[sound].itertuples():
        kind = row.kind.removeprefix("sound, ")
        yield f"sound_{kind}", Figure(percent(row.flagged / row.impacts), own)
        yield f"no_answer_{kind}", Figure(percent(row.no_answer / row.impacts), own)


@_family
def damaged_files() -> Named:
    rows = read("damaged_files.csv")
    good, bad = int(rows["examples_passed"].sum()), int(rows["examples_failed"].sum())
    text = f"{bad} of {good + bad} damaged files of {len(rows)} kinds were read wrongly or gave a traceback"
    yield "sentence", Figure(text, names("damaged_files"))


@_family
def kills() -> Named:
    rows = read("kills.csv")
    passed = (rows["state"] == "passed").all()
    text = "had the same draws as one that was left alone" if passed else "did not all have the same draws"
    yield (
        "sentence",
        Figure(f"a fit that was killed ten times, and given again each time, {text}", names("kills")),
    )


@_family
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


@_family
def likelihood() -> Named:
    rows = read("likelihood.csv")
    ours = rows[rows["contender"] == "bayestissue"].set_index("samples")["ms"]
    times = rows["ms"] / rows["samples"].map(ours)
    cells = [f"{ms:.3g} ({ratio:.2g})" for ms, ratio in zip(rows["ms"], times, strict=True)]
    shown = rows.assign(cell=cells).pivot_table("cell", "contender", "samples", "first", sort=False)
    shown = shown.rename(columns="{} samples".format).reset_index().rename_axis(columns=None)
    yield "table", block(table(shown), "likelihood")
    at = rows["samples"] == 1024
    libraries = rows["contender"].str.contains("tinygp|celerite2|statsmodels")
    text = f"{times[at & libraries].min():.0f} to {times[at & libraries].max():.0f} times"
    yield "libraries", Figure(text, names("likelihood"))
    scan = times[at & rows["contender"].str.contains("tuned")]
    yield "scan", Figure(f"{scan.iloc[0]:.0f} times", names("likelihood"))


@_family
def fit_efficiency() -> Named:
    rows = read("fit_efficiency_arma.csv")
    shown = pd.DataFrame(
        {
            "contender": rows["contender"],
            "chains": rows["remark"],
            "gradients a draw": rows["gradients_a_draw"].map("{:.0f}".format),
            "least ESS": rows["ess_bulk"].map("{:.0f}".format),
            "seconds": rows["own_sampling_s"].map("{:.0f}".format),
            "ESS a second": rows["per_own_s"].map("{:.2g}".format),
            "R-hat": rows["r_hat"].map("{:.3f}".format).where(rows["r_hat"].notna()),
        }
    )
    yield "table", block(table(shown), "fit_efficiency")
    rate = rows.set_index("contender")["per_own_s"]
    ours = rate["bayestissue, summary path"]
    nutpie, plain = (
        rate[rate.index.str.contains(words)].max() for words in ("nutpie .*exact", "plain model")
    )
    yield "nutpie", Figure(f"{ours / nutpie:.1f} times", names("fit_efficiency"))
    yield "plain", Figure(f"{ours / plain:.0f} times", names("fit_efficiency"))


@_family
def trace_likelihood() -> Named:
    shown = read("trace_likelihood.csv")
    milliseconds = {name: f"{name} [ms]" for name in shown.columns.drop("likelihood")}
    yield "table", block(table(shown.rename(columns=milliseconds)), "trace_likelihood")


@_family
def fit_time() -> Named:
    elements = [piece.where["element"] for piece in of_family("fit_time")]
    rows = in_order(read("fit_time.csv"), "element", elements)
    columns = {"first_s": "first [s]", "again_s": "again [s]", "other_s": "other dataset [s]"}
    shown = rows[["element", "tissue", *columns, "path", "r_hat", "ess"]].rename(columns=columns)
    shown = shown.rename(columns={"r_hat": "R-hat", "ess": "least ESS"})
    yield "table", block(table(shown), "fit_time")
    example = rows[rows["tissue"] == "example"].groupby("element").last()
    for name, row in example.iterrows():
        yield f"{name}_first", Figure(f"{row['first_s']:.0f} s", (f"fit_time-{name}",))
        yield f"{name}_again", Figure(f"{row['again_s']:.0f} s", (f"fit_time-{name}",))


@_family
def reproduce_time() -> Named:
    rows = read("reproduce_time.csv").set_index("run")
    for run in ("first", "again"):
        yield run, Figure(f"{rows.loc[run, 's']:.0f} s", names("reproduce_time"))
