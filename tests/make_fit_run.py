"""A small finished fit that the program made of drops of known K and C, and what tests change of it.

``python tests/make_fit_run.py`` makes the stored one anew, which a slow test holds against the program.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

import bayestissue as bt
from bayestissue.base.results.tables import table_of_rows
from bayestissue.inference.answers.contrasts import Contrasts, contrasts_table
from bayestissue.inference.answers.law import Law
from bayestissue.inference.answers.level_tables import levels_table
from bayestissue.inference.quantities.secants import comparable_draws
from bayestissue.inference.results.summary import summarise
from bayestissue.model.hierarchy.derived import hypotheses
from dataset_bench import deceleration
from made_once import made_once, once
from tree_file import pack, single_precision, unpack

STORED = Path(__file__).with_name("finished_fit.tar.xz")
PEOPLE, CONDITIONS, CHAINS, DRAWS, PRIOR_DRAWS = 4, 3, 2, 100, 300
MASS, LEVEL = np.array([0.4, 0.7, 1.2]), np.array([2500.0, 25.0])
MODEL = {"likelihood": "impact", "sampler": {"chains": CHAINS, "draws": 5 * DRAWS}}
FORMULA = "side + log(mass_kg) + (1|subject) + (1|trial)"


def drops() -> tuple[bt.Dataset, pd.DataFrame]:
    """Each person hit by each mass on one side, of which the left is a fifth stiffer; and the truth."""
    rng, rows, recordings = np.random.default_rng(1), [], {}
    people = 0.2 * rng.standard_normal((PEOPLE, 2))
    for c, mass in enumerate(MASS):
        for p, person in enumerate(people):
            side = ("left", "right")[(p + c) % 2]
            own = person + 0.03 * rng.standard_normal(2) + ([np.log(1.2), 0] if side == "left" else 0)
            K, C = LEVEL * np.exp(own)
            rows.append((f"t{c}-s{p}", f"s{p}", f"t{c}", side, mass, 1.5, K, C))
            time, value = deceleration(mass, 1.5, rng.uniform(0, 1e-3), K=K, C=C)
            recordings[f"t{c}-s{p}"] = time[::10], (value + rng.normal(0, 0.1, len(value)))[::10]
    columns = ["impact", "subject", "trial", "side", "mass_kg", "velocity_m_s", "K_N_per_m", "C_N_s_per_m"]
    table = pd.DataFrame(rows, columns=columns)
    stated = {"name": "made up", "quantity": "deceleration", "unit": "m/s^2"}
    sds = {"relative_mass_sd": 0.002, "velocity_sd_m_s": 0.005}
    dataset = bt.dataset(table[columns[:6]], recordings, uncertainty=sds, **stated)
    return dataset, table[["impact", *columns[6:]]]


def fit_of_drops() -> bt.Fit:
    """By the program, with a fifth of its draws."""
    fit = bt.fit(drops()[0], MODEL, 1, K=FORMULA, C=FORMULA)
    few = {5 * DRAWS: slice(None, None, 5), 1000: slice(PRIOR_DRAWS)}
    groups = {
        name: group.isel(draw=few.get(group.sizes["draw"], slice(20))).map(single_precision, keep_attrs=True)
        for name, group in groups_of(fit).items()
        if "draw" in group.sizes
    }
    return changed(fit, groups=groups)


@cache
def stored_fit() -> bt.Fit:
    """The stored one, in memory."""
    fit = bt.read_run(once("stored-fit", lambda folder: unpack(STORED, folder)))
    return replace(fit, posterior=fit.posterior.load()).complete()


@cache
def fit_run(
    *,
    two_sides: bool = False,
    exponent: float | None = 0.0,
    own_depth: float | None = None,
    mass_varies: bool = True,
    discrepancy: bool = False,
    passed: bool = True,
    likelihood: str = "impact",
) -> bt.Fit:
    """The stored fit, its draws moved.

    Args:
        two_sides: with effects of the sides.
        exponent: the posterior mean of K's mass exponent (C's is 0), None for a model without one.
        own_depth: that of K at each impact's own greatest depth, ``exponent`` being that at a common depth.
        mass_varies: else all masses are 0.7 kg, whatever was recorded.
        discrepancy: beside it the element's own K is half of K_secant, which is the stored K.
        passed: whether the diagnostics are.
        likelihood: what ``run.json`` says of the model.
    """
    fit = stored_fit()
    groups = groups_of(fit)
    posterior, constants, moved = groups["posterior"], groups["constant_data"], {}
    means = {"K": exponent, "C": 0.0}
    if own_depth is not None:
        means |= {"K_common_depth": exponent, "K_secant": own_depth}
        constants["common_depth_m"] = 0.0123
    for q, mean in means.items() if exponent is not None else ():
        draws = posterior[f"mass_exponent_{q[0]}"]
        moved[f"mass_exponent_{q}"] = mean + 0.02 * (draws - draws.mean()) / draws.std()
    if not mass_varies:
        constants["mass_kg"] = 0 * constants["mass_kg"] + 0.7
    if not two_sides:
        groups["constant_data"] = constants.drop_vars("column_side")
        moved |= {q: posterior[q].assign_attrs(averaged_over="") for q in ("K_new", "C_new")}
    gone = [name for name in posterior if _is_gone(str(name), two_sides, exponent, discrepancy)]
    groups |= {name: groups[name].drop_vars(gone) for name in ("posterior", "prior")}
    terms = {"side": two_sides, "log(mass_kg)": exponent is not None, "(1|subject)": True, "(1|trial)": True}
    formula = " + ".join(term for term, has in terms.items() if has)
    model = {"likelihood": likelihood, "formula": {"K": formula, "C": formula}}
    slopes = {
        name.removeprefix("mass_exponent_"): draws for name, draws in moved.items() if "exponent" in name
    }
    tables = {
        "hypotheses": hypotheses({q: draws.to_numpy() for q, draws in slopes.items()}, 0.1),
        "estimates_dds": fit.point_estimates.assign(mass_kg=constants["mass_kg"].to_numpy()),
    }
    if not two_sides:
        tables |= {name: table_of_rows(name) for name in ("contrasts", "levels", "loops", "curves")}
    fit = changed(fit, groups=groups, record={"model": model}, **tables)
    fit = with_draws(fit, moved)
    fit = _beside_discrepancy(fit) if discrepancy else fit
    return fit if passed else _failed(fit)


def _is_gone(name: str, two_sides: bool, exponent: float | None, discrepancy: bool) -> bool:
    """Whether a model of these options lacks a variable of the stored one."""
    repeatability = ("ICC", "SEM", "MDC", "relative", "repeats")
    return (
        ("side" in name and not two_sides)
        or (name.startswith("mass_exponent") and exponent is None)
        or (name.endswith("_K") and name.startswith(repeatability) and discrepancy)
    )


def _beside_discrepancy(fit: bt.Fit) -> bt.Fit:
    """K_secant is the stored K; nothing is said of what follows from the element's law, or how K repeats."""
    drawn, constants = (fit.posterior[name].to_dataset() for name in ("posterior", "constant_data"))
    none, people = 0 * drawn["intercept_K"], constants["impact_subject"].to_numpy().astype(str)
    moved = {name: 0.5 * drawn[name] for name in drawn if str(name) in HALVED}
    moved |= {"K_secant": drawn["K"], "discrepancy": 0.05 + 0 * drawn["K"]}
    moved |= {"intercept_K": drawn["intercept_K"] - np.log(2), "discrepancy_mean": np.log(0.05) + none}
    moved |= {
        "sd_discrepancy": 1 + none,
        **comparable_draws(drawn[["K"]].rename(K="K_secant"), {"subject": people}),
    }
    fit = changed(with_draws(fit, moved), record={"discrepancy": {"rms_of_peak": 0.05}})
    compared = Contrasts(replace(fit.study, law=Law(described=False)))
    rows = fit.reliability[fit.reliability["quantity"] != "K"]
    return changed(
        fit, contrasts=contrasts_table(compared, 0.1), levels=levels_table(compared), reliability=rows
    )


