"""Can the draws be trusted? Each check has a limit, a meaning and a next step; together a verdict."""

from __future__ import annotations

import re
from collections.abc import Collection
from dataclasses import asdict, dataclass
from typing import Any, Self

import numpy as np
import pandas as pd

from bayestissue.declarations import declared
from bayestissue.errors import Coded
from bayestissue.inference.samplers.convergence import let_pass
from bayestissue.remedies import Code, codes_in

R_HAT_LIMIT = 1.01
ESS_LIMIT = 400
_DECLARED = declared(__package__, "checks.toml")
# What is said of single recordings, by the keys of a fit's diagnostics.
OF_RECORDINGS = ("another_element", "recordings", "clipped", "channels", "reference", "added_mass")
# Notes of a summary's rows.
NO_INTERVAL = Coded.stated("undescribed")
CONTRADICTED = Coded.stated("measuring-chain")
FORCE_CONTRADICTS = Coded.stated("channels-disagree.size")
FORCE_OTHER_LAW = Coded.stated("force-form")
PEAK_MISSED = Coded.stated("peak-missed")
UNSETTLED = Coded.stated("r-hat")
ELEMENT_ALONE = Coded.stated("element-alone")
# Variables of K, of which those of element and discrepancy together are none.
_OF_K = re.compile(r"K(_(?!secant|common_depth).*)?|.*_K")


@dataclass(frozen=True)
class Check:
    """One diagnostic of a sampler's run."""

    name: str
    value: float
    limit: str
    passed: bool
    meaning: str
    next_step: str
    code: Code

    @classmethod
    def stated(
        cls, code: Code, value: float, limit: float = 0.0, *, part: str = "", **numbers: object
    ) -> Self:
        """The check of this code in ``checks.toml``, passed where the value is on the side that it names.

        Args:
            code: of the warning where it fails.
            value: of the diagnostic.
            limit: which it is to be below or above; of a count that is to be none there is none.
            part: which check it is, where several have the code.
            numbers: by their names in the sentences.
        """
        texts = _DECLARED[code][part] if part else _DECLARED[code]
        words = {name: sentence.format(limit=limit, **numbers) for name, sentence in texts.items()}
        passed = {"below": value < limit, "above": value > limit, "none": value == 0}
        side = words["limit"].partition(" ")[0]
        return cls(value=value, passed=bool(passed[side]), code=code, **words)


def diagnose(
    summary: pd.DataFrame,
    r_hat_limit: float = R_HAT_LIMIT,
    of_impacts: Collection[str] = (),
    unasked: Collection[str] = (),
) -> dict[str, Any]:
    """The verdict on a run, as it is written to ``diagnostics.json``.

    R̂ and bulk and tail effective sample sizes are rank-normalised (Vehtari et al. 2021,
    doi:10.1214/20-BA1221), the worst over every reported quantity.

    Args:
        summary: as `inference.results.summary.summarise` makes it; what it leaves open is not judged.
        r_hat_limit: what the greatest R-hat is to be below.
        of_impacts: the variables of single impacts, of which some may be above that limit: see `let_pass`.
        unasked: those that follow from others and that nobody asked for. They fail no fit: what of them is
            beyond a limit is not judged.

    Returns:
        ``passed``, ``checks``, ``worst`` by statistic, and ``cause``: what the chains lack most of, in words;
        where there are some, what is ``unsettled`` and not judged.
    """
    sizes = summary[["ess_bulk", "ess_tail"]].min(axis=1)
    beyond = (summary["r_hat"] >= r_hat_limit) | (sizes <= ESS_LIMIT)
    unsettled = beyond & summary["variable"].isin(list(unasked))
    not_judged = [_named(row) for _, row in summary[unsettled].iterrows()]
    summary = summary[~unsettled]
    judged, single = np.ones(len(summary), bool), summary["variable"].isin(list(of_impacts)).to_numpy()
    judged[single] = ~let_pass(summary["r_hat"].to_numpy(float)[single], r_hat_limit)
    worst = {column: _worst(summary, column) for column in ("r_hat", "ess_bulk", "ess_tail")}
    checks = [
        Check.stated("r-hat", limit=r_hat_limit, **_worst(summary[judged], "r_hat")),
        Check.stated("effective-sample-size", limit=ESS_LIMIT, part="bulk", **worst["ess_bulk"]),
        Check.stated("effective-sample-size", limit=ESS_LIMIT, part="tail", **worst["ess_tail"]),
    ]
    passed = all(check.passed for check in checks)
    return {
        "passed": passed,
        "checks": [asdict(check) for check in checks],
        "worst": worst,
        "cause": "" if passed else _cause(summary[judged], r_hat_limit, of_impacts),
        **({"unsettled": not_judged} if not_judged else {}),
    }


