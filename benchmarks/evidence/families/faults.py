"""What is said of a wrong measuring chain, spoilt recordings, damaged files and kills."""

from __future__ import annotations

import numpy as np
import pandas as pd

from evidence.texts import Figure, Named, at_most, block, family, names, percent, raw, table


def _alarms() -> pd.DataFrame:
    """How many sets of each kind raise an alarm."""
    groups = raw("measuring_chain").groupby(["likelihood", "spoilt"], sort=False)["alarm"]
    return pd.DataFrame({"alarms": groups.sum(), "sets": groups.size()}).reset_index()


@family
def measuring_chain() -> Named:
    lines = _alarms()
    cells = lines["alarms"].astype(str) + " of " + lines["sets"].astype(str)
    shown = lines.assign(cell=cells).pivot_table("cell", "spoilt", "likelihood", "first", sort=False)
    shown = shown.rename(columns="alarms by `{}`".format).reset_index().rename_axis(columns=None)
    yield "table", block(table(shown), "measuring_chain")
    right = lines[lines["spoilt"] == "nothing"]
    false_alarms = at_most(right["alarms"].sum(), right["sets"].sum())
    yield "false_alarms", Figure(false_alarms, names("measuring_chain"))
    wrong = lines[~lines["spoilt"].str.contains("nothing|mass")]
    share = f"{wrong['alarms'].min()} to {wrong['alarms'].max()} of {wrong['sets'].max()}"
    text = (
        f"there was an alarm for {share} sets with an error of each kind that shows, and for {false_alarms} "
        "right ones, where one of 200 may have one"
    )
    yield "sentence", Figure(text, names("measuring_chain"))


@family
def spoilt_impacts() -> Named:
    rows = raw("spoilt_impacts").rename(columns={"unit": "kind"})
    shown = pd.DataFrame(
        {
            "recording": rows["kind"],
            "impacts": rows["impacts"],
            "flagged": [percent(each) for each in rows["flagged"] / rows["impacts"]],
            "K or C off by more than 5 %": rows["off"],
            "of these flagged": (rows["off_and_flagged"] / rows["off"]).map(
                lambda share: "" if np.isnan(share) else percent(share, 0)
            ),
            "not flagged, but noted": rows["off_and_noted"],
            "K off, median": rows["K_off_median"].map(percent).where(rows["K_off_median"].notna()),
            "C off, median": rows["C_off_median"].map(percent).where(rows["C_off_median"].notna()),
            "commonest flag": rows["commonest_flag"],
        }
    )
    yield "table", block(table(shown), "spoilt_impacts")
    own, sound = names("spoilt_impacts"), rows["kind"].str.startswith("sound")
    spoilt = rows[~sound]
    off, caught = spoilt["off"].sum(), spoilt["off_and_flagged"].sum()
    fine = rows[rows["kind"] == "sound, deceleration"].iloc[0]
    false_alarms = percent(fine["flagged"] / fine["impacts"])
    least = spoilt[spoilt["off"] >= 20].assign(share=lambda t: t["off_and_flagged"] / t["off"])
    weakest = ", ".join(
        f"{row.kind} {percent(row.share, 0)}" for row in least.nsmallest(3, "share").itertuples()
    )
    text = (
        f"of {spoilt['impacts'].sum()} impacts spoilt in {len(spoilt)} ways, K or C of {off} is off by more "
        f"than 5 %, and {percent(caught / off)} of these are flagged or refused (the least of the kinds: "
        f"{weakest}), as are {false_alarms} of sound decelerations"
    )
    yield "sentence", Figure(text, own)
    text = f"{percent(caught / off)} of those that make K or C wrong by 5 %, and {false_alarms} of sound ones"
    yield "short", Figure(text, own)


@family
def damaged_files() -> Named:
    rows = raw("damaged_files")
    good, bad = int(rows["examples_passed"].sum()), int(rows["examples_failed"].sum())
    passed = int((rows["state"] == "passed").sum())
    text = f"{passed} of {len(rows)} kinds of file passed the test with damaged ones"
    if good + bad:
        text += f"; {bad} of {good + bad} damaged files were read wrongly or gave a traceback"
    yield "sentence", Figure(text, names("damaged_files"))


@family
def kills() -> Named:
    rows = raw("kills")
    passed = (rows["state"] == "passed").all()
    text = "had the same draws as one that was left alone" if passed else "did not all have the same draws"
    yield (
        "sentence",
        Figure(f"a fit that was killed ten times, and given again each time, {text}", names("kills")),
    )
