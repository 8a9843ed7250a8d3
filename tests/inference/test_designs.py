"""Nested, crossed and slope terms: names and dimensions of what follows from their draws."""

from __future__ import annotations

import numpy as np

from designs import any_draws, design_of

FORMULA = "log(mass_kg) + (log(mass_kg)|subject) + (1|subject:side) + (1|session)"


def test_dimensions_and_meanings_follow_the_columns() -> None:
    design = design_of(FORMULA, "(1|subject) + (1|side)")
    found = any_draws(design, np.random.default_rng(1), (2, 3))
    dims = {str(name): array.dims[2:] for name, array in found.data_vars.items()}
    assert dims["subject_side_effect_K"] == dims["K_subject_side"] == ("subject:side",)
    assert dims["subject_mass_exponent_K"] == dims["subject_effect_C"] == ("subject",)
    assert dims["side_effect_C"] == ("side",)
    assert dims["sd_subject_mass_exponent_K"] == dims["sd_subject_side_K"] == dims["sd_side_C"] == ()
    assert found["subject:side"].to_numpy()[0] == "s0:left"
    assert found["session_effect_K"].sizes["session"] == 3
    for name, array in found.data_vars.items():
        assert array.attrs["unit"], name
        assert array.attrs["long_name"], name
    assert found["K_subject_side"].attrs["unit"] == "N/m"
