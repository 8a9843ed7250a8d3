"""Whether what a finished fit answers holds what it promises."""

from __future__ import annotations

import itertools

import numpy as np
import pandas as pd

from evidence.texts import Figure, Named, binomial_error, block, family, names, raw, table, with_error

# Of probabilities, in which claims are counted together.
BINS = (0.0, 0.05, 0.2, 0.4, 0.6, 0.8, 0.95, 1.0)


@family
def calibration_answers() -> Named:
    lines = shares(raw("calibration_answers"))
    own = lines["which"] != "all"
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
    text = f"{len(held)} intervals of 90 % held {held.mean():.1f} %"
    yield "short", Figure(text, names("calibration_answers"))


def shares(found: pd.DataFrame) -> pd.DataFrame:
    """A row a quantity, and one for claims of like probability; shares and probabilities in percent.

    ``held`` is the share of 90 % intervals that hold the truth, with the truth below and above the others;
    ``probability`` is the mean one of a claim, ``true`` the share of it that is true, and ``prior`` its mean
    prior probability. ``se`` is the standard error of ``held`` or ``true`` between studies, whose claims and
    intervals are not independent.
    """
    by_kind: dict[str, list[str]] = {}
    lines = []
    for column in found.columns.drop(["unit", "data_set", "rhat", "each"]):
        kind, which, what = column.split("|")
        if what == "interval":
            by_kind.setdefault(kind, []).append(column)
            lines.append({"kind": kind, "which": which, **_held(found[[column]])})
        elif what == "p":
            of_prior = found.get(f"{kind}|{which}|prior")
            prior = {} if of_prior is None else {"prior": 100 * of_prior.mean()}
            told = _true(found[[column]].to_numpy(), found[[f"{kind}|{which}|true"]].to_numpy())
            lines.append({"kind": kind, "which": which, **told, **prior})
    lines += [{"kind": kind, "which": "all", **_held(found[own])} for kind, own in by_kind.items()]
    names = [column[:-2] for column in found.columns if column.endswith("|p")]
    p, true = (found[[f"{name}|{what}" for name in names]].to_numpy() for what in ("p", "true"))
    for low, high in itertools.pairwise(BINS):
        inside = (p >= low) & ((p < high) | (high == BINS[-1]))
        told = _true(np.where(inside, p, np.nan), np.where(inside, true, np.nan))
        lines.append({"kind": "claims of probability", "which": f"{low:g} to {high:g}", **told})
    return pd.DataFrame(lines).assign(studies=len(found)).round(2)


def _held(sides: pd.DataFrame) -> dict[str, float]:
    held = (sides == 0).mean(axis=1)
    below, above = ((sides * sign > 0).to_numpy().mean() for sign in (-1, 1))
    found = {"held": held.mean(), "below": below, "above": above}
    return {name: 100 * float(share) for name, share in found.items()} | {
        "se": 100 * float(held.std(ddof=1) / np.sqrt(len(held))),
        "answers": sides.size,
    }


def _true(p: np.ndarray, true: np.ndarray) -> dict[str, float]:
    """Of claims by study, NaN where a claim does not count."""
    count = int(np.isfinite(p).sum())
    off = np.nansum(true - p, axis=1)
    return {
        "probability": 100 * float(np.nanmean(p)),
        "true": 100 * float(np.nanmean(true)),
        "se": 100 * float(off.std(ddof=1) * np.sqrt(len(off)) / count),
        "answers": count,
    }


@family
def plan_assurance() -> Named:
    rows = raw("plan_assurance")
    by_plan, studies = rows[rows["share"].notna()], rows[rows["study"].notna()]
    p, true, level = studies["posterior"], studies["truth"].astype(bool), by_plan["probability"].iloc[0]
    yes, no = p > level, p < 1 - level
    by_fits = pd.DataFrame(
        {"yes": yes, "no": no, "misleads": (yes & ~true) | (no & true), "answers": yes | no}
    )
    groups = by_fits.groupby(studies["case"], sort=False)
    share, count = groups.mean(), groups.size()
    plan = by_plan.pivot_table("by_plan", "case", "share", sort=False).loc[share.index]
    plan = plan.assign(answers=plan["yes"] + plan["no"])[share.columns]
    # A share of none or of all is not known exactly.
    least = share.clip(1 / count.max(), 1 - 1 / count.max())
    number = count.to_numpy()[:, None]
    error = binomial_error(least, number)
    of_plan = binomial_error(plan, by_plan["studies"].max())
    # Under what the plan says: the error of a share of few studies says little.
    differ = (share - plan) / np.hypot(binomial_error(plan, number), of_plan)
    shown = pd.DataFrame({"design": share.index, "studies": count.to_numpy()})
    shown["without an answer"] = p.isna().groupby(studies["case"], sort=False).sum().to_numpy()
    for name, words in (("yes", "answered yes"), ("no", "no"), ("misleads", "misled")):
        shown[f"{words}, by plan"] = with_error(plan[name], of_plan[name])
        shown[f"{words}, by fits"] = with_error(share[name], error[name])
    yield "table", block(table(shown), "plan_assurance")
    answered, off = differ[["yes", "no"]].abs().to_numpy(), 100 * (share - plan)["answers"].mean()
    off_error = 100 * float(np.sqrt((error**2 + of_plan**2)["answers"].sum())) / len(share)
    text = (
        f"in {len(share)} designs of {count.min()} simulated studies each, {(answered <= 2).sum()} of "
        f"{answered.size} shares of answers agree with a plan's within two standard errors, all within "
        f"{answered.max():.1f}; over all designs the share that fits answer is {off:+.0f} ± {off_error:.0f} "
        "percentage points from the plan's"
    )
    yield "sentence", Figure(text, names("plan_assurance"))
    text = f"{(answered <= 2).sum()} of {answered.size} shares agree within two standard errors"
    yield "short", Figure(text, names("plan_assurance"))


@family
def plan_after() -> Named:
    rows = raw("plan_after").set_index("way")
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
