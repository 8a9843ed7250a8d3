"""Where a force was recorded beside the motion, or a known spring hit: whether intervals hold the truth."""

from __future__ import annotations

import pandas as pd

from evidence.families.outcomes import LEVEL, shares
from evidence.texts import (
    Figure,
    Named,
    block,
    family,
    known_error,
    names,
    percent,
    raw,
    table,
    with_error,
)

# Declared masses that are wrong by more are wrong beyond what is declared; by less, hardly.
FAR, NEAR = 0.05, 0.01


def counted(rows: pd.DataFrame) -> pd.DataFrame:
    """`shares` without those of all quantities together, with their `known_error`."""
    lines = shares(rows).query("outcome != 'all'")
    return lines.assign(se=known_error(lines["se"], LEVEL, lines["studies"]))


def shown(lines: pd.DataFrame) -> str:
    """Shares with their errors, a row a quantity and a column a kind of study."""
    cells = lines.assign(cell=with_error(lines["share"], lines["se"]))
    wide = cells.pivot_table("cell", "outcome", "of", "first", sort=False)
    studies = lines.groupby("of", sort=False)["studies"].max().reindex(wide.columns).astype(str)
    wide = pd.concat([studies.to_frame("studies").T, wide])
    return table(wide.rename_axis(index="quantity", columns=None).reset_index())


def named(rows: pd.DataFrame) -> str:
    """How often the first line says that masses are off, of those that are and of those that hardly are."""
    far, near = (rows.loc[which, "named"].astype(bool) for which in (rows["off"] > FAR, rows["off"] < NEAR))
    return (
        f"where all masses were off by more than {percent(FAR, 0)} the first line said so in "
        f"{int(far.sum())} of {len(far)} studies, and where they were off by less than {percent(NEAR, 0)} in "
        f"{int(near.sum())} of {len(near)}"
    )


@family
def coverage_channels() -> Named:
    rows, together = raw("coverage_channels"), []
    for kind, part in rows.groupby("each", sort=False):
        own = part.dropna(axis=1, how="all")
        lines = counted(own)
        yield f"{kind}_table", block(shown(lines), "coverage_channels")
        together.append(lines)
        text = f"{len(own)} studies, of which {percent(own['passed'].astype(bool).mean(), 0)} passed"
        yield f"{kind}_studies", Figure(text, names("coverage_channels"))
        if "named" in own:
            yield f"{kind}_named", Figure(named(own), names("coverage_channels"))
    lines = pd.concat(together)
    within = ((lines["share"] - LEVEL).abs() <= 2 * lines["se"]).sum()
    text = f"{within} of {len(lines)} shares of 90 % intervals are within two standard errors of 90 %"
    yield "short", Figure(text, names("coverage_channels"))


@family
def coverage_phantoms() -> Named:
    yield "table", block(shown(counted(raw("coverage_phantoms"))), "coverage_phantoms")
