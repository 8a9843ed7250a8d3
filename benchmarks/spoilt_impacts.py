"""How many sound impacts are flagged, and how many spoilt ones are caught, by kind of spoiling.

    .venv/bin/python benchmarks/spoilt_impacts.py

Sound impacts are those of `bayestissue.simulation.sound`: on all six elements, 1 to 10 kHz, noise of 0.1 to
2 % of the peak, with and without a quiet part, ended after the peak or after the rebound. Each kind of
`bayestissue.simulation.spoiling` spoils 200 of them. An impact is flagged where `check` refuses it or warns
of it, or where `estimate` flags it. K or C is off where spoiling moves the point estimate by more than 5 %
from that of the same impact recorded with the same chain and noise and not spoilt. The table goes to
spoilt_impacts.csv, to README.md here and, in two sentences, to the README of the project.
"""

from __future__ import annotations

import argparse
import textwrap
from collections import Counter
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
from documents import README, between_marks

from bayestissue import runtime
from bayestissue.simulation import sound
from bayestissue.simulation.spoiling import KINDS
from bayestissue.simulation.spoilt import judged, sound_ones, spoilt_ones

HERE, SCRIPT = Path(__file__).parent, "spoilt_impacts.py"
SOUND = 1000


def line(kind: str, found: pd.DataFrame) -> dict[str, object]:
    """One row of the table."""
    flagged, off = found["flags"] != "", found["off"] > 0.05
    named = Counter(flag for text in found.loc[flagged, "flags"] for flag in text.split("; "))
    return {
        "kind": kind,
        "impacts": len(found),
        "flagged": int(flagged.sum()),
        "no_answer": int(found["no_answer"].sum()),
        "off": int(off.sum()),
        "off_and_flagged": int((off & flagged).sum()),
        "K_off_median": float(found["K_off"].median()),
        "C_off_median": float(found["C_off"].median()),
        "commonest_flag": named.most_common(1)[0][0] if named else "",
    }


def table(rows: pd.DataFrame) -> str:
    """The table of the documentation."""
    text = [
        "| recording | impacts | flagged | K or C off by more than 5 % | of these flagged | K off, median | "
        "C off, median | commonest flag |",
        "|---|---:|---:|---:|---:|---:|---:|---|",
    ]
    for row in rows.to_dict("records"):
        caught = f"{row['off_and_flagged'] / row['off']:.0%}" if row["off"] else ""
        cells = [row["kind"], row["impacts"], f"{row['flagged'] / row['impacts']:.1%}", row["off"], caught]
        cells += [
            f"{row[name]:.1%}" if np.isfinite(row[name]) else "" for name in ("K_off_median", "C_off_median")
        ]
        text.append("| " + " | ".join(str(cell) for cell in [*cells, row["commonest_flag"]]) + " |")
    return "\n".join(text)


def statement(rows: pd.DataFrame) -> str:
    """The same in one sentence."""
    spoilt = rows[~rows["kind"].str.startswith("sound")]
    good = rows[rows["kind"].str.startswith("sound")]
    off, caught = spoilt["off"].sum(), spoilt["off_and_flagged"].sum()
    least = (
        spoilt[spoilt["off"] >= 20]
        .assign(share=lambda t: t["off_and_flagged"] / t["off"])
        .nsmallest(3, "share")
    )
    weakest = ", ".join(f"{row.kind} {row.share:.0%}" for row in least.itertuples())
    left_alone = "; ".join(
        f"of {row.impacts} sound {row.kind.removeprefix('sound, ')}s {row.flagged / row.impacts:.1%} are "
        f"flagged, and {row.no_answer / row.impacts:.1%} get no answer from the ARMA(2,1) fit of `estimate`"
        for row in good.itertuples()
    )
    return (
        f"In simulations, {left_alone}. Of "
        f"{spoilt['impacts'].sum()} spoilt in {len(spoilt)} ways, K or C of {off} is off by more than 5 %, "
        f"and {caught / off:.1%} of these are flagged or refused (the least of the kinds: {weakest})."
    )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--impacts", type=int, default=200, help="of each kind of spoiling")
    asked = parser.parse_args()
    runtime.configure()
    impacts = sound.impacts(600)
    sets = {
        "sound, deceleration": lambda: sound_ones(impacts, SOUND),
        "sound, displacement": lambda: sound_ones(impacts, asked.impacts, "displacement"),
        **{kind: partial(spoilt_ones, kind, impacts, asked.impacts) for kind in KINDS},
    }
    rows = []
    for kind, make in sets.items():
        rows.append(line(kind, judged(make())))
        print(rows[-1], flush=True)
    found = pd.DataFrame(rows)
    found.to_csv(HERE / "spoilt_impacts.csv", index=False, float_format="%.4g")
    document(found)


def document(found: pd.DataFrame) -> None:
    """Write the table and what it says between the marks."""
    between_marks(README, SCRIPT, f"{statement(found)}\n\n{table(found)}")
    said = textwrap.fill(statement(found), 118, initial_indent="  ", subsequent_indent="  ")
    between_marks(HERE.parent / "README.md", SCRIPT, said, indent="  ")


if __name__ == "__main__":
    main()