def more_would_help(diagnostics: dict[str, Any], *, thinned: bool, effective: int) -> bool:
    """Whether a check fails that a longer run passes.

    Args:
        diagnostics: of `diagnose`.
        thinned: whether not all draws were kept, to whose number effective sizes are then bound.
        effective: how many effective draws were asked for; of fewer than the verdict wants, no more are made.
    """
    failed = {check["code"] for check in diagnostics["checks"] if not check["passed"]}
    return "r-hat" in failed or (bool(failed) and not thinned and effective >= ESS_LIMIT)


def warnings(diagnostics: dict[str, Any]) -> list[Coded]:
    """What the model or its data leave in doubt, whatever the sampler did; the measuring chain first."""
    chain, form = diagnostics.get("measuring_chain", {}), diagnostics.get("model_form", {})
    lines, velocity = diagnostics.get("straight_lines", {}), _velocity(diagnostics)
    force, reference = diagnostics.get("channels", {}), diagnostics.get("reference", {})
    peaks, added = diagnostics.get("recorded_peak", {}), diagnostics.get("added_mass", {})
    law: Code = "undescribed" if form.get("undescribed") else "model-form"
    if not _against_all(form):
        law = "structured-residuals"
    doubts: list[tuple[dict[str, Any], bool, Code]] = [
        (chain, chain.get("passed") is False, "measuring-chain"),
        (force, force.get("passed") is False, _of_force(force)),
        (reference, reference.get("passed") is False, "reference-contradicted"),
        ({"words": velocity}, bool(velocity), "velocity-contradicted"),
        (form, _against_all(form) or _against_some(form), law),
        (peaks, bool(peaks), "peak-missed"),
        (lines, bool(lines.get("words")), "no-straight-line"),
        (added, added.get("passed") is False, "prior-sensitive"),
    ]
    pooled = [
        Coded(parameter["words"], "pooled-parameter")
        for parameter in diagnostics.get("pooled_parameters", [])
    ]
    return [Coded(entry["words"], code) for entry, raised, code in doubts if raised] + pooled


def _of_force(force: dict[str, Any]) -> Code:
    """The entry that explains what is wrong with a force: its size before its form."""
    return "channels-disagree" if force.get("agrees") is False else "force-form"


def warned_codes(diagnostics: dict[str, Any]) -> list[Code]:
    """The entries that explain what `verdict_in_words` warns of, failed checks first."""
    failed = [check["code"] for check in diagnostics["checks"] if not check["passed"] and "code" in check]
    codes = [*failed, *(warning.code for warning in warnings(diagnostics))]
    return list(dict.fromkeys([*codes, *flagged_codes(diagnostics)]))


def flagged_codes(diagnostics: dict[str, Any]) -> list[Code]:
    """The entries of the flags of recordings, that of flagged recordings first; empty where none is."""
    flagged = diagnostics.get("recordings", {}).get("flagged", {})
    named = codes_in("; ".join(flag for flags in flagged.values() for flag in flags))
    return ["flagged-recordings", *named] if flagged else []


def of_element_alone(variable: str) -> bool:
    """Whether beside a discrepancy a variable is of the element's own K, which is not the tissue's."""
    return _OF_K.fullmatch(variable) is not None


def noted(summary: pd.DataFrame, diagnostics: dict[str, Any]) -> pd.DataFrame:
    """The summary with a column ``note``: why a row's interval is none, empty where it is one.

    Rows are marked by impact, and every row where all impacts are concerned. Beside a discrepancy those of
    K say that they are the element's own.
    """
    chain, form = diagnostics.get("measuring_chain", {}), diagnostics.get("model_form", {})
    all_rows, label = np.ones(len(summary), bool), summary["label"].astype(str)
    note = np.full(len(summary), "", dtype=object)
    if unsettled := set(diagnostics.get("unsettled", ())):
        note[[_named(row) in unsettled for _, row in summary.iterrows()]] = UNSETTLED
    if "discrepancy" in form:
        note[summary["variable"].map(of_element_alone)] = ELEMENT_ALONE
    if peaks := diagnostics.get("recorded_peak"):
        note[label.isin(peaks["impacts"])] = PEAK_MISSED
    if (force := diagnostics.get("channels", {})).get("passed") is False:
        # An impact's own mass is put right where one factor is not.
        exponents = summary["variable"].str.startswith("mass_exponent").to_numpy(bool)
        words = FORCE_CONTRADICTS if force["agrees"] is False else FORCE_OTHER_LAW
        note[exponents if force["slope"] and force["follows"] else all_rows] = words
    if chain.get("passed") is False:
        whole = len(chain["impacts"]) == chain["of"]
        note[all_rows if whole else label.isin(chain["impacts"])] = CONTRADICTED
    undescribed = all_rows if form.get("undescribed") else label.isin(form.get("undescribed_impacts", []))
    note[undescribed] = NO_INTERVAL
    return summary.assign(note=note)


