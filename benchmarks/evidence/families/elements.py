"""What the elements recover, which one made the data, and what a wrong one does."""

from __future__ import annotations

import pandas as pd

from evidence.registry import of_family
from evidence.texts import (
    Figure,
    Named,
    at_most,
    binomial_error,
    block,
    coverage,
    coverage_table,
    family,
    names,
    percent,
    range_of_shares,
    raw,
    table,
    trusted,
)


@family
def coverage_elements() -> Named:
    rows = raw("coverage_elements")
    lines = coverage(rows, ["each", "quantity"])
    exponent = lines["quantity"].str.startswith("mass_exponent")
    impacts = lines[~exponent]
    shown = coverage_table(impacts, ["each", "quantity"]).rename(columns={"each": "element"})
    yield "table", block(table(shown), "coverage_elements")
    text = (
        f"of the {int(lines[exponent]['campaigns'].min())} mass exponents of each element, "
        f"{range_of_shares(lines[exponent])}"
    )
    yield "exponents", Figure(text, names("coverage_elements"))
    sure = trusted(rows).groupby([rows["each"], rows["unit"]]).first()
    text = (
        f"in {int(impacts['impacts'].min())} simulated impacts of each, {range_of_shares(impacts)}; of "
        f"{len(sure)} fits {(~sure).sum()} could not be trusted by their diagnostics"
    )
    yield "sentence", Figure(text, names("coverage_elements"))
    yield "short", Figure(range_of_shares(impacts[impacts["level"] == 90]), names("coverage_elements"))


def compared(rows: pd.DataFrame, ending: str = "") -> pd.DataFrame:
    """By element and over all: how often the right one wins where the difference decides, and loses there."""
    from bayestissue.reports.pages.posterior import decides

    def line(part: pd.DataFrame) -> dict[str, float]:
        difference, se = part[f"difference{ending}"], part[f"se{ending}"]
        told = decides(difference, se)
        return {
            "campaigns": len(part),
            "first": int((difference > 0).sum()),
            "differ": int(told.sum()),
            "right": int((told & (difference > 0)).sum()),
            "wrong": int((told & (difference < 0)).sum()),
            "weight": round(float(part[f"weight{ending}"].median()), 3),
        }

    lines = {name: line(part) for name, part in rows.groupby("each", sort=False)}
    return pd.DataFrame(lines | {"all": line(rows)}).T.astype(object)


@family
def compare_elements() -> Named:
    elements = [piece.each for piece in of_family("compare_elements")]
    rows = raw("compare_elements")
    by_impact, by_person = compared(rows), compared(rows, "_people").loc["all"]
    whole = by_impact.astype(dict.fromkeys(by_impact.columns.drop("weight"), int))
    of = " of " + whole["campaigns"].astype(str)
    shown = pd.DataFrame(
        {
            "first": whole["first"].astype(str) + of,
            "differ": whole["differ"],
            "right where they differ": whole["right"],
            "weight of the right one": whole["weight"],
        }
    )
    yield "table", block(table(shown.rename_axis("tissue").reset_index()), "compare_elements")
    refused = (~rows[[f"trusted_{name}" for name in elements]].astype(bool)).sum()
    own = sum(not row[f"trusted_{row['each']}"] for _, row in rows.iterrows())
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
        f"in {every['wrong']}"
    )
    yield "sentence", Figure(text, names("compare_elements"))


def _common_depth(family: str) -> pd.DataFrame:
    """In how many campaigns an interval of 90 % holds 0, the truth; a line a case and quantity."""
    rows = raw(family)
    lines = coverage(rows[trusted(rows)], ["each", "quantity"])
    exponents = ["mass_exponent_K_common_depth", "mass_exponent_K_secant"]
    return lines[(lines["level"] == 90) & lines["quantity"].isin(exponents)]


def _depth_table(lines: pd.DataFrame) -> str:
    titles = {
        "mass_exponent_K_common_depth": "at one common depth",
        "mass_exponent_K_secant": "at each impact's own greatest depth",
    }
    shown = lines.assign(
        case=lines["each"].replace("", "discrepancy_on_ball"),
        cell=lines["held"].astype(str) + " of " + lines["campaigns"].astype(str),
    )
    cells = shown.pivot_table("cell", "case", "quantity", "first", sort=False).reindex(columns=list(titles))
    return table(cells.rename(columns=titles).rename_axis(columns=None).reset_index())


