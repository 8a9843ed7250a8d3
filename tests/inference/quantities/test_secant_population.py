"""K as the chain draws it, and the secant stiffness of the recorded impacts beside it."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest
import xarray as xr

from bayestissue.inference import fit
from bayestissue.inference.quantities.quantity_draws import Draws
from bayestissue.inference.quantities.secants import comparable_draws
from bayestissue.model.hierarchy.design import build_design
from bayestissue.model.hierarchy.specification import Formulas

PEOPLE, CONDITIONS, SHAPE = 4, 3, (2, 5)


class LabelledError(Exception):
    """Raised in place of labelling."""


def test_draws_of_k_are_labelled_as_the_chain_has_them(monkeypatch: pytest.MonkeyPatch) -> None:
    """Beside a discrepancy too, where K_secant is another number."""
    subject, trial = (each.ravel() for each in np.mgrid[:PEOPLE, :CONDITIONS])
    rows = pd.DataFrame({"subject": subject, "trial": trial, "mass_kg": 0.5 + 0.2 * trial})
    design = build_design(Formulas(), rows, reference_mass_kg=0.7, source="the model file")
    random = np.random.default_rng(1)
    population = {"intercept_K": (), "mass_exponent_K": (), "subject_effect_K": (4,), "trial_effect_K": (3,)}
    impacts = {name: np.exp(random.normal(7, 1, (*SHAPE, len(rows)))) for name in ("K", "K_secant")}
    drawn = Draws(
        {name: random.normal(size=(*SHAPE, *shape)) for name, shape in population.items()}, impacts, {}
    )
    seen: list[Draws] = []

    def tree(prepared: Any, specification: Any, statistics: Any, constrained: Any, seed: int) -> None:
        seen.append(constrained)
        raise LabelledError

    monkeypatch.setattr(fit, "posterior_tree", tree)
    prepared: Any = SimpleNamespace(design=design, model=SimpleNamespace(discrepancy=True))
    chains: Any = SimpleNamespace(log_likelihood=np.zeros(SHAPE))
    before = {name: values.copy() for name, values in {**drawn.population, **drawn.impacts}.items()}
    with pytest.raises(LabelledError):
        fit.label(prepared, Any, drawn, chains, 0, lambda *_: None)
    after = {**seen[0].population, **seen[0].impacts}
    for name, values in before.items():
        np.testing.assert_array_equal(after[name], values, err_msg=name)


@pytest.mark.parametrize("dimension", ["draw", "kept_draw"])
def test_these_impacts_and_each_person_s_have_the_geometric_mean_of_their_own(dimension: str) -> None:
    draws = np.exp(np.random.default_rng(2).normal(7, 0.3, (*SHAPE, 3)))
    people = np.array(["b", "a", "b"])
    posterior = xr.Dataset({"K_secant": (("chain", dimension, "impact"), draws)})
    found = comparable_draws(posterior, {"subject": people, "pad:site": people})
    assert set(found) == {"K_secant_of_impacts", "K_secant_of_subject", "K_secant_of_pad_site"}
    # Roundings of a logarithm, a sum and an exponential.
    close = {"rtol": 100 * np.finfo(float).eps}
    np.testing.assert_allclose(found["K_secant_of_impacts"], draws.prod(-1) ** (1 / 3), **close)
    of_people = found["K_secant_of_subject"]
    np.testing.assert_allclose(of_people.sel(subject="a"), draws[..., 1], **close)
    np.testing.assert_allclose(of_people.sel(subject="b"), np.sqrt(draws[..., 0] * draws[..., 2]), **close)
