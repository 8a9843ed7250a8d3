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
from functools import cache
from html import unescape
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pandas as pd

from evidence.registry import BENCHMARKS

TABLE = BENCHMARKS / "references.csv"
# Of a posterior standard deviation, or of the number itself where it has none: rounding, amplified by a fit.
ROUNDING = 1e-4
# Over the Monte Carlo errors of two runs, of some hundred quantities at once and on average.
MOST_ERRORS, MEAN_ERRORS = 5.0, 1.5
CAMPAIGNS = 3
# Of what a fit tells: of impacts, of the population, of repeatability, of a new person.
QUANTITIES = {
    *(
        "K",
        "C",
        "intercept_K",
        "mass_exponent_K",
        "mass_exponent_C",
        "sd_subject_K",
        "sd_impact_K",
        "sd_impact_C",
    ),
    *("ICC_C1_K", "SEM_chain_K", "K_new", "C_new", "K_side", "residual_correlation"),
}
# The same where a force tells the mass.
OF_CHANNELS = QUANTITIES | {
    *("mass", "mass_factor", "gain_factor", "moving_mass_kg", "K_trial", "energy_absorbed"),
}
# The error of a normal's 5 % or 95 % point over that of its mean, of its median, and of its deviation.
OF_END, OF_MEDIAN, OF_SD = 2.11, 1.25, 0.71
TISSUES: dict[str, dict[str, Any]] = {
    "kelvin_voigt": {},
    "maxwell": {"C_N_s_per_m": 120.0},
    "standard_linear": {"K_N_per_m": 2000.0, "C_N_s_per_m": 30.0, "parameters": {"arm_ratio": 2.0}},
    "stiffening": {"K_N_per_m": 2000.0, "parameters": {"stiffening_depth_m": 0.02}},
    "hunt_crossley": {"C_N_s_per_m": 60.0},
    "wall": {"K_N_per_m": 2000.0, "parameters": {"thickness_m": 0.04}},
}


def tissue_of(element: str) -> dict[str, Any]:
    """What a simulation says of tissue of an element: as above, or typical parameters."""
    from bayestissue.mechanics.elements import element as named

    return TISSUES.get(element) or {"parameters": {one.name: one.typical for one in named(element).extra}}


def campaign(element: str, seed: int, force: dict[str, Any] | None = None) -> Any:
    """Three people, both sides, three masses: 18 impacts at 5 kHz, of a ``force`` too if one is given."""
    from bayestissue.studies.simulation import Simulation, simulate

    masses = {"a": (0.4, 1.5), "b": (0.7, 1.2), "c": (1.2, 0.9)}
    tissue = {"K_N_per_m": 3000.0, "C_N_s_per_m": 25.0, "mass_exponent_K": 0.3, "element": element}
    spreads = {
        f"sd_{group}_{q}": 0.2 if group == "subject" else 0.05
        for group in ("subject", "impact")
        for q in "KC"
    }
    content = {
        "name": "reference",
        "seed": seed,
        "design": {
            "subjects": 3,
            "conditions": [{"trial": t, "mass_kg": m, "velocity_m_s": v} for t, (m, v) in masses.items()],
            "factors": [{"name": "side", "levels": ["left", "right"]}],
        },
        "tissue": tissue | spreads | tissue_of(element),
        "recording": {
            "sampling_rate_hz": 5000.0,
            "before_contact_s": 0.005,
            "noise_relative_to_peak": 0.005,
            "offset_sd_m_s2": 0.2,
            "relative_gain_sd": 0.005,
            "velocity_sd_m_s": 0.005,
            "relative_mass_sd": 0.002,
            **({"force": force} if force else {}),
        },
    }
    return simulate(Simulation.model_validate(content)).dataset("reference")


def fits(model: str, element: str = "kelvin_voigt", campaigns: int = CAMPAIGNS) -> pd.DataFrame:
    """Posteriors, and what the fit says against its model."""
    import bayestissue as bt

    rows: list[tuple[str, float, float, float]] = []
    for seed in range(1, campaigns + 1):
        fit = bt.fit(campaign(element, seed), model, K="log(mass_kg) + side + (1|subject)")
        rows += _of_fit(fit, seed, QUANTITIES)
        if (model, seed) == ("impact", 1):
            rows += _shown(fit)
        for row in fit.ask("K[side=left] / K[side=right] > 1", "mass_exponent_K > 0.3").to_dict("records"):
            rows.append((f"{seed} {row['question']}", row["posterior"], 1.0, row["mcse"]))
    return _table(rows)


def _of_fit(fit: Any, seed: int, quantities: set[str]) -> Iterator[tuple[str, float, float, float]]:
    """Posterior intervals, and what the fit says against its model."""
    for row in fit.summary[fit.summary["variable"].isin(quantities)].to_dict("records"):
        name = f"{seed} {row['variable']} {row['label']}".rstrip()
        sd, mcse = row["sd"], row["mcse_mean"]
        yield f"{name} median", row["median"], sd, OF_MEDIAN * mcse
        yield f"{name} low", row["eti90_low"], sd, OF_END * mcse
        yield f"{name} high", row["eti90_high"], sd, OF_END * mcse
    for key, value in fit.diagnostics.get("model_form", {}).get("impacts", {}).get("p", {}).items():
        yield f"{seed} residuals {key} p", value, 1.0, np.nan
    passed = fit.diagnostics.get("measuring_chain", {}).get("passed", True)
    yield f"{seed} chain passed", float(passed), 1.0, np.nan


def _shown(fit: Any) -> Iterator[tuple[str, float, float, float]]:
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


def _force() -> Any:
    """A load cell in the impactor, its masses known to 5 %."""
    force = {"noise_relative_to_peak": 0.01, "relative_gain_sd": 0.01, "offset_sd_N": 0.3}
    return _rough_masses(campaign("kelvin_voigt", 1, force))


def _moving_mass() -> Any:
    """Tissue that moves along, on a force plate."""
    return campaign("moving_mass", 1, {"noise_relative_to_peak": 0.005, "place": "base"})


def _rough_masses(dataset: Any) -> Any:
    return dataset.with_settings(
        uncertainty=dataset.uncertainty.model_copy(update={"relative_mass_sd": 0.05})
    )


def _of_channels(dataset: Callable[[], Any], model: str | None = None) -> pd.DataFrame:
    """One fit of a dataset with two channels."""
    import bayestissue as bt

    return _table(_of_fit(bt.fit(dataset(), model), 1, OF_CHANNELS))


def _points() -> pd.DataFrame:
    """Each impact by itself, of every element: K and C with intervals by a spring and damper, and flags."""
    import bayestissue as bt

    rows: list[tuple[str, float, float, float]] = []
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


def _table(rows: Iterable[tuple[str, float, float, float]]) -> pd.DataFrame:
    return pd.DataFrame(rows, columns=["quantity", "value", "scale", "mcse"])


# Long ones first, so that two workers end together.
SETS: dict[str, Callable[[], pd.DataFrame]] = {
    **{
        name: lambda name=name: fits(name, name, campaigns=1)  # type: ignore[misc]
        for name in reversed(TISSUES)
        if name != "kelvin_voigt"
    },
    "moving_mass": lambda: _of_channels(_moving_mass, "moving_mass"),
    "force": lambda: _of_channels(_force),
    "impact": lambda: fits("impact"),
    "arma": lambda: fits("arma"),
    "plan": _plan,
    "points": _points,
    "a2": lambda: fits("a2", campaigns=1),
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
