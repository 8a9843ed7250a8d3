"""What a fit by spring and damper makes of tissue that stiffens, and of tissue that is what it assumes.

    .venv/bin/python benchmarks/model_form.py stiffening

Campaigns as those of coverage.py, of seeds that nothing else uses, fitted by models/impact.toml as
`bayestissue fit` does: once without a discrepancy, and where the residuals are plainly structured again with
one. A row a campaign, fit and impact has the posterior and the truth of the secant stiffness, and the score
of the residuals; a campaign that is warned of is a false alarm where tissue and model agree.
"""

from __future__ import annotations

import sys

import numpy as np
import pandas as pd
from coverage import KEPT, Fits, campaign_of, model_of, residuals_of, rows_of
from evidence import recorded

from bayestissue.base import runtime
from bayestissue.inference.checking.model_form import LIMIT, pooled_score
from bayestissue.model.hierarchy.specification import Sampler
from bayestissue.recordings.dataset import Dataset
from bayestissue.studies.simulation import simulate

# Thirty right ones without an alarm have a rate below 10 %; a warning that is always raised takes fewer.
CAMPAIGNS = {"stiffening": 10, "kelvin_voigt": 30}
FIRST_SEED = 40_000
# Samples that all traces are filled up to, so that the fits of each model are compiled once.
LONGEST = 192
# So many draws know an end of an interval to one or two hundredths of probability.
SAMPLER = Sampler(draws=KEPT, effective=200)


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


def main() -> None:
    tissue = sys.argv[1]
    runtime.configure()
    with recorded(f"model_form-{tissue}") as record:
        specification = model_of("impact").model_copy(update={"sampler": SAMPLER})
        first = simulate(campaign_of(tissue, FIRST_SEED)).dataset("first")
        always = specification.model_copy(update={"discrepancy": "always"})
        plain, wide = (Fits(each, first, LONGEST) for each in (specification, always))
        for number in record.missing(range(FIRST_SEED, FIRST_SEED + CAMPAIGNS[tissue])):
            simulation = campaign_of(tissue, number)
            result = simulate(simulation)
            data, truth = result.dataset(simulation.name), result.truth
            secant = truth.get("K_secant_N_per_m", truth["K_N_per_m"]).to_numpy()
            score, rows = of_fit("plain", plain, data, secant, number)
            if score > LIMIT:
                _, again = of_fit("discrepancy", wide, data, secant, number)
                rows = pd.concat([rows, again])
            record.add(number, rows)


if __name__ == "__main__":
    main()
