"""What is said of a wrong measuring chain, spoilt recordings, damaged files and kills."""

from __future__ import annotations

import pandas as pd

from evidence.texts import Named, at_most, percent, wide


def measuring_chain(rows: pd.DataFrame) -> Named:
    groups = rows.groupby(["likelihood", "spoilt"], sort=False)["alarm"]
    lines = pd.DataFrame({"alarms": groups.sum(), "sets": groups.size()}).reset_index()
    lines["cell"] = lines["alarms"].astype(str) + " of " + lines["sets"].astype(str)
    shown = wide(lines, "spoilt", "likelihood")
    yield "table", shown.rename(columns="alarms by `{}`".format).reset_index()
    right = lines[lines["spoilt"] == "nothing"]
    false_alarms = at_most(right["alarms"].sum(), right["sets"].sum())
    yield "false_alarms", false_alarms
    wrong = lines[~lines["spoilt"].str.contains("nothing|mass")]
    said = {"least": wrong["alarms"].min(), "most": wrong["alarms"].max(), "sets": wrong["sets"].max()}
    yield "sentence", said | {"false_alarms": false_alarms}


def spoilt_impacts(rows: pd.DataFrame) -> Named:
    caught = rows["off_and_flagged"] / rows["off"]
    shown = pd.DataFrame(
        {
            "recording": rows["unit"],
            "impacts": rows["impacts"],
            "flagged": (rows["flagged"] / rows["impacts"]).map(percent),
            "K or C off by more than 5 %": rows["off"],
            "of these flagged": caught.map(lambda share: percent(share, 0)),
            "not flagged, but noted": rows["off_and_noted"],
            "K off, median": rows["K_off_median"].map(percent),
            "C off, median": rows["C_off_median"].map(percent),
            "commonest flag": rows["commonest_flag"],
        }
    )
    yield "table", shown
    spoilt = ~rows["unit"].str.startswith("sound")
    sums = rows[spoilt][["impacts", "off", "off_and_flagged"]].sum()
    fine = rows[rows["unit"] == "sound, deceleration"].iloc[0]
    least = caught[spoilt & (rows["off"] >= 20)].nsmallest(3)
    said = {"impacts": sums["impacts"], "ways": spoilt.sum(), "off": sums["off"]}
    said |= {"weakest": ", ".join(f"{rows['unit'][row]} {percent(share, 0)}" for row, share in least.items())}
    said |= {"caught": percent(sums["off_and_flagged"] / sums["off"])}
    said |= {"false_alarms": percent(fine["flagged"] / fine["impacts"])}
    yield "sentence", said
    yield "short", said


def damaged_files(rows: pd.DataFrame) -> Named:
    good, bad = (int(rows[f"examples_{end}"].sum()) for end in ("passed", "failed"))
    passed = (rows["state"] == "passed").sum()
    yield "sentence", {"passed": passed, "kinds": len(rows), "bad": bad, "files": good + bad}


def kills(rows: pd.DataFrame) -> Named:
    yield "sentence", {"had": "had" if (rows["state"] == "passed").all() else "did not all have"}
