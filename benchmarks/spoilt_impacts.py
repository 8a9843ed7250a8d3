"""How many sound impacts are flagged, and how many spoilt ones are caught, by kind of spoiling.

    .venv/bin/python benchmarks/spoilt_impacts.py

Sound impacts are those of `sound.py`: on all six elements, 1 to 10 kHz, noise of 0.1 to
2 % of the peak, with and without a quiet part, ended after the peak or after the rebound; and the same, all
cropped at contact. Each kind of `spoiling.py` spoils 100 of them. An impact is flagged where `check` refuses
it or warns of it, or where point estimates flag it; noted where these note that contact may have come
earlier. K or C is off where spoiling moves what `estimate` has by more than 5 % from that of the same impact
recorded with the same chain and noise and not spoilt. A row a kind.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from functools import partial

import pandas as pd
import sound
from evidence import measure
from spoiling import KINDS, Recorded, judged, sound_ones, spoilt_ones

from bayestissue.base import runtime

SOUND, SPOILT = 1000, 100


def line(recorded: Callable[[], Recorded], *, sound: bool = False) -> dict[str, object]:
    """One row of the table."""
    found: pd.DataFrame = judged(recorded(), sound=sound)
    flagged, off = found["flags"] != "", found["off"] > 0.05
    named = Counter(flag for text in found.loc[flagged, "flags"] for flag in text.split("; "))
    return {
        "impacts": len(found),
        "flagged": int(flagged.sum()),
        "off": int(off.sum()),
        "off_and_flagged": int((off & flagged).sum()),
        "off_and_noted": int((off & ~flagged & found["noted"]).sum()),
        "K_off_median": float(found["K_off"].median()),
        "C_off_median": float(found["C_off"].median()),
        "commonest_flag": named.most_common(1)[0][0] if named else "",
    }


def main() -> None:
    runtime.configure()
    impacts = sound.impacts(600)
    whole = {
        "sound, deceleration": partial(sound_ones, impacts, SOUND),
        "sound, cropped at contact": partial(sound_ones, impacts, SOUND, cropped=True),
        "sound, displacement": partial(sound_ones, impacts, SPOILT, "displacement"),
    }
    units = {name: partial(line, made, sound=True) for name, made in whole.items()}
    units |= {kind: partial(line, partial(spoilt_ones, kind, impacts, SPOILT)) for kind in KINDS}
    measure("spoilt_impacts", units, lambda of: of())


if __name__ == "__main__":
    main()
