"""What a fit by spring and damper makes of tissue that stiffens, and of tissue that is what it assumes.

    .venv/bin/python benchmarks/model_form.py

Campaigns as those of coverage_elements.py, of seeds that nothing else uses, fitted by models/impact.toml as
`bayestissue fit` does: once without a discrepancy, and where the residuals are plainly structured again with
one. The table has the campaigns that were warned of, which are false alarms where tissue and model agree, and
of each fit the share of impacts whose 90 % interval of the secant stiffness holds the truth; width and error
are relative to that truth. It goes to model_form.csv.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np
import pandas as pd
from coverage_elements import campaign_of
from coverage_fit import Fits, kept_with
from evidence import recorded
from jaxtyping import Float

from bayestissue import runtime
from bayestissue.hierarchy.specification import ModelSpecification, read_specification
from bayestissue.hierarchy.trace_data import Prepared
from bayestissue.inference.checking.model_form import LIMIT, pooled_score
from bayestissue.inference.results.tree import predicted
from bayestissue.inference.samplers.sampling import ConstrainedDraws
from bayestissue.simulation import simulate

CAMPAIGNS = 12
FIRST_SEED = 40_000
LEVEL = 0.9
ROOT = Path(__file__).parents[1]
TABLE = ROOT / "benchmarks" / "model_form.csv"


def score_of(prepared: Prepared, found: ConstrainedDraws, seed: int) -> float:
    """See `bayestissue.inference.checking.model_form`."""
    replicated = predicted(prepared, found, seed)["deceleration"]
    signal = prepared.signal
    inside = np.arange(signal.x.shape[1]) < signal.n_samples[:, None]
    measured = np.where(inside, signal.deceleration, np.nan)
    return pooled_score(measured, replicated.reshape(-1, *measured.shape).astype(float))


def rows_of(values: Float[np.ndarray, "chain draw impact"], true: np.ndarray) -> pd.DataFrame:
    """Of each impact: whether the interval holds the truth, its width, and how far off its median is."""
    flat = values.reshape(-1, values.shape[-1])
    low, middle, high = np.quantile(flat, [(1 - LEVEL) / 2, 0.5, (1 + LEVEL) / 2], axis=0)
    held = (low <= true) & (true <= high)
    return pd.DataFrame({"held": held, "width": (high - low) / true, "off": np.abs(middle / true - 1)})


def measured(name: str, specification: ModelSpecification, campaigns: int) -> pd.DataFrame:
    """One row an impact and fit."""
    first = simulate(campaign_of(name, FIRST_SEED)).dataset("first")
    always = specification.model_copy(update={"discrepancy": "always"})
    plain, wide = (Fits(each, first, exact=True) for each in (specification, always))
    begun, rows = time.perf_counter(), []
    for number in range(FIRST_SEED, FIRST_SEED + campaigns):
        made = campaign_of(name, number)
        result = simulate(made)
        data, truth = result.dataset(made.name), result.truth
        true = truth.get("K_secant_N_per_m", truth["K_N_per_m"]).to_numpy()
        prepared = plain.prepared(data)
        found, correction = plain.fit(prepared, number)
        score = score_of(prepared, found, number)
        about = {"campaign": number, "score": score, "warned": score > LIMIT}
        once = rows_of(found.impacts["K"], true).assign(fit="plain", exact=not correction.trusted, **about)
        rows.append(once.assign(discrepancy=np.nan, left=np.nan))
        if score > LIMIT:
            prepared = wide.prepared(data)
            found, correction = wide.fit(prepared, number)
            size = np.median(found.impacts["discrepancy"], axis=(0, 1))
            again = rows_of(found.impacts["K_secant"], true).assign(
                fit="discrepancy", exact=not correction.trusted, **about
            )
            rows.append(again.assign(discrepancy=size, left=score_of(prepared, found, number)))
        last = rows[-1]
        print(
            f"{name} {number}: score {score:.1f}, held {last['held'].mean():.2f}, Pareto k "
            f"{correction.pareto_k:.2f}, {time.perf_counter() - begun:.0f} s",
            flush=True,
        )
    return pd.concat(rows, ignore_index=True)


def summarised(name: str, rows: pd.DataFrame, command: str) -> pd.DataFrame:
    """One line a fit."""
    lines = []
    for fit, part in rows.groupby("fit", sort=False):
        each = part.groupby("campaign")
        shares = each["held"].mean()
        lines.append(
            {
                "tissue": name,
                "fit": fit,
                "campaigns": len(each),
                "warned": int(each["warned"].first().sum()),
                "least_score": round(float(part["score"].min()), 1),
                "greatest_score": round(float(part["score"].max()), 1),
                "greatest_score_left": round(float(part["left"].max()), 1),
                "impacts": len(part),
                "held_90": int(part["held"].sum()),
                "share": round(float(part["held"].mean()), 4),
                "campaign_se": round(float(shares.std(ddof=1) / np.sqrt(len(each))), 4),
                "median_width": float(f"{part['width'].median():.3g}"),
                "median_error": float(f"{part['off'].median():.3g}"),
                "median_discrepancy": float(f"{part['discrepancy'].median():.3g}"),
                "by_exact_path": int(each["exact"].first().sum()),
                "command": command,
            }
        )
    return pd.DataFrame(lines)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--campaigns", type=int, default=CAMPAIGNS)
    parser.add_argument("--tissue", choices=("stiffening", "kelvin_voigt"), action="append")
    asked = parser.parse_args()
    runtime.configure(one_core=True)
    specification = read_specification(ROOT / "models" / "impact.toml")
    for name in asked.tissue or ("stiffening", "kelvin_voigt"):
        command = f"benchmarks/model_form.py --tissue {name}"
        with recorded(f"model_form-{name}", command) as record:
            if asked.campaigns < CAMPAIGNS:
                record.left = f"{CAMPAIGNS - asked.campaigns} of {CAMPAIGNS} campaigns"
            lines = summarised(name, measured(name, specification, asked.campaigns), command)
            kept_with(TABLE, lines, "tissue")


if __name__ == "__main__":
    main()
