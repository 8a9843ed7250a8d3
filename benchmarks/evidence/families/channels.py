"""Where a force was recorded beside the motion, or a known spring hit: whether intervals hold the truth."""

from __future__ import annotations

import pandas as pd

from evidence.families.outcomes import LEVEL, shares
from evidence.texts import Named, known_error, sentence, wide, with_error

# Declared masses that are wrong by more are wrong beyond what is declared; by less, hardly.
FAR, NEAR = 0.05, 0.01


def counted(rows: pd.DataFrame) -> pd.DataFrame:
    """`shares` without those of all quantities together, with their `known_error`."""
    lines = shares(rows).query("outcome != 'all'")
    return lines.assign(se=known_error(lines["se"], LEVEL, lines["studies"]))


def shown(lines: pd.DataFrame) -> pd.DataFrame:
    """Shares with their errors, a row a quantity and a column a kind of study."""
    cells = wide(lines.assign(cell=with_error(lines["share"], lines["se"])), "outcome", "of")
    studies = lines.groupby("of", sort=False)["studies"].max().reindex(cells.columns).astype(str)
    return pd.concat([studies.to_frame("studies").T, cells]).rename_axis(index="quantity").reset_index()


def named(rows: pd.DataFrame) -> str:
    """How often the first line says that masses are off, of those that are and of those that hardly are."""
    said: dict[str, float] = {"far": 100 * FAR, "near": 100 * NEAR}
    for end, which in (("far", rows["off"] > FAR), ("near", rows["off"] < NEAR)):
        said |= {f"named_{end}": int(rows["named"][which].sum()), f"of_{end}": which.sum()}
    return sentence("coverage_channels", "named", said)


def coverage_channels(rows: pd.DataFrame) -> Named:
    together = []
    for kind, part in rows.groupby("each", sort=False):
        own = part.dropna(axis=1, how="all")
        together.append(lines := counted(own))
        yield f"{kind}_table", shown(lines)
        said = {"studies": len(own), "passed": 100 * own["passed"].astype(bool).mean()}
        yield f"{kind}_studies", sentence("coverage_channels", "studies", said)
        if "named" in own:
            yield f"{kind}_named", named(own)
    lines = pd.concat(together)
    within = ((lines["share"] - LEVEL).abs() <= 2 * lines["se"]).sum()
    yield "short", {"within": within, "shares": len(lines)}


def coverage_phantoms(rows: pd.DataFrame) -> Named:
    yield "table", shown(counted(rows))
