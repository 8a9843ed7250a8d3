"""A figure of the documentation, and how numbers and tables are written."""

from __future__ import annotations

import itertools
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy import stats

from evidence.registry import of_family

# Of intervals, and the quantiles at their ends.
LEVELS = {50: ("q25", "q75"), 90: ("q05", "q95")}
# Of probabilities, in which claims are counted together.
BINS = (0.0, 0.05, 0.2, 0.4, 0.6, 0.8, 0.95, 1.0)
_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


@dataclass(frozen=True)
class Figure:
    """A text of the documentation."""

    text: str
    # Tables and paragraphs of their own; others stand within a sentence.
    block: bool = False
    measured: bool = True


# A table, a text, or what stands in the sentence of that name in sentences.toml.
Named = Iterator[tuple[str, pd.DataFrame | Figure | str | Mapping[str, Any]]]


@cache
def _sentences() -> dict[str, dict[str, str]]:
    return tomllib.loads(Path(__file__).with_name("sentences.toml").read_text(encoding="utf-8"))


def sentence(family: str, name: str, values: Mapping[str, Any]) -> str:
    """A sentence of sentences.toml with its numbers."""
    return _sentences()[family][name].format_map(values)


def raw(family: str) -> pd.DataFrame:
    """The raw results of a family's pieces, ``each`` saying which; in the order of evidence.toml."""
    # A wide table comes in many pieces from its file; a copy is one.
    tables = [piece.rows().copy().assign(each=piece.each) for piece in of_family(family)]
    return pd.concat(tables, ignore_index=True)


def table(rows: pd.DataFrame, *, words: bool = False) -> str:
    """As Markdown: the first column to the left, or all of ``words``; empty where a cell is missing."""
    aligned = ["---", *["---" if words else "---:"] * (rows.shape[1] - 1)]
    head = [" | ".join(map(str, rows.columns)), " | ".join(aligned)]
    cells = rows.astype(object).where(rows.notna(), "").astype(str)
    return "\n".join(f"| {line} |" for line in [*head, *(" | ".join(row) for row in cells.to_numpy())])


def wide(lines: pd.DataFrame, rows: str | list[str], columns: str) -> pd.DataFrame:
    """The ``cell`` of each line, by ``rows`` down and ``columns`` across, in the order of the lines."""
    return lines.pivot_table("cell", rows, columns, "first", sort=False).rename_axis(columns=None)


def power_of_ten(value: float) -> str:
    """Such as 3 · 10⁻⁹."""
    mantissa, exponent = f"{value:.0e}".split("e")
    return f"{mantissa} · 10{str(int(exponent)).translate(_RAISED)}"


def percent(share: float, digits: int = 1) -> str:
    """A share; nothing where there is none."""
    return "" if np.isnan(share) else f"{100 * share:.{digits}f} %"


def of(counts: pd.Series, all_of: pd.Series) -> pd.Series:
    """Such as "3 of 10"."""
    return counts.astype(int).astype(str) + " of " + all_of.astype(int).astype(str)


def ends(shares: pd.Series) -> dict[str, float]:
    """The least and the greatest share in percent, by the names that sentences have for them."""
    return {"least": 100 * shares.min(), "most": 100 * shares.max()}


def with_error(share: pd.Series, error: pd.Series) -> list[str]:
    """Shares and their standard errors, in percent."""
    return [f"{100 * each:.1f} ± {100 * sd:.1f} %" for each, sd in zip(share, error, strict=True)]


def binomial_error(share: pd.Series | float, count: pd.Series | int) -> pd.Series:
    """Standard error of a share of so many."""
    return np.sqrt(share * (1 - share) / count)


def known_error(error: pd.Series, share: float, count: pd.Series) -> pd.Series:
    """Standard errors of shares; where units are alike, and tell none, that of one interval a unit."""
    return error.where(error > 0, binomial_error(share, count))


def at_most(count: int, of: int) -> str:
    """Such as "0 of 80 (below 3.7 %)", the upper limit of the rate at 95 % (Clopper and Pearson)."""
    return f"{count} of {of} (below {percent(float(stats.beta.ppf(0.95, count + 1, of - count)))})"


