"""Whether what a finished fit answers holds what it promises."""

from __future__ import annotations

import numpy as np
import pandas as pd

from evidence.texts import Figure, Named, block, family, names, read, table, with_error


@family
def calibration_answers() -> Named:
    lines = read("calibration_answers.csv")
    own = lines["which"] != "all"
    if own.all():
        # A table of an earlier layout, or of no whole block of studies yet.
        return
    rows = []
    for kind, part in lines[own].dropna(subset="held").groupby("kind", sort=False):
        pooled = lines[~own & (lines["kind"] == kind)].iloc[0]
        least, most = (part.loc[place] for place in (part["held"].idxmin(), part["held"].idxmax()))
        row = {"90 % intervals": kind, "quantities": len(part)}
        row["held"] = with_error(*(pooled[[name]] / 100 for name in ("held", "se")))[0]
        row |= {"least": f"{least['held']:.1f} %, {least['which'].strip()}"}
        row |= {"most": f"{most['held']:.1f} %, {most['which'].strip()}"}
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
        f"{held.min():.1f} to {held.max():.1f} %, {held.mean():.1f} % in the mean; of claims given a "
        f"probability of 80 to 95 % {claims['true'].iloc[-2]:.0f} % were true"
    )
    yield "sentence", Figure(text, names("calibration_answers"))


@family
def plan_assurance() -> Named:
    rows = read("plan_assurance.csv")
    shares = rows.assign(
        plan=with_error(rows["by_plan"], rows["by_plan_se"]),
        fits=with_error(rows["by_fits"], rows["by_fits_se"]),
    )
    wide = shares.pivot_table(index="case", columns="share", values=["plan", "fits"], aggfunc="first")
    order = rows["case"].unique()
    columns = {
        f"{words}, by {way}": wide[source, share].reindex(order).to_numpy()
        for share, words in (("yes", "answered yes"), ("no", "no"), ("misleads", "misled"))
        for way, source in (("plan", "plan"), ("fits", "fits"))
    }
    studies = rows.groupby("case")["studies"].first().reindex(order).to_numpy()
    refused = rows.groupby("case")["refused"].first().reindex(order).to_numpy()
    table_of = pd.DataFrame({"design": order, "studies": studies, "without an answer": refused, **columns})
    yield "table", block(table(table_of), "plan_assurance")
    answered = rows[rows["share"] != "misleads"]
    differ = answered["differ_by_se"].abs()
    text = (
        f"in {len(order)} designs of {int(rows['studies'].min())} simulated studies each, "
        f"{int((differ <= 2).sum())} of {len(differ)} shares of answers agree with a plan's within two "
        f"standard errors, all within {differ.max():.1f}"
    )
    yield "sentence", Figure(text, names("plan_assurance"))


@family
def plan_after() -> Named:
    rows = read("plan_after.csv").set_index("way")
    thesis, plan = rows.loc["thesis"], rows.loc["plan"]

    def with_se(row: pd.Series, name: str) -> str:
        return f"{row[name]:.1f} ± {row[f'{name}_se']:.1f}"

    table_of = pd.DataFrame(
        {
            "goes on": ["in the thesis's order of masses", "by the plan"],
            "drops": [with_se(row, "drops") for row in (thesis, plan)],
            "answered": [f"{row['answered']:.0f} of {row['studies']:.0f}" for row in (thesis, plan)],
            "of these wrongly": [f"{row['wrong']:.0f}" for row in (thesis, plan)],
        }
    )
    yield "table", block(table(table_of), "plan_after")
    text = (
        f"in {plan['studies']:.0f} simulated running studies the plan's choice of the next mass saves "
        f"{with_se(plan, 'saving')} of the {thesis['drops']:.1f} drops that the thesis's order of masses "
        f"takes ({with_se(plan, 'saving_of_those')} where both ways end with an answer)"
    )
    yield "sentence", Figure(text, names("plan_after"))
    check = (
        f"of {plan['fits']:.0f} of the studies, where they ended, fits of the traces gave the question "
        f"probabilities within {max(thesis['largest_difference'], plan['largest_difference']):.3f} of these"
    )
    yield "check", Figure(check, names("plan_after"))