def headline(diagnostics: dict[str, Any]) -> str:
    """The verdict in one short sentence, for whoever reads no further."""
    chain, form = diagnostics.get("measuring_chain", {}), diagnostics.get("model_form", {})
    if not diagnostics["passed"]:
        return "DIAGNOSTICS FAILED: do not use these numbers."
    if form.get("undescribed"):
        return "No element of this program describes these traces: there are no intervals of K and C."
    if chain.get("passed") is False:
        return "The sampler passed, but the traces contradict the measuring chain."
    force, reference = diagnostics.get("channels", {}), diagnostics.get("reference", {})
    for account in (force, reference):
        if account.get("passed") is False:
            return f"The sampler passed, but {account['first']}."
    if _velocity(diagnostics):
        return "The sampler passed, but the recordings imply another velocity at contact than was stated."
    if form.get("structured"):
        return "The sampler passed, but the traces obey another law than the model's."
    if peaks := diagnostics.get("recorded_peak"):
        count = f"{len(peaks['impacts'])} of {peaks['of']} impacts"
        return f"The sampler passed, but the recorded peak of {count} is outside its interval."
    if _against_some(form):
        return "The sampler passed, but the residuals have structure that the model does not explain."
    if diagnostics.get("straight_lines", {}).get("words"):
        return "Diagnostics passed, but a column of few whole numbers counts as a straight line."
    if diagnostics.get("pooled_parameters"):
        return "Diagnostics passed, but a parameter that differs between levels is taken as alike."
    added = diagnostics.get("added_mass", {})
    if added.get("passed") is False:
        return f"Diagnostics passed, but {added['first']}."
    for account in (force, reference, added):
        if account.get("first"):
            return f"Diagnostics passed; {account['first']}."
    return "Diagnostics passed."


def verdict_in_words(diagnostics: dict[str, Any]) -> str:
    """Whether the run can be trusted, in a sentence; and where the model can't, in another."""
    warning = "".join(f" WARNING: {words}" for words in warnings(diagnostics))
    for key in OF_RECORDINGS:
        # What warns was said.
        if key in diagnostics and diagnostics[key].get("passed") is not False:
            warning += f" {diagnostics[key]['words']}"
    failed = [check["name"] for check in diagnostics["checks"] if not check["passed"]]
    if not failed:
        worst = diagnostics["worst"]
        size = min(worst["ess_bulk"]["value"], worst["ess_tail"]["value"])
        r_hat = worst["r_hat"]["value"]
        return f"R-hat at most {r_hat:.4f}, effective sample sizes at least {size:.0f}.{warning}"
    # Chains are slow where model and traces are at odds.
    why = f" {diagnostics['cause']}" if diagnostics.get("cause") else ""
    why += " The reason may be what the warning says." if warnings(diagnostics) else ""
    return f"Failed: {', '.join(failed)}. Do not use these numbers yet.{why}{warning}"


def _velocity(diagnostics: dict[str, Any]) -> str:
    """What recordings say against the stated velocity, in words; empty where the measuring chain has it."""
    contradicted = diagnostics.get("measuring_chain", {}).get("passed") is False
    return "" if contradicted else diagnostics.get("recordings", {}).get("velocity", "")


def _against_all(form: dict[str, Any]) -> bool:
    """Whether all impacts together speak against the model."""
    return bool(form.get("structured") or form.get("undescribed"))


def _against_some(form: dict[str, Any]) -> bool:
    """Whether too many impacts, each by itself, do."""
    return bool(form.get("impacts", {}).get("structured"))


def _cause(summary: pd.DataFrame, r_hat_limit: float, of_impacts: Collection[str]) -> str:
    """The quantity whose chains lack most, in a sentence, and what to do about it in another."""
    size = summary[["ess_bulk", "ess_tail"]].to_numpy(float).min(axis=1)
    of_r_hat = (summary["r_hat"].to_numpy(float) - 1) / (r_hat_limit - 1)
    lacking = np.fmax(of_r_hat, ESS_LIMIT / size)
    row = summary.iloc[int(np.nanargmax(lacking))]
    kind = "impact" if row["variable"] in of_impacts else "population"
    numbers = {
        "impact": row["label"],
        "variable": _named(row),
        "r_hat": row["r_hat"],
        "effective": row[["ess_bulk", "ess_tail"]].min(),
    }
    return str(_DECLARED["cause"][kind].format(**numbers))


def _worst(summary: pd.DataFrame, column: str) -> dict[str, Any]:
    """The greatest R-hat, or the least sample size, and the variable that has it."""
    values = summary[column].to_numpy(float)
    row = int(np.nanargmax(values) if column == "r_hat" else np.nanargmin(values))
    return {"variable": _named(summary.iloc[row]), "value": float(values[row])}


def _named(row: pd.Series) -> str:
    """A row of the summary in words, such as "K of impact_7"."""
    return f"{row['variable']} of {row['label']}" if row["label"] else str(row["variable"])
