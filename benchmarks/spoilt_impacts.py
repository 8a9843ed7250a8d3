"""How many sound impacts are flagged, and how many spoilt ones are caught, by kind of spoiling.

    .venv/bin/python benchmarks/spoilt_impacts.py

Sound impacts are those of `sound.py`: on all six elements, 1 to 10 kHz, noise of 0.1 to
2 % of the peak, with and without a quiet part, ended after the peak or after the rebound; and the same, all
cropped at contact. Each kind of `spoiling.py` spoils 200 of them. An impact is flagged where `check` refuses
it or warns of it, or where `estimate` flags it; noted where `estimate` notes that contact may have come
earlier. K or C is off where spoiling moves the point estimate by more than 5 % from that of the same impact
recorded with the same chain and noise and not spoilt. The table goes to
spoilt_impacts.csv.
"""

from __future__ import annotations

import argparse
from collections import Counter
from functools import partial
from pathlib import Path

import pandas as pd
import sound
from evidence import recorded
from spoiling import KINDS, judged, sound_ones, spoilt_ones

from bayestissue import runtime

TABLE = Path(__file__).with_suffix(".csv")
SOUND, SPOILT = 1000, 200


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
        "off_and_noted": int((off & ~flagged & found["noted"]).sum()),
        "K_off_median": float(found["K_off"].median()),
        "C_off_median": float(found["C_off"].median()),
        "commonest_flag": named.most_common(1)[0][0] if named else "",
    }


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--impacts", type=int, default=SPOILT, help="of each kind of spoiling")
    asked = parser.parse_args()
    runtime.configure()
    with recorded("spoilt_impacts") as record:
        measure(asked.impacts)
        if asked.impacts < SPOILT:
            record.left = f"{SPOILT - asked.impacts} of {SPOILT} impacts of each kind"


def measure(number: int) -> None:
    """Spoil ``number`` impacts in each way, and write the table."""
    impacts = sound.impacts(600)
    sets = {
        "sound, deceleration": lambda: sound_ones(impacts, SOUND),
        "sound, cropped at contact": lambda: sound_ones(impacts, SOUND, cropped=True),
        "sound, displacement": lambda: sound_ones(impacts, number, "displacement"),
        **{kind: partial(spoilt_ones, kind, impacts, number) for kind in KINDS},
    }
    rows = []
    for kind, make in sets.items():
        rows.append(line(kind, judged(make())))
        print(rows[-1], flush=True)
    pd.DataFrame(rows).to_csv(TABLE, index=False, float_format="%.4g")


if __name__ == "__main__":
    main()
