"""What the program is held against from outside and by laws, and where it runs."""

from __future__ import annotations

import pandas as pd

from evidence.texts import Named, percent, power_of_ten

# Of itself a number that is printed to ten digits or more may be off by less than this.
_EXACT = 1e-9
# No power of ten from here on.
_LARGE = 0.05


def published(rows: pd.DataFrame) -> Named:
    size = rows["difference"].abs()
    share = size / rows["allowed"]
    groups = rows.assign(size=size, share=share).groupby("unit", sort=False)
    shown = pd.DataFrame(
        {
            "numbers": groups.size(),
            "largest difference": groups["size"].max().map(_or_none),
            "of what is allowed": groups["share"].max().map(lambda value: percent(value, 0)),
        }
    )
    yield "table", shown.rename_axis("published").reset_index()
    exact = rows["allowed"] < _EXACT * rows["published"].abs()
    apart = power_of_ten((size / rows["published"].abs())[exact].max())
    said = {"within": (share <= 1).sum(), "numbers": len(rows), "sources": len(groups), "apart": apart}
    yield "sentence", said
    yield "short", said


def laws(rows: pd.DataFrame) -> Named:
    # A test without drawn cases is one case.
    cases = rows["examples_passed"].fillna(1).sum() + rows["examples_failed"].fillna(0).sum()
    failed = (rows["state"] != "passed").sum()
    yield "sentence", {"tests": len(rows), "failed": failed, "cases": int(cases)}


def selftest(rows: pd.DataFrame) -> Named:
    row = rows.assign(passed=rows["checks"] - rows["failed"]).iloc[0].to_dict()
    yield "sentence", row
    yield "short", row


def certificate(rows: pd.DataFrame) -> Named:
    first, lines = rows.iloc[0], rows.set_index("quantity")
    held = {q: lines.loc[f"{q} of drawn impacts", ["held", "held_se"]].map(percent) for q in "KC"}
    said = {"refits": first["refits"], "minutes": first["seconds"] / 60, "quantities": len(rows)}
    said["uneven"] = (rows["passed"] == 0).sum()
    yield "sentence", said | {q: " ± ".join(each) for q, each in held.items()}


def _or_none(value: float) -> str:
    """A power of ten, 0, or a number of its own size."""
    return f"{value:.1f}" if value >= _LARGE else power_of_ten(value) if value else "0"