@family
def common_depth() -> Named:
    lines = _common_depth("common_depth")
    yield "table", block(_depth_table(lines), "common_depth")
    for name, quantity in (("range", "common_depth"), ("range_secant", "secant")):
        own = lines[lines["quantity"] == f"mass_exponent_K_{quantity}"]
        share, campaigns = own["held"].sum() / own["campaigns"].sum(), own["campaigns"].sum()
        text = f"{100 * own['share'].min():.0f} to {100 * own['share'].max():.0f} %"
        if name == "range":
            text += f", {percent(share, 0)} of all {campaigns}"
        yield name, Figure(text, names("common_depth"))


@family
def common_depth_on_ball() -> Named:
    rows, lines = raw("common_depth_on_ball"), _common_depth("common_depth_on_ball")
    given = "an" if "mass_exponent_K_common_depth" in set(rows["quantity"]) else "no"
    text = f"{given} exponent at a common depth was given in {rows['unit'].nunique()} campaigns"
    yield "sentence", Figure(text, names("common_depth_on_ball"))
    yield "table", block(_depth_table(lines), "common_depth_on_ball")


@family
def sound_fits() -> Named:
    lines = raw("sound_fits")
    alone = lines["unit"] < 0
    sets, one = lines[~alone], lines[alone].iloc[0]
    shown = sets.groupby(["rate_hz", "errors"], as_index=False).agg(
        datasets=("unit", "size"),
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
    count, below = int(sets["nothing_against"].astype(bool).sum()), one["below"] / one["impacts"]
    share, error = percent(below, 2), binomial_error(below, one["impacts"])
    text = (
        f"a fit of data that obey its model had something against it in "
        f"{at_most(len(sets) - count, len(sets))} datasets; of {one['impacts']} impacts sampled at 2 kHz "
        f"{share} ± {percent(error, 2)} had p below 0.01"
    )
    yield "sentence", Figure(text, names("sound_fits"))


@family
def model_form() -> Named:
    from bayestissue.inference.checking.model_form import LIMIT

    rows = raw("model_form")
    held = coverage(rows, ["each", "fit"])
    held = held[held["level"] == 90].set_index(["each", "fit"])
    first = rows.groupby(["each", "fit", "unit"], sort=False)[["score"]].first()
    groups = first.groupby(["each", "fit"], sort=False)
    lines = pd.DataFrame(
        {"campaigns": groups.size(), "least": groups["score"].min(), "greatest": groups["score"].max()}
    )
    lines["warned"] = (first["score"] > LIMIT).groupby(["each", "fit"]).sum()
    plain, count = lines.index.get_level_values("fit") == "plain", lines["campaigns"].astype(str)
    scores = lines["least"].map("{:.1f}".format) + " to " + lines["greatest"].map("{:.1f}".format)
    impacts = held["held"].astype(str) + " of " + held["impacts"].astype(str)
    shown = pd.DataFrame(
        {
            "fit": lines.index.get_level_values("fit").str.replace("plain", "without a discrepancy"),
            "warned": (lines["warned"].astype(str) + " of " + count).where(plain),
            "score": scores,
            "K_secant held, 90 %": impacts + " (± " + held["se"].map(percent) + ")",
            "width": held["width"].map(percent),
        }
    )
    shown.insert(0, "tissue", lines.index.get_level_values("each"))
    yield "table", block(table(shown), "model_form")
    stiffening, same = ("model_form-stiffening",), ("model_form-kelvin_voigt",)
    wrong, right = lines.loc[("stiffening", "plain")], lines.loc[("kelvin_voigt", "plain")]
    yield "warned", Figure(f"{wrong['warned']:.0f} of {wrong['campaigns']:.0f}", stiffening)
    yield "false_alarms", Figure(at_most(int(right["warned"]), int(right["campaigns"])), same)
    without, wide = held.loc[("stiffening", "plain")], held.loc[("stiffening", "discrepancy")]
    text = (
        f"of stiffening tissue fitted as a spring and damper 90 % intervals held the secant stiffness in "
        f"{wide['held']:.0f} of {wide['impacts']:.0f} impacts with the discrepancy, "
        f"{percent(wide['width'], 0)} wide, and in {without['held']:.0f} without it"
    )
    yield "sentence", Figure(text, stiffening)
