from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pandas as pd
from numpy.testing import assert_allclose

from bayestissue.model.hierarchy.design import Design, build_design
from bayestissue.model.hierarchy.population import covariances_of, population_design
from bayestissue.model.hierarchy.priors import Priors
from bayestissue.model.hierarchy.specification import Formulas

NUISANCE = ("noise", "atanh_theta1")
WHOLE = "log(mass_kg) + age + (1|subject) + (1|trial)"


def design(repeats: int, formulas: Formulas | None = None) -> Design:
    """Three people in two conditions, each of them ``repeats`` times."""
    people, conditions = np.arange(3).repeat(2), np.tile(np.arange(2), 3)
    rows = pd.DataFrame(
        {
            "subject": [f"s{p}" for p in people],
            "trial": [f"t{c}" for c in conditions],
            "mass_kg": np.where(conditions == 0, 0.5, 1.2),
            "age": 20.0 + 7 * people**2,
        }
    )
    rows = rows.loc[np.tile(np.arange(6), repeats)].reset_index(drop=True)
    formulas = formulas or Formulas(K=WHOLE, C=WHOLE)
    return build_design(formulas, rows, reference_mass_kg=0.8, source="m.toml")


def test_impacts_of_one_cell_share_its_row() -> None:
    _, columns = population_design(design(4), Priors(), NUISANCE)
    assert sorted(np.unique(columns.cell, return_counts=True)[1]) == [4] * 6
    # People whom no term asks for share cells.
    of_mass = Formulas(K="log(mass_kg) + (1|trial)", C="log(mass_kg) + (1|trial)")
    _, columns = population_design(design(2, of_mass), Priors(), NUISANCE)
    assert sorted(np.unique(columns.cell, return_counts=True)[1]) == [6, 6]


def test_an_error_of_mass_moves_both_logs_alike() -> None:
    locations, _ = population_design(design(2), Priors(), NUISANCE)
    assert locations.mean[locations.parts["intercept_C"]] == Priors().intercept.C.mean
    assert locations.sd[locations.parts["noise_mean"]] == Priors().noise.sd
    sites = {name: jnp.asarray(0.1 * (1 + k)) for k, name in enumerate(sorted(set(locations.spread) - {""}))}
    sites |= {"sd_impact_K": jnp.asarray(0.3), "sd_impact_C": jnp.asarray(0.5)}
    sites |= {"residual_correlation": jnp.asarray(-0.4), "sd_noise": jnp.asarray(0.7)}
    sites |= {"sd_atanh_theta1": jnp.asarray(0.2)}
    spread = covariances_of(locations, sites, 0.05, NUISANCE)
    assert_allclose(spread.pair, [0.09 + 0.0025, -0.06 + 0.0025, 0.25 + 0.0025], rtol=1e-12)
    assert_allclose(spread.nuisance, [0.7, 0.2])
    for name, place in locations.parts.items():
        known = locations.sd[place]
        wanted = known if np.isfinite(known).all() else sites[locations.spread[place.start]]
        assert_allclose(spread.locations[place], wanted, err_msg=name)
    without = {name: value for name, value in sites.items() if name != "residual_correlation"}
    assert_allclose(covariances_of(locations, without, 0.0, NUISANCE).pair[1], 0.0)
