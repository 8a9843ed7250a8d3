"""What the elements recover, which one made the data, and what a wrong one does."""

from __future__ import annotations

import pandas as pd

from evidence.registry import of_family, pieces
from evidence.texts import (
    Figure,
    Named,
    block,
    coverage,
    each_held,
    family,
    in_order,
    names,
    percent,
    range_of_shares,
    read,
    table,
)

# Two standard errors and four nats of a difference in expected log predictive density: see the script.
DECIDES_SE, DECIDES_NATS = 2, 4


@family
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


@family
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
    each = whole.drop("all")["campaigns"]
    shares = "as many" if each.min() == each.max() else f"{each.min()} to {each.max()}"
    text = (
        f"of {every['campaigns']} simulated campaigns of 20 impacts, {shares} of each element, the one that "
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


@family
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


@family
def common_depth_on_ball() -> Named:
    rows = pieces()["common_depth_on_ball"].rows()
    given = "an" if "mass_exponent_K_common_depth" in set(rows["quantity"]) else "no"
    text = f"{given} exponent at a common depth was given in {rows['campaigns'].max()} campaigns"
    yield "sentence", Figure(text, names("common_depth_on_ball"))
    yield "table", block(_common_depth(rows), "common_depth_on_ball")


@family
def sound_fits() -> Named:
    lines = read("sound_fits.csv")
    alone = lines["what"] == "impacts alone"
    sets, one = lines[~alone], lines[alone].iloc[0]
    shown = sets.groupby(["rate_hz", "errors"], as_index=False).agg(
        datasets=("what", "size"),
        impacts=("impacts", "sum"),
        below=("below", "sum"),
        least=("score", "min"),
        greatest=("score", "max"),
        nothing=("nothing_against", lambda said: f"{int(said.astype(bool).sum())} of {len(said)}"),
    )
    shown["errors"] = shown["errors"].map({True: "as declared", False: "none"})
    shown["rate_hz"] = shown["rate_hz"].map("{:.0f} Hz".format)
    named = {"rate_hz": "sampled at", "errors": "errors of the chain", "below": "p below 0.01"}
    named |= {"least": "least score", "greatest": "greatest score", "nothing": "nothing against the model"}
    yield "table", block(table(shown.rename(columns=named)), "sound_fits")
    count, share = int(sets["nothing_against"].astype(bool).sum()), percent(one["below"] / one["impacts"], 2)
    text = (
        f"a fit of data that obey its model had nothing against it in {count} of {len(sets)} datasets; of "
        f"{one['impacts']} impacts sampled at 2 kHz {share} had p below 0.01"
    )
    yield "sentence", Figure(text, names("sound_fits"))


@family
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
