from __future__ import annotations

import pytest

from bayestissue.studies.estimates import MASSES_KG, centring_table


def test_centring_on_the_sample_mean_makes_a_mass_dependence_of_one_tissue():
    table = centring_table()
    assert tuple(table["mass_kg"]) == MASSES_KG
    # About the mean, a prototype gave these; it integrated and found contact in its own way.
    assert list(table["K_centred"]) == pytest.approx([6770, 6440, 6380, 6310], rel=0.03)
    assert list(table["C_centred"]) == pytest.approx([54, 64, 75, 83], rel=0.03)
