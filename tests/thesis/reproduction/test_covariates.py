from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from bayestissue.recordings.dataset.published import PublishedTables
from bayestissue.thesis.reproduction.conditions import covariate, factors, has_mass

TABLE = pd.DataFrame({"energy_J": [2.0, 3.0], "velocity_m_s": [5.0, 7.0], "mass_kg": [11.0, 13.0]})


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("Mass", [11, 13]),
        ("Mass Seq", [121, 169]),
        ("Energy Sq", [4, 9]),
        ("Energy* Mass *Velocity", [110, 273]),
        ("Velocity*Energy", [10, 21]),
        ("Energy * Velocity", [10, 21]),
    ],
)
def test_a_name_is_a_product(name: str, values: list[float]) -> None:
    found = covariate(name, TABLE)
    assert found is not None
    np.testing.assert_array_equal(found, values)
    assert has_mass(name) == ("Mass" in name)


@pytest.mark.parametrize("name", ["Skin Fold", "Skin Fold+ Muscle Thickness", "Muscle Thickness"])
def test_tissue_was_never_tabulated(name: str) -> None:
    assert covariate(name, TABLE) is None
    assert not has_mass(name)


def test_equal_products_have_equal_factors() -> None:
    assert factors("Velocity*Energy") == factors("Energy * Velocity")
    assert factors("Mass Seq") == factors("Mass Sq") == factors("Mass * Mass")


def test_every_published_name_is_understood(published: PublishedTables) -> None:
    names = {*published.correlations["variable"], *published.stepwise["variable"]}
    unknown = {name for name in names if covariate(name, TABLE) is None}
    assert all("Skin" in name or "Muscle" in name for name in unknown)
