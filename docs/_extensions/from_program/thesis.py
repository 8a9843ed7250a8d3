"""What the finished reports of the thesis's numbers say, from the tables of `docs/reports/`."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from from_program.markdown import code, escaped, table

REPORTS = Path(__file__).resolve().parents[2] / "reports"


def exponents() -> str:
    """Both mass exponents, with the probability of each hypothesis."""
    summary, hypotheses = (_read("published", name) for name in ("summary", "hypotheses"))
    rows = []
    for q in ("K", "C"):
        found = summary[summary["variable"] == f"mass_exponent_{q}"].iloc[0]
        own = hypotheses[hypotheses["quantity"] == q].set_index("hypothesis")["probability"]
        rows.append(
            (
                q,
                f"{found['median']:#.3g}",
                f"{found['eti90_low']:#.3g} to {found['eti90_high']:#.3g}",
                _probability(own["fixed stiffness"]),
                _probability(own["constant natural frequency"]),
            )
        )
    return table(
        ["of", "median", "90 % interval", "probability of 0 in practice", "probability of 1 in practice"],
        rows,
        stacked=False,
    )


def recomputed() -> str:
    """How many published numbers can be recomputed, and how many of these agree."""
    found = _read("published", "reproduction")
    agrees = found["agrees"].astype(str)
    return (
        f"Of {len(found)} published numbers {found['reproduced'].notna().sum()} can be recomputed. "
        f"{(agrees == 'True').sum()} of them agree, {(agrees == 'False').sum()} do not and "
        f"{(found['reproduced'].notna() & ~agrees.isin(['True', 'False'])).sum()} can't be compared."
    )


def audit() -> str:
    """The findings of the audit that matter most."""
    found = _read("published", "audit")
    names = ["what", "published", "implied", "explanation"]
    worst = found.loc[found["severity"] == "major", names]
    return table(
        ["what", "published", "what follows from the other numbers", "why it matters"],
        [tuple(map(escaped, row)) for row in worst.itertuples(index=False)],
    )


def causes() -> str:
    """Each proposed cause with its p value and probability."""
    found = _read("causes", "causes").sort_values("probability", ascending=False)
    rows = [
        (escaped(each.title), _probability(each.p_joint), _probability(each.probability), code(each.verdict))
        for each in found.itertuples()
    ]
    return table(["cause", "p value", "posterior probability", "verdict"], rows, stacked=False)


def _read(run: str, name: str) -> pd.DataFrame:
    return pd.read_csv(REPORTS / run / f"{name}.csv")


def _probability(value: float) -> str:
    if value < 0.001:
        return "below 0.001"
    return "above 0.999" if value > 0.999 else f"{value:.2g}"
