"""Whether what a finished fit answers holds what it promises."""

from __future__ import annotations

import tomllib

import numpy as np
import pandas as pd

from evidence.registry import ROOT
from evidence.texts import Named, binomial_error, by_probability, of, of_bins, with_error


def calibration_answers(rows: pd.DataFrame) -> Named:
    lines = shares(rows)
    own, shown = lines["which"] != "all", []
    for kind, part in lines[own].dropna(subset="held").groupby("kind", sort=False):
        pooled = lines[~own & (lines["kind"] == kind)][["held", "se"]] / 100
        ends = {"least": part.loc[part["held"].idxmin()], "most": part.loc[part["held"].idxmax()]}
        row = {"90 % intervals": kind, "quantities": len(part)}
        row["held"] = with_error(pooled["held"], pooled["se"])[0]
        shown.append(row | {end: f"{one['held']:.1f} %, {one['which'].strip()}" for end, one in ends.items()})
    yield "intervals", pd.DataFrame(shown)
    pairs = [rows.filter(regex=rf"\|{what}$").to_numpy(float) for what in ("p", "true")]
    bins = by_probability(*pairs)
    yield "claims", of_bins(bins, "claims of probability", "claims", "true")
    prior = lines.dropna(subset="prior")
    error = 100 * binomial_error(prior["prior"] / 100, prior["studies"])
    yield "priors", {"claims": len(prior), "off": ((prior["true"] - prior["prior"]) / error).abs().max()}
    held = lines[own]["held"].dropna()
    said = {"studies": lines["studies"].max(), "intervals": len(held), "least": held.min()}
    said |= {"most": held.max(), "mean": held.mean(), "sure": 100 * bins["share"].iloc[-2]}
    yield "sentence", said
    yield "short", said


def shares(found: pd.DataFrame) -> pd.DataFrame:
    """A row an answer, and one for all of a kind; shares and probabilities in percent.

    ``held`` is the share of 90 % intervals that hold the truth and ``se`` its standard error between studies,
    whose intervals are not independent; ``true`` is the share of studies in which a claim is true, and
    ``prior`` its mean prior probability.
    """
    by_kind: dict[str, list[str]] = {}
    lines = []
    for column in found.filter(regex=r"\|(?:interval|prior)$"):
        kind, which, what = column.split("|")  # type: ignore[attr-defined]
        if what == "interval":
            by_kind.setdefault(kind, []).append(column)
            lines.append({"kind": kind, "which": which, **_held(found[[column]])})
        else:
            means = {what: 100 * found[f"{kind}|{which}|{what}"].mean() for what in ("prior", "true")}
            lines.append({"kind": kind, "which": which, **means})
    lines += [{"kind": kind, "which": "all", **_held(found[own])} for kind, own in by_kind.items()]
    return pd.DataFrame(lines).assign(studies=len(found)).round(2)


def _held(sides: pd.DataFrame) -> dict[str, float]:
    held = (sides == 0).mean(axis=1)
    return {"held": 100 * held.mean(), "se": 100 * held.sem()}


def plan_assurance(rows: pd.DataFrame) -> Named:
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
    yield "table", shown
    answered = differ[["yes", "no"]].abs().to_numpy()
    said = {"designs": len(share), "studies": count.min(), "shares": answered.size}
    said |= {"agree": (answered <= 2).sum(), "most": answered.max()}
    said["off"] = 100 * (share - plan)["answers"].mean()
    said["off_error"] = 100 * float(np.sqrt((error**2 + of_plan**2)["answers"].sum())) / len(share)
    yield "sentence", said
    yield "short", said


def plan_after(rows: pd.DataFrame) -> Named:
    question = tomllib.loads((ROOT / "models" / "plan-thesis.toml").read_text(encoding="utf-8"))["questions"]
    least = float(next(iter(question.values())).rpartition("<")[2])
    true = (rows["exponent"] < least).map({True: "yes", False: "no"})
    off = (rows["by_fit"] - rows["posterior"]).abs()
    answered = rows["answer"].notna()
    wrong = answered & (rows["answer"] != true)
    lines = rows.assign(answered=answered, wrong=wrong, off=off).groupby("way")
    sums, drops = lines[["answered", "wrong"]].sum(), lines["drops"].agg(["mean", "sem", "size"])
    ways = {"thesis": "in the thesis's order of masses", "plan": "by the plan"}
    shown = pd.DataFrame(
        {
            "goes on": ways,
            "drops": drops["mean"].map("{:.1f}".format) + " ± " + drops["sem"].map("{:.1f}".format),
            "answered": of(sums["answered"], drops["size"]),
            "of these wrongly": sums["wrong"].astype(str),
        }
    )
    yield "table", shown.loc[[*ways]]
    by_way = rows.pivot_table("drops", "unit", "way")
    saved = by_way["thesis"] - by_way["plan"]
    of_both = saved[answered.groupby(rows["unit"]).all()]
    said = {"studies": len(saved), "saving": saved.mean(), "saving_se": saved.sem()}
    said |= {"saving_of_those": of_both.mean(), "saving_of_those_se": of_both.sem()}
    yield "sentence", said | {"drops_of_thesis": drops.loc["thesis", "mean"]}
    yield "check", {"fits": lines["by_fit"].count()["plan"], "apart": off.max()}
