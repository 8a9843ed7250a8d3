"""Reference posteriors: a fit beside 10,000 draws of the same density by another sampler.

    .venv/bin/python benchmarks/posteriors.py draw example
    .venv/bin/python benchmarks/posteriors.py

`draw` samples a case by numpyro's NUTS, four chains of 2,500 draws of `bt.numpyro_model`, and refuses those
whose R-hat is not below 1.01 or that diverge. Kept in posteriors.csv are mean, standard deviation and
quantiles of every quantity with their Monte Carlo errors. Cases are the example, and a campaign of each
element (`evidence.references`). A case is to be drawn again where its data or the model's density change,
which the sampler of the program does not touch.

Without it a fit of each case that was drawn is compared, the draws alone without the tables of a run: a row a
case, quantity and statistic.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pandas as pd
from evidence import measure
from evidence.references import OF_END, OF_MEDIAN, OF_SD, TISSUES, campaign
from numpyro.infer import MCMC, NUTS, init_to_value
from studies import model_of, of_draws

import bayestissue as bt
from bayestissue.base import runtime
from bayestissue.base.resources import shared
from bayestissue.inference.factors.expansions import expanded
from bayestissue.inference.fit import sample
from bayestissue.inference.quantities.quantity_draws import posterior_draws
from bayestissue.inference.results.summary import summarise
from bayestissue.model.hierarchy.specification import ModelSpecification
from bayestissue.model.hierarchy.trace_data import Prepared, named_model, prepare
from bayestissue.studies.fitting import resolve

TABLE = Path(__file__).with_suffix(".csv")
CHAINS, WARMUP, DRAWS, SEED = 4, 1000, 2500, 33
MOST_RHAT = 1.01
CASES = ("example", *TISSUES)
# The error of a statistic of nearly normal draws over that of their mean.
OF_MEAN = {"mean": 1.0, "sd": OF_SD, "q05": OF_END, "q50": OF_MEDIAN, "q95": OF_END}
STATISTICS: dict[str, dict[str, Any]] = {
    "mean": {"method": "mean"},
    "sd": {"method": "sd"},
    **{f"q{100 * p:02.0f}": {"method": "quantile", "prob": p} for p in (0.05, 0.5, 0.95)},
}


def case_of(case: str) -> tuple[bt.Dataset, ModelSpecification]:
    """The dataset of a case, and the model of its fit."""
    if case == "example":
        return bt.read_dataset(shared("data", "example")), model_of("impact")
    formula = dict.fromkeys("KC", "log(mass_kg) + side + (1|subject)")
    return campaign(case, 1), resolve(model_of(case), formulas=formula)[0]


def nuts_draws(prepared: Prepared) -> tuple[dict[str, np.ndarray], int]:
    """Draws [chain, draw, ...] of every quantity, and the divergent transitions."""
    centre = expanded(prepared).centre
    near = {"log_K_and_C": centre[:, :2]}
    near |= {name: centre[:, 2 + number] for number, name in enumerate(prepared.model.nuisance)}
    kernel = NUTS(named_model(prepared), target_accept_prob=0.9, init_strategy=init_to_value(values=near))
    mcmc = MCMC(
        kernel,
        num_warmup=WARMUP,
        num_samples=DRAWS,
        num_chains=CHAINS,
        chain_method="sequential",
        progress_bar=False,
    )
    mcmc.run(jax.random.PRNGKey(SEED), extra_fields=("diverging",))
    draws = {name: np.asarray(v) for name, v in mcmc.get_samples(group_by_chain=True).items()}
    # A standard deviation of what the design has not is 0.
    quantities = {name: v for name, v in draws.items() if v.ndim == 2 and np.ptp(v)}
    quantities |= {name: draws[name] for name in ("K", "C")}
    return quantities, int(mcmc.get_extra_fields()["diverging"].sum())


def moments(name: str, labels: list[str], draws: np.ndarray) -> pd.DataFrame:
    """Statistics [chain, draw, label] of one quantity, and their Monte Carlo errors."""
    from arviz_stats.base import array_stats

    rows = []
    for number, label in enumerate(labels):
        x = draws[..., number]
        row: dict[str, Any] = {"variable": name, "label": label, "r_hat": float(array_stats.rhat(x))}
        values = {"mean": x.mean(), "sd": x.std(ddof=1)}
        for key, options in STATISTICS.items():
            row[key] = values[key] if key in values else np.quantile(x, options["prob"])
            row[f"{key}_mcse"] = float(array_stats.mcse(x, **options))
        rows.append(row)
    return pd.DataFrame(rows)


def draw(case: str) -> None:
    """Draw a case, and keep its moments.

    Raises:
        SystemExit: the chains have not converged.
    """
    dataset, specification = case_of(case)
    prepared = prepare(dataset, specification, source="the model file")
    quantities, divergent = nuts_draws(prepared)
    impacts = prepared.impacts["impact"].astype(str).tolist()
    table = pd.concat(
        moments(name, impacts if v.ndim == 3 else [""], v.reshape(*v.shape[:2], -1))
        for name, v in quantities.items()
    )
    if divergent or table["r_hat"].max() >= MOST_RHAT:
        sys.exit(f"{case}: {divergent} divergent transitions, R-hat up to {table['r_hat'].max():.4f}")
    before = pd.read_csv(TABLE, dtype={"label": str}) if TABLE.exists() else pd.DataFrame({"case": []})
    table = pd.concat([before[before["case"] != case], table.assign(case=case)])
    table.to_csv(TABLE, index=False, float_format="%.7g", lineterminator="\n")


def compared(case: str) -> pd.DataFrame:
    """What a fit of a case gives, less the reference, and the Monte Carlo error of the difference."""
    dataset, specification = case_of(case)
    prepared, sampler = prepare(dataset, specification, source="the model file"), specification.sampler
    draws = posterior_draws(prepared, sample(prepared, sampler, SEED).thinned(sampler.draws), SEED)
    summary = summarise(of_draws(prepared, draws, SEED))
    keys = ["variable", "label"]
    reference = pd.read_csv(TABLE, dtype={"label": str}).fillna({"label": ""}).query("case == @case")
    merged = reference.merge(
        summary.fillna({"label": ""}).astype({"label": str}), on=keys, suffixes=("", "_fit")
    )
    named = {"mean": "mean_fit", "sd": "sd_fit", "q05": "eti90_low", "q50": "median", "q95": "eti90_high"}
    parts = [
        merged[keys].assign(
            statistic=key,
            sd=merged["sd"],
            difference=merged[column] - merged[key],
            mcse=np.hypot(merged[f"{key}_mcse"], OF_MEAN[key] * merged["mcse_mean"]),
        )
        for key, column in named.items()
    ]
    return pd.concat(parts)


def main() -> None:
    runtime.configure()
    if sys.argv[1:2] == ["draw"]:
        draw(sys.argv[2])
        return
    measure("posteriors", pd.read_csv(TABLE)["case"].unique(), compared)


if __name__ == "__main__":
    main()
