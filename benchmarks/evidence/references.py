"""A small fixed set of results that stands for the program's numbers.

``references.csv`` holds them as they were when they were last accepted. `differing` says what of a set is no
longer equal: to rounding, or, where another order of sums leads the same chains elsewhere, within Monte Carlo
error. A piece of evidence keeps a digest of the sets that it rests on, and is of this version while they are
equal.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Iterable, Iterator
from functools import cache, partial
from html import unescape
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pandas as pd

from evidence.registry import BENCHMARKS
from evidence.simulations import simulation, tables

TABLE = BENCHMARKS / "references.csv"
# Of a posterior standard deviation, or of the number itself where it has none: rounding, amplified by a fit.
ROUNDING = 1e-4
# Over the Monte Carlo errors of two runs, of some hundred quantities at once and on average.
MOST_ERRORS, MEAN_ERRORS = 5.0, 1.5
CAMPAIGNS = 3
# The error of a normal's 5 % or 95 % point over that of its mean, of its median, and of its deviation.
OF_END, OF_MEDIAN, OF_SD = 2.11, 1.25, 0.71
TABLES = tables(__file__)
TISSUES: dict[str, dict[str, Any]] = TABLES["tissues"]
type Row = tuple[str, float, float, float]


def tissue_of(element: str) -> dict[str, Any]:
    """What a simulation says of tissue of an element: as above, or typical parameters."""
    from bayestissue.mechanics.elements import element as named

    return TISSUES.get(element) or {"parameters": {one.name: one.typical for one in named(element).extra}}


def varied_tissue(element: str) -> dict[str, Any]:
    """The same, and the element by its name, of tissue whose further parameters vary by impact."""
    content = {"element": element, **tissue_of(element)}
    return content | ({"sd_impact_parameters": 0.05} if content.get("parameters") else {})


def campaign(element: str, seed: int, force: str = "") -> Any:
    """Three people, both sides, three masses: 18 impacts at 5 kHz, of a ``force`` too if one is named."""
    from bayestissue.studies.simulation import simulate

    own = {"tissue": {"element": element, **tissue_of(element)}}
    recording = {"force": TABLES["forces"][force]} if force else {}
    return simulate(simulation(TABLES["campaign"], own, recording=recording, seed=seed)).dataset("reference")


def fits(model: str, element: str = "kelvin_voigt", campaigns: int = CAMPAIGNS) -> pd.DataFrame:
    """Posteriors, and what the fit says against its model."""
    import bayestissue as bt

    rows: list[Row] = []
    for seed in range(1, campaigns + 1):
        fit = bt.fit(campaign(element, seed), model, K="log(mass_kg) + side + (1|subject)")
        rows += _of_fit(fit, seed)
        if (model, seed) == ("impact", 1):
            rows += _shown(fit)
        for row in fit.ask("K[side=left] / K[side=right] > 1", "mass_exponent_K > 0.3").to_dict("records"):
            rows.append((f"{seed} {row['question']}", row["posterior"], 1.0, row["mcse"]))
    return _table(rows)


def _of_fit(fit: Any, seed: int, *groups: str) -> Iterator[Row]:
    """Posterior intervals, and what the fit says against its model."""
    quantities = [name for group in ("all", *groups) for name in TABLES["quantities"][group]]
    columns = {"median": ("median", OF_MEDIAN), "low": ("eti90_low", OF_END), "high": ("eti90_high", OF_END)}
    for row in fit.summary[fit.summary["variable"].isin(quantities)].to_dict("records"):
        name = f"{seed} {row['variable']} {row['label']}".rstrip()
        for which, (column, of_mean) in columns.items():
            yield f"{name} {which}", row[column], row["sd"], of_mean * row["mcse_mean"]
    for key, value in fit.diagnostics.get("model_form", {}).get("impacts", {}).get("p", {}).items():
        yield f"{seed} residuals {key} p", value, 1.0, np.nan
    passed = fit.diagnostics.get("measuring_chain", {}).get("passed", True)
    yield f"{seed} chain passed", float(passed), 1.0, np.nan


def _shown(fit: Any) -> Iterator[Row]:
    """K and C of impacts as the page of a fit has them over those of its summary, by heading with unit: 1."""
    with TemporaryDirectory() as folder:
        page = fit.report(Path(folder) / "page.html").read_text(encoding="utf-8")
    medians = fit.summary.set_index(["variable", "label"])["median"].to_dict()
    ratios: dict[str, list[float]] = {}
    for table in re.findall(r"<table.*?</table>", page, re.S):
        rows = (re.findall(r"<t[hd][^>]*>(.*?)</t[hd]>", row, re.S) for row in table.split("<tr")[1:])
        heads, *lines = ([unescape(re.sub(r"<[^>]+>", "", cell)).strip() for cell in row] for row in rows)
        for line in (dict(zip(heads, cells, strict=False)) for cells in lines):
            for head in filter(_WITH_UNIT.fullmatch, line):
                if median := medians.get((head[0], line.get("impact"))):
                    ratios.setdefault(head, []).append(float(line[head]) / median)
    # Rounded to three digits or more, and the median over impacts: 5e-3 is beyond rounding.
    return ((f"page: {head}", float(np.median(r)), 50.0, np.nan) for head, r in ratios.items())


# Of a column of K or C.
_WITH_UNIT = re.compile(r"[KC] \(.+\)")


def _of_channels(force: str, element: str = "kelvin_voigt", model: str | None = None) -> pd.DataFrame:
    """One fit with two channels; the masses beside a load cell are known to 5 %."""
    import bayestissue as bt

    dataset = campaign(element, 1, force)
    declared = {"relative_mass_sd": 0.05} if force == "force" else {}
    uncertainty = dataset.uncertainty.model_copy(update=declared)
    return _table(_of_fit(bt.fit(dataset.with_settings(uncertainty=uncertainty), model), 1, "of_channels"))


def _points() -> pd.DataFrame:
    """Each impact by itself, of every element: K and C with intervals by a spring and damper, and flags."""
    import bayestissue as bt

    rows: list[Row] = []
    for element in TISSUES:
        table = bt.estimate(campaign(element, 1))
        numbers = [name for name in table if name.startswith(("K_", "C_"))]
        for row in table.to_dict("records"):
            name = f"{element} {row['impact']}"
            rows.append((f"{name} flags", float(len(str(row["flags"]))), 1.0, np.nan))
            rows += [(f"{name} {key}", row[key], abs(row[key]), np.nan) for key in numbers]
    return _table(rows)


def _plan() -> pd.DataFrame:
    """Shares of a hundred studies of two small designs that answer, and that mislead."""
    import bayestissue as bt

    plan = bt.plan(people=[4, 12], masses_kg=[[0.4, 0.7, 1.2]], ask="mass_exponent_K < 0.5", studies=100)
    return _table(
        (f"{row['people']} people {name}", row[name], 1.0, np.nan)
        for row in plan.designs.to_dict("records")
        for name in ("answered", "misleads", "undecided_bits")
    )


def _table(rows: Iterable[Row]) -> pd.DataFrame:
    return pd.DataFrame(rows, columns=["quantity", "value", "scale", "mcse"])


# Long ones first, so that two workers end together.
SETS: dict[str, Callable[[], pd.DataFrame]] = {
    **{name: partial(fits, name, name, 1) for name in reversed(TISSUES) if name != "kelvin_voigt"},
    "moving_mass": partial(_of_channels, *("moving_mass",) * 3),
    "force": partial(_of_channels, "force"),
    "impact": partial(fits, "impact"),
    "arma": partial(fits, "arma"),
    "plan": _plan,
    "points": _points,
    "a2": partial(fits, "a2", campaigns=1),
}


@cache
def accepted() -> pd.DataFrame:
    """The results as they were last accepted: ``set``, ``quantity``, ``value``, ``scale``, ``mcse``."""
    columns = ["set", "quantity", "value", "scale", "mcse"]
    return pd.read_csv(TABLE) if TABLE.exists() else pd.DataFrame(columns=columns)


def digest_of(name: str) -> str:
    """Of a set's accepted results."""
    rows = accepted().query("`set` == @name")
    return hashlib.sha256(rows.to_csv(index=False).encode()).hexdigest()[:16]


def differing(name: str, now: pd.DataFrame) -> str:
    """What of a set is no longer equal, in words; empty where all is, to rounding or Monte Carlo error."""
    before = accepted().query("`set` == @name").set_index("quantity")
    now = now.set_index("quantity")
    if changed := sorted(before.index.symmetric_difference(now.index)):
        return f"{len(changed)} results came or went, such as {changed[0]}"
    now = now.reindex(before.index)
    off = (now["value"] - before["value"]).abs()
    gone = before["value"].isna() != now["value"].isna()
    unequal = (off > ROUNDING * before["scale"]) | gone
    if not unequal.any():
        return ""
    errors = (off / np.hypot(before["mcse"], now["mcse"]))[unequal]
    worst = errors.idxmax() if errors.notna().all() else errors.index[errors.isna()][0]
    within = errors.notna().all() and errors.max() < MOST_ERRORS and np.sqrt((errors**2).mean()) < MEAN_ERRORS
    if within:
        return ""
    return (
        f"{int(unequal.sum())} of {len(off)} results differ, such as {worst}: "
        f"{before.loc[worst, 'value']:.6g}, now {now.loc[worst, 'value']:.6g}"
    )
