"""What the stacking weights of a comparison imply, in a table and in words."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pandas as pd

from bayestissue.inference.results.meanings import meaning, told
from bayestissue.report.tables import Field, Table, table_of
from bayestissue.report.wording import interval, listed, significant

OF_IMPACTS = {"K": "K_secant_of_impacts", "C": "C_equivalent_of_impacts"}


def same_element(runs: list[dict[str, Any]]) -> bool:
    """Whether K and C are the same things in all runs: those of one mechanical element."""
    return len({run["model"].get("element", "kelvin_voigt") for run in runs}) == 1


def quantity(row: Mapping[Any, Any]) -> str:
    """What a row of `posteriors.csv` or `implied.csv` has the interval of."""
    return told(row["variable"], row["of"], row["label"])


def what_is_left_out(scheme: str) -> str:
    """One of what a scheme leaves out, such as "subject"."""
    return scheme.removeprefix("leave one ").removesuffix(" out")


def weighted_words(implied: pd.DataFrame) -> list[str]:
    """K and C of the recorded impacts under the weights of each scheme, a sentence a kind of data."""
    sentences = []
    many = len(implied["data"].unique()) > 1
    for (scheme, data), rows in implied.groupby(["scheme", "data"], sort=False):
        by_name = rows[rows["label"] == ""].set_index("variable").to_dict("index")
        parts = [
            f"{meaning(name).what} = {significant(row['median'])} {row['unit']} "
            f"({interval(row['eti90_low'], row['eti90_high'])})"
            for q, name in OF_IMPACTS.items()
            if (row := by_name.get(name)) is not None
        ]
        several = f", densities of {data}" if many else ""
        kind = what_is_left_out(str(scheme))
        if parts:
            sentences.append(
                f"Of {meaning(OF_IMPACTS['K']).of}, weighted by how well each {kind} is predicted{several}: "
                f"{listed(parts)}."
            )
    return sentences


def implied_table(implied: pd.DataFrame) -> Table:
    """Every row of `implied.csv`."""
    return table_of(
        implied.to_dict("records"),
        Field("quantity", quantity),
        Field("weights by", lambda row: what_is_left_out(row["scheme"])),
        Field("density of", lambda row: row["data"]),
        Field("median", lambda row: significant(row["median"]), "number"),
        Field("90 % interval", lambda row: interval(row["eti90_low"], row["eti90_high"]), "number"),
        Field("unit", lambda row: row["unit"]),
    )
