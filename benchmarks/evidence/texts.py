"""A figure of the documentation, and how numbers and tables are written."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy import stats

from evidence.registry import of_family

# Of intervals, and the quantiles at their ends.
LEVELS = {50: ("q25", "q75"), 90: ("q05", "q95")}
_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


@dataclass(frozen=True)
class Figure:
    """A text of the documentation, and the pieces of evidence that it tells."""

    text: str
    pieces: tuple[str, ...]
    # Tables and paragraphs of their own; others stand within a sentence.
    block: bool = False


Named = Iterator[tuple[str, Figure]]
# What makes the figures of each family of pieces, by its name.
FAMILIES: dict[str, Callable[[], Named]] = {}


def family(function: Callable[[], Named]) -> Callable[[], Named]:
    """Let a function make the figures of the family that it is called after."""
    FAMILIES[function.__name__] = function
    return function


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


def power_of_ten(value: float) -> str:
    """Such as 3 · 10⁻⁹."""
    mantissa, exponent = f"{value:.0e}".split("e")
    return f"{mantissa} · 10{str(int(exponent)).translate(_RAISED)}"


def percent(share: float, digits: int = 1) -> str:
    """A share."""
    return f"{100 * share:.{digits}f} %"


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


def names(family: str) -> tuple[str, ...]:
    """The pieces of a family."""
    return tuple(piece.name for piece in of_family(family))


def block(text: str, family: str) -> Figure:
    """Of all pieces of a family."""
    return Figure(text, names(family), block=True)


def coverage(rows: pd.DataFrame, by: list[str]) -> pd.DataFrame:
    """How often intervals of 50 and of 90 % hold the truth, a line each of ``by`` and level.

    ``se`` is the standard error between units, as `known_error` has it: impacts of one campaign are not
    independent. ``off`` is the median error of the posterior median and ``width`` the median width, both
    relative to the truth unless that is an exponent's.
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
        lines.append(pd.DataFrame(columns | groups[["off", "width"]].median().to_dict("series")))
    return pd.concat(lines).reset_index()


def coverage_table(lines: pd.DataFrame, by: list[str]) -> pd.DataFrame:
    """`coverage` as it is shown."""
    lines = lines.assign(cell=with_error(lines["share"], lines["se"]))
    cells = lines.pivot_table("cell", by, "level", "first", sort=False).rename(columns="{} % held".format)
    widest = lines[lines["level"] == lines["level"].max()].set_index(by)
    cells["off by"], cells["90 % width"] = (widest[c].map("{:.3g}".format) for c in ("off", "width"))
    return cells.reset_index().rename_axis(columns=None)


def range_of_shares(lines: pd.DataFrame) -> str:
    """The least and the greatest share held, by level, and the standard error of one."""
    ends = (
        lines.groupby("level").agg(a=("share", "min"), b=("share", "max"), se=("se", "median")).itertuples()
    )
    return " and ".join(
        f"{line.Index} % intervals held {100 * line.a:.0f} to {100 * line.b:.0f} % "
        f"(each ± {100 * line.se:.1f} %)"
        for line in ends
    )


def each_held(lines: pd.DataFrame, family: str) -> Named:
    """The share held of each quantity and level with its standard error, named VALUE_QUANTITY_LEVEL."""
    for line, share in zip(lines.itertuples(), with_error(lines["share"], lines["se"]), strict=True):
        name = f"{line.each}_{line.quantity}_{line.level}"
        yield name, Figure(share, (f"{family}-{line.each}",))


def trusted(rows: pd.DataFrame) -> pd.Series[bool]:
    """Of each row whether its fit can be relied on: by its diagnostics, or an earlier version's Pareto k."""
    from bayestissue.inference.samplers.psis import GREATEST_K

    return rows["passed"].astype(bool) if "passed" in rows else rows["pareto_k"] < GREATEST_K
