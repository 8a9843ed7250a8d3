"""What the stacking weights of a comparison imply, in a table and in words."""

from __future__ import annotations

from typing import Any

import pandas as pd

from bayestissue.report.posterior import SECANTS
from bayestissue.report.tables import Row, Table, columns
from bayestissue.report.wording import interval, listed, significant

TYPICAL = {"K": "K_secant_typical", "C": "C_equivalent_typical"}
WORDS = {
    "mass_exponent_K": "mass exponent of K",
    "mass_exponent_C": "mass exponent of C",
    **{f"mass_exponent_{name}": f"mass exponent of {words}" for name, words in SECANTS.items()},
    "K_new": "K, new impact on a new person",
    "C_new": "C, new impact on a new person",
    "K_subject": "K of",
    "C_subject": "C of",
    "K_secant_typical": "K (secant) of the recorded impacts",
    "C_equivalent_typical": "C (equivalent) of the recorded impacts",
    "K_secant_of_subject": "K (secant) of the impacts of",
    "C_equivalent_of_subject": "C (equivalent) of the impacts of",
}


def same_element(runs: list[dict[str, Any]]) -> bool:
    """Whether K and C are the same things in all runs: those of one mechanical element."""
    return len({run["model"].get("element", "kelvin_voigt") for run in runs}) == 1


def weighted_words(implied: pd.DataFrame) -> list[str]:
    """K and C of the recorded impacts under the weights of each scheme, a sentence a kind of data."""
    sentences = []
    many = len(implied["data"].unique()) > 1
    for (scheme, data), rows in implied.groupby(["scheme", "data"], sort=False):
        by_name = rows[rows["label"] == ""].set_index("variable").to_dict("index")
        told = [
            f"{q} = {significant(row['median'])} {row['unit']} "
            f"({interval(row['eti90_low'], row['eti90_high'])})"
            for q, name in TYPICAL.items()
            if (row := by_name.get(name)) is not None
        ]
        several = f", densities of {data}" if many else ""
        kind = str(scheme).removeprefix("leave one ").removesuffix(" out")
        if told:
            sentences.append(f"Weighted by how well each {kind} is predicted{several}: {listed(told)}.")
    return sentences


def implied_table(implied: pd.DataFrame) -> Table:
    """Every row of `implied.csv`."""
    rows = [
        Row(
            (
                f"{WORDS.get(row['variable'], row['variable'])} {row['label']}".strip(),
                row["scheme"].removeprefix("leave one ").removesuffix(" out"),
                row["data"],
                significant(row["median"]),
                interval(row["eti90_low"], row["eti90_high"]),
                row["unit"],
            )
        )
        for row in implied.to_dict("records")
    ]
    titles = ("quantity", "weights by", "density of", "median", "90 % interval", "unit")
    return Table(columns(*titles, number=("median", "90 % interval")), rows)
