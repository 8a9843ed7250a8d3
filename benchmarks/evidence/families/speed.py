"""How long things take, beside other programs and by themselves."""

from __future__ import annotations

import pandas as pd

from evidence.texts import Named, wide


def likelihood(rows: pd.DataFrame) -> Named:
    ours = rows[rows["contender"] == "bayestissue"].set_index("unit")["ms"]
    times = rows["ms"] / rows["unit"].map(ours)
    cells = [f"{ms:.3g} ({ratio:.2g})" for ms, ratio in zip(rows["ms"], times, strict=True)]
    shown = wide(rows.assign(cell=cells), "contender", "unit")
    yield "table", shown.rename(columns="{} samples".format).reset_index()
    at = rows["unit"] == 1024
    others = times[at & rows["contender"].str.contains("tinygp|celerite2|statsmodels")]
    scan = times[at & rows["contender"].str.contains("tuned")].iloc[0]
    yield "sentence", {"least": others.min(), "most": others.max(), "scan": scan}


def fit_efficiency(rows: pd.DataFrame) -> Named:
    shown = pd.DataFrame(
        {
            "contender": rows["unit"],
            "chains": rows["remark"],
            "gradients a draw": rows["gradients_a_draw"].map("{:.0f}".format),
            "least ESS": rows["ess_bulk"].map("{:.0f}".format),
            "seconds": rows["own_sampling_s"].map("{:.0f}".format),
            "ESS a second": rows["per_own_s"].map("{:.2g}".format),
            "R-hat": rows["r_hat"].map("{:.3f}".format).where(rows["r_hat"].notna()),
        }
    )
    yield "table", shown
    rate = rows.set_index("unit")["per_own_s"]
    ours = rate[rate.index.str.startswith("bayestissue")].max()
    yield "sentence", {"times": ours / rate[rate.index.str.contains("plain model")].max()}


def trace_likelihood(rows: pd.DataFrame) -> Named:
    shown = rows.drop(columns="each").set_index("likelihood").map("{:.3g}".format)
    yield "table", shown.rename(columns="{} [ms]".format).reset_index()


def fit_time(rows: pd.DataFrame) -> Named:
    columns = {"first_s": "first [s]", "again_s": "again [s]", "other_s": "other dataset [s]"}
    columns |= {"r_hat": "R-hat", "ess": "least ESS"}
    yield "table", rows[["element", "tissue", *columns]].rename(columns=columns)
    example = rows[rows["tissue"] == "example"].groupby("element").last()
    seconds = {
        f"{name}_{run}": f"{row[f'{run}_s']:.0f} s"
        for name, row in example.iterrows()
        for run in ("first", "again")
    }
    yield from seconds.items()
    yield "readme", seconds


def reproduce_time(rows: pd.DataFrame) -> Named:
    yield from rows.set_index("run")["s"].map("{:.0f} s".format).items()


def bench_latency(rows: pd.DataFrame) -> Named:
    medians = rows.groupby("at")[["s", "work_s"]].median()
    ((first, early), (last, late)) = medians["s"].iloc[[0, -1]].items()
    said = {"first": first, "early": early, "last": last, "late": late}
    yield "sentence", said | {"work_s": medians["work_s"].iloc[-1]}
