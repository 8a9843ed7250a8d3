"""What a fit by spring and damper makes of tissue that stiffens, and of tissue that is what it assumes.

    .venv/bin/python benchmarks/model_form.py stiffening

Campaigns as those of coverage.py, of seeds that nothing else uses, fitted by models/impact.toml as
`bayestissue fit` does: once without a discrepancy, and where the residuals are plainly structured again with
one. A row a campaign, fit and impact has the posterior and the truth of the secant stiffness, and the score
of the residuals; a campaign that is warned of is a false alarm where tissue and model agree.
"""

from __future__ import annotations

import sys
from functools import partial

import numpy as np
import pandas as pd
from coverage import campaign
from evidence import measure
from studies import FEW_DRAWS, Fits, model_of, residuals_of, rows_of

from bayestissue.inference.checking.model_form import LIMIT, pooled_score
from bayestissue.recordings.dataset import Dataset
from bayestissue.studies.simulation import simulate

# Thirty right ones without an alarm have a rate below 10 %; a warning that is always raised takes fewer.
CAMPAIGNS = {"stiffening": 10, "kelvin_voigt": 30}
FIRST_SEED = 40_000
# Samples that all traces are filled up to, so that the fits of each model are compiled once.
LONGEST = 192


def of_fit(
    name: str, fits: Fits, data: Dataset, truth: np.ndarray, number: int
) -> tuple[float, pd.DataFrame]:
    """The score of a campaign's residuals, and its rows."""
    prepared = fits.prepared(data)
    draws, passed = fits.fit(prepared, number)
    impacts, score = draws.impacts, pooled_score(*residuals_of(prepared, draws, number))
    rows = rows_of({"K_secant": (impacts["K" if name == "plain" else "K_secant"], truth)})
    size = np.median(impacts["discrepancy"], axis=(0, 1)) if "discrepancy" in impacts else np.nan
    return score, rows.assign(fit=name, score=score, discrepancy=size, passed=passed)


def of_campaign(tissue: str, plain: Fits, wide: Fits, number: int) -> pd.DataFrame:
    """The rows of one fit, or of two."""
    result = simulate(campaign(tissue, number))
    data, truth = result.dataset("coverage"), result.truth
    secant = truth.get("K_secant_N_per_m", truth["K_N_per_m"]).to_numpy()
    score, rows = of_fit("plain", plain, data, secant, number)
    return pd.concat([rows, of_fit("discrepancy", wide, data, secant, number)[1]]) if score > LIMIT else rows


def main() -> None:
    tissue = sys.argv[1]
    specification = model_of("impact").model_copy(update={"sampler": FEW_DRAWS})
    first = simulate(campaign(tissue, FIRST_SEED)).dataset("first")
    always = specification.model_copy(update={"discrepancy": "always"})
    fits = (Fits(each, first, LONGEST) for each in (specification, always))
    numbers = range(FIRST_SEED, FIRST_SEED + CAMPAIGNS[tissue])
    measure(f"model_form-{tissue}", numbers, partial(of_campaign, tissue, *fits))


if __name__ == "__main__":
    main()