HALVED = ("K", "K_subject", "K_trial", "K_new", "K_side", "K_typical_person")


def _failed(fit: bt.Fit) -> bt.Fit:
    words = "R-hat is 1.4: the chains disagree."
    first, *others = fit.diagnostics["checks"]
    verdict = {"passed": False, "headline": "DIAGNOSTICS FAILED", "words": words, "doubts": words}
    checks = [first | {"passed": False, "value": 1.4}, *others]
    return changed(fit, record={"verdict": verdict}, diagnostics={"passed": False, "checks": checks})


@made_once
def make_fit_run(folder: Path, **options: Any) -> Path:
    """The run of `fit_run` in a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    fit_run(**options).write(folder)
    return folder


@made_once
def make_scored_run(
    folder: Path, *, worse: float = 0.0, shift: float = 0.0, about: Any = None, **options: Any
) -> Path:
    """A run of which each impact's density is lower by ``worse``, give or take a tenth of it.

    ``shift`` is added to the recordings, as another choice of the rest position would; ``about`` are entries
    of ``run.json``, and ``options`` those of `fit_run`.
    """
    groups = groups_of(fit := fit_run(**options))
    rng, impacts = np.random.default_rng(5), groups["constant_data"]
    less = xr.DataArray(worse * (1 + 0.1 * rng.standard_normal(PEOPLE * CONDITIONS)), dims="impact")
    of_groups = groups["log_likelihood_of_groups"]
    of_groups = of_groups.assign(traces=of_groups["traces"] - less.sum())
    for kind in ("subject", "trial"):
        levels = impacts[f"impact_{kind}"].to_numpy() == of_groups[kind].to_numpy()[:, None]
        of_levels = xr.DataArray(levels @ less.to_numpy(), dims=kind)
        of_groups[f"traces_of_{kind}"] = of_groups[f"traces_of_{kind}"] - of_levels
    scored = {
        "log_likelihood": groups["log_likelihood"] - less,
        "log_likelihood_of_groups": of_groups,
        "observed_data": groups["observed_data"] + shift,
    }
    folder.mkdir(parents=True, exist_ok=True)
    changed(fit, groups=scored, record=about).write(folder)
    return folder


def groups_of(fit: bt.Fit) -> dict[str, xr.Dataset]:
    return {name: group.to_dataset() for name, group in fit.posterior.children.items()}


def with_draws(fit: bt.Fit, moved: dict[str, xr.DataArray]) -> bt.Fit:
    """A fit of which some variables are others or new, in its summary too."""
    posterior, summary = fit.posterior["posterior"].to_dataset().assign(moved), fit.summary
    kept = summary[summary["variable"].isin(list(posterior)) & ~summary["variable"].isin(list(moved))]
    rows = pd.concat([kept, summarise(posterior[list(moved)]).assign(note="")], ignore_index=True)
    return changed(fit, groups={"posterior": posterior}, summary=rows)


def changed(
    fit: bt.Fit, *, groups: Any = None, record: Any = None, diagnostics: Any = None, **tables: Any
) -> bt.Fit:
    """A fit of which some groups, tables, and entries of ``run.json`` and ``diagnostics.json`` are others."""
    return replace(
        fit,
        about=_merged(fit.about, record or {}),
        diagnostics=_merged(fit.diagnostics, diagnostics or {}),
        posterior=xr.DataTree.from_dict(groups_of(fit) | (groups or {})),
        table=lambda name: tables[name] if name in tables else fit.table(name),
    )


def _merged(old: dict[str, Any], new: dict[str, Any]) -> dict[str, Any]:
    """The entries of both, those of tables within them too; an empty one leaves nothing of it."""
    tables = [name for name, entry in new.items() if entry and isinstance(old.get(name), dict)]
    return old | new | {name: _merged(old[name], new[name]) for name in tables}


if __name__ == "__main__":
    fit, (_, truth) = fit_of_drops(), drops()
    with TemporaryDirectory() as name:
        fit.write(Path(name))
        truth.to_csv(Path(name) / "truth.csv", index=False)
        pack(Path(name), STORED)
