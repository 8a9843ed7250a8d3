"""How long things take, beside other programs and by themselves."""

from __future__ import annotations

import pandas as pd

from evidence.texts import Figure, Named, block, family, names, raw, table


@family
def likelihood() -> Named:
    rows = raw("likelihood").rename(columns={"unit": "samples"})
    ours = rows[rows["contender"] == "bayestissue"].set_index("samples")["ms"]
    times = rows["ms"] / rows["samples"].map(ours)
    cells = [f"{ms:.3g} ({ratio:.2g})" for ms, ratio in zip(rows["ms"], times, strict=True)]
    shown = rows.assign(cell=cells).pivot_table("cell", "contender", "samples", "first", sort=False)
    shown = shown.rename(columns="{} samples".format).reset_index().rename_axis(columns=None)
    yield "table", block(table(shown), "likelihood")
    at = rows["samples"] == 1024
    libraries = rows["contender"].str.contains("tinygp|celerite2|statsmodels")
    scan = times[at & rows["contender"].str.contains("tuned")].iloc[0]
    text = (
        f"at 1024 samples other libraries take {times[at & libraries].min():.0f} to "
        f"{times[at & libraries].max():.0f} times as long as a fit's density and gradient, the fastest scan "
        f"that was tried {scan:.0f} times"
    )
    yield "sentence", Figure(text, names("likelihood"))


@family
def fit_efficiency() -> Named:
    rows = raw("fit_efficiency").rename(columns={"unit": "contender"})
    shown = pd.DataFrame(
        {
            "contender": rows["contender"],
            "chains": rows["remark"],
            "gradients a draw": rows["gradients_a_draw"].map("{:.0f}".format),
            "least ESS": rows["ess_bulk"].map("{:.0f}".format),
            "seconds": rows["own_sampling_s"].map("{:.0f}".format),
            "ESS a second": rows["per_own_s"].map("{:.2g}".format),
            "R-hat": rows["r_hat"].map("{:.3f}".format).where(rows["r_hat"].notna()),
        }
    )
    yield "table", block(table(shown), "fit_efficiency")
    rate = rows.set_index("contender")["per_own_s"]
    ours = rate[rate.index.str.startswith("bayestissue")].max()
    plain = rate[rate.index.str.contains("plain model")].max()
    text = (
        f"a fit makes at least {ours / plain:.0f} times the effective samples a second of the samplers of "
        "numpyro and nutpie on the model written plainly"
    )
    yield "sentence", Figure(text, names("fit_efficiency"))


@family
def trace_likelihood() -> Named:
    shown = raw("trace_likelihood").drop(columns="each").set_index("likelihood").map("{:.3g}".format)
    yield "table", block(table(shown.rename(columns="{} [ms]".format).reset_index()), "trace_likelihood")


@family
def fit_time() -> Named:
    rows = raw("fit_time")
    columns = {"first_s": "first [s]", "again_s": "again [s]", "other_s": "other dataset [s]"}
    shown = rows[["element", "tissue", *columns, "r_hat", "ess"]].rename(columns=columns)
    shown = shown.rename(columns={"r_hat": "R-hat", "ess": "least ESS"})
    yield "table", block(table(shown), "fit_time")
    example = rows[rows["tissue"] == "example"].groupby("element").last()
    for name, row in example.iterrows():
        yield f"{name}_first", Figure(f"{row['first_s']:.0f} s", (f"fit_time-{name}",))
        yield f"{name}_again", Figure(f"{row['again_s']:.0f} s", (f"fit_time-{name}",))
        if name == "kelvin_voigt":
            text = f"The example takes {row['first_s']:.0f} s the first time on a machine."
            yield "readme", Figure(text, (f"fit_time-{name}",))


@family
def reproduce_time() -> Named:
    rows = raw("reproduce_time").set_index("run")
    for run in ("first", "again"):
        yield run, Figure(f"{rows.loc[run, 's']:.0f} s", names("reproduce_time"))


@family
def bench_latency() -> Named:
    rows = raw("bench_latency").groupby("at")[["s", "work_s"]].median()
    early, late = (f"{seconds:.1f} s" for seconds in rows["s"].iloc[[0, -1]])
    text = (
        f"`watch` judges the {rows.index[0]}th drop {early} after its file is whole, and the "
        f"{rows.index[-1]}th {late}; of that the verdict takes {rows['work_s'].iloc[-1]:.1f} s, and the rest "
        "is waiting until the file stands still"
    )
    yield "sentence", Figure(text, names("bench_latency"))
