"""What the elements recover, which one made the data, and what a wrong one does."""

from __future__ import annotations

import pandas as pd

from evidence.texts import (
    Named,
    at_most,
    binomial_error,
    coverage,
    coverage_table,
    ends,
    of,
    percent,
    range_of_shares,
    wide,
)


def coverage_elements(rows: pd.DataFrame) -> Named:
    lines = coverage(rows, ["each", "quantity"])
    exponent = lines["quantity"].str.startswith("mass_exponent")
    impacts, exponents = lines[~exponent], lines[exponent]
    yield "table", coverage_table(impacts, "element")
    yield "exponents", {"campaigns": exponents["campaigns"].min(), "range": range_of_shares(exponents)}
    passed = rows.groupby(["each", "unit"])["passed"].first().astype(bool)
    said = {"impacts": impacts["impacts"].min(), "range": range_of_shares(impacts)}
    yield "sentence", said | {"fits": len(passed), "refused": (~passed).sum()}
    yield "short", range_of_shares(impacts[impacts["level"] == 90])


def compared(rows: pd.DataFrame, ending: str = "") -> pd.DataFrame:
    """By element and over all: how often the right one wins where the difference decides, and loses there."""
    from bayestissue.reports.pages.posterior import decides

    difference = rows[f"difference{ending}"]
    decided = decides(difference, rows[f"se{ending}"])
    found = pd.DataFrame({"each": rows["each"], "first": difference > 0, "differ": decided})
    found = found.assign(right=decided & (difference > 0), wrong=decided & (difference < 0))
    lines = {name: part.sum(numeric_only=True) for name, part in found.groupby("each", sort=False)}
    lines["all"] = found.sum(numeric_only=True)
    weights = rows.groupby("each", sort=False)[f"weight{ending}"].median().to_dict()
    weights["all"] = rows[f"weight{ending}"].median()
    campaigns = rows["each"].value_counts().to_dict() | {"all": len(rows)}
    table = pd.DataFrame(lines).T.astype(int)
    return table.assign(campaigns=pd.Series(campaigns), weight=pd.Series(weights).round(3))


def compare_elements(rows: pd.DataFrame) -> Named:
    lines, by_person = compared(rows), compared(rows, "_people").loc["all"]
    shown = pd.DataFrame(
        {
            "first": of(lines["first"], lines["campaigns"]),
            "differ": lines["differ"],
            "right where they differ": lines["right"],
            "weight of the right one": lines["weight"],
        }
    )
    yield "table", shown.rename_axis("tissue").reset_index()
    elements = rows["each"].unique()
    refused = {name: (~rows[f"trusted_{name}"].astype(bool)).sum() for name in elements}
    own = sum(not row[f"trusted_{row['each']}"] for _, row in rows.iterrows())
    said = {"campaigns": len(rows), "by_element": ", ".join(f"{n} {count}" for n, count in refused.items())}
    yield "refused", said | {"differ": by_person["differ"], "right": by_person["right"], "own": own}
    each = lines.drop("all")["campaigns"]
    shares = "as many" if each.min() == each.max() else f"{each.min()} to {each.max()}"
    yield "sentence", {"shares": shares} | lines.loc["all"].astype(int).to_dict()


# The exponents of an interval of 90 %, as a column of the table is called.
_DEPTHS = {
    "mass_exponent_K_common_depth": "at one common depth",
    "mass_exponent_K_secant": "at each impact's own greatest depth",
}


def common_depth(rows: pd.DataFrame) -> Named:
    """In how many campaigns an interval of 90 % holds 0, the truth."""
    lines = coverage(rows[rows["passed"].astype(bool)], ["each", "quantity"])
    lines = lines[(lines["level"] == 90) & lines["quantity"].isin(_DEPTHS)]
    shown = lines.assign(cell=of(lines["held"], lines["campaigns"])).rename(columns={"each": "case"})
    cells = wide(shown, "case", "quantity")[[*_DEPTHS]]
    yield "table", cells.rename(columns=_DEPTHS).reset_index()
    for name, quantity in zip(("range", "range_secant"), _DEPTHS, strict=True):
        own = lines[lines["quantity"] == quantity]
        campaigns = own["campaigns"].sum()
        share = 100 * own["held"].sum() / campaigns
        yield name, ends(own["share"]) | {"share": share, "campaigns": campaigns}


def common_depth_on_ball(rows: pd.DataFrame) -> Named:
    given = "an" if "mass_exponent_K_common_depth" in set(rows["quantity"]) else "no"
    yield "sentence", {"given": given, "campaigns": rows["unit"].nunique()}


def sound_fits(rows: pd.DataFrame) -> Named:
    alone = rows["unit"] < 0
    sets, one = rows[~alone], rows[alone].iloc[0]
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
    yield "table", shown.rename(columns=named)
    against, below = (~sets["nothing_against"].astype(bool)).sum(), one["below"] / one["impacts"]
    said = {"against": at_most(against, len(sets)), "impacts": one["impacts"], "share": 100 * below}
    yield "sentence", said | {"error": 100 * binomial_error(below, one["impacts"])}


def model_form(rows: pd.DataFrame) -> Named:
    from bayestissue.inference.checking.model_form import LIMIT

    held = coverage(rows, ["each", "fit"])
    held = held[held["level"] == 90].set_index(["each", "fit"])
    first = rows.groupby(["each", "fit", "unit"], sort=False)["score"].first()
    scores = first.groupby(["each", "fit"], sort=False)
    warned = (first > LIMIT).groupby(["each", "fit"], sort=False).sum()
    tissues, fits = (scores.size().index.get_level_values(level) for level in ("each", "fit"))
    shown = pd.DataFrame(
        {
            "tissue": tissues,
            "fit": fits.str.replace("plain", "without a discrepancy"),
            "warned": of(warned, scores.size()).where(fits == "plain"),
            "score": scores.min().map("{:.1f}".format) + " to " + scores.max().map("{:.1f}".format),
            "K_secant held, 90 %": of(held["held"], held["impacts"]) + " (± " + held["se"].map(percent) + ")",
            "width": held["width"].map(percent),
        }
    )
    yield "table", shown
    yield "warned", of(warned, scores.size())["stiffening", "plain"]
    right = "kelvin_voigt", "plain"
    yield "false_alarms", at_most(int(warned[right]), int(scores.size()[right]))
    without, given = held.loc[("stiffening", "plain")], held.loc[("stiffening", "discrepancy")]
    said = {"wide": given["held"], "width": 100 * given["width"], "impacts": given["impacts"]}
    yield "sentence", said | {"without": without["held"]}