def claims(p: np.ndarray, true: np.ndarray) -> dict[str, float]:
    """Of claims [study, claim] the mean probability and the share that is true; NaN where one does not count.

    ``se`` is the standard error between studies of the share less the probability: claims of a study are not
    independent.
    """
    count, off = int(np.isfinite(p).sum()), np.nansum(true - p, axis=1)
    se = float(off.std(ddof=1) * np.sqrt(len(off)) / count)
    return {"claims": count, "probability": float(np.nanmean(p)), "share": float(np.nanmean(true)), "se": se}


def by_probability(p: np.ndarray, true: np.ndarray) -> pd.DataFrame:
    """`claims` of like probability, a line each of `BINS` that has any: ``bin`` says from where to where."""
    lines = []
    for low, high in itertools.pairwise(BINS):
        inside = (p >= low) & ((p < high) | (high == BINS[-1]))
        if inside.any():
            counted = claims(np.where(inside, p, np.nan), np.where(inside, true, np.nan))
            lines.append({"bin": f"{low:g} to {high:g}", **counted})
    return pd.DataFrame(lines)


def of_bins(bins: pd.DataFrame, probability: str, number: str, true: str) -> pd.DataFrame:
    """The table of what `by_probability` has, three of its columns by these names."""
    return pd.DataFrame(
        {
            probability: bins["bin"],
            number: bins["claims"],
            "mean probability": bins["probability"].map(percent),
            true: with_error(bins["share"], bins["se"]),
        }
    )


def coverage(rows: pd.DataFrame, by: list[str]) -> pd.DataFrame:
    """How often intervals of 50 and of 90 % hold the truth, a line each of ``by`` and level.

    ``se`` is the standard error between units, as `known_error` has it: impacts of one campaign are not
    independent. ``off`` is the median error of the posterior median and ``width`` the median width, both
    relative to the truth unless that is an exponent's. ``cell`` is the share with its error.
    """
    rows = rows.dropna(subset="truth")
    relative = rows["truth"].where(~rows["quantity"].str.contains("exponent"), 1.0).abs()
    rows = rows.assign(off=(rows["q50"] - rows["truth"]).abs() / relative)
    lines = []
    for level, (low, high) in LEVELS.items():
        held = (rows[low] <= rows["truth"]) & (rows["truth"] <= rows[high])
        part = rows.assign(held=held, width=(rows[high] - rows[low]) / relative)
        groups = part.groupby(by, sort=False)
        campaigns = part.groupby([*by, "unit"], sort=False)["held"].mean().groupby(by, sort=False)
        columns = {"level": level, "held": groups["held"].sum(), "impacts": groups.size()}
        columns |= {"share": groups["held"].mean(), "campaigns": campaigns.size()}
        columns["se"] = known_error(campaigns.sem(), level / 100, columns["campaigns"])
        columns["cell"] = with_error(columns["share"], columns["se"])
        lines.append(pd.DataFrame(columns | groups[["off", "width"]].median().to_dict("series")))
    return pd.concat(lines).reset_index()


def coverage_table(lines: pd.DataFrame, each: str) -> pd.DataFrame:
    """`coverage` by ``each`` and quantity, as it is shown."""
    by = ["each", "quantity"]
    cells = wide(lines, by, "level").rename(columns="{} % held".format)
    widest = lines[lines["level"] == max(LEVELS)].set_index(by)
    cells["off by"], cells["90 % width"] = (widest[c].map("{:.3g}".format) for c in ("off", "width"))
    return cells.reset_index().rename(columns={"each": each})


def range_of_shares(lines: pd.DataFrame) -> str:
    """The least and the greatest share held, by level, and the standard error of one."""
    return " and ".join(
        f"{level} % intervals held {100 * part['share'].min():.0f} to {100 * part['share'].max():.0f} % "
        f"(each ± {100 * part['se'].median():.1f} %)"
        for level, part in lines.groupby("level")
    )
