from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose

from bayestissue.model.hierarchy.derived import hypotheses, lines_of_means
from bayestissue.model.hierarchy.specification import Formulas, ModelSpecification
from bayestissue.recordings.dataset.published import read_published
from bayestissue.thesis.reanalysis.observations import published_design, published_observations


def test_probabilities_of_the_regions_add_up_to_one() -> None:
    draws = np.array([[-0.5, -0.1, 0.05, 0.1, 0.5, 0.9, 1.05, 1.1, 2.0, 1.0]])
    table = hypotheses({"K": draws, "C": draws + 5}, 0.1)
    by = table.set_index(["quantity", "hypothesis"])["probability"]
    assert_allclose(by.groupby("quantity").sum(), 1, atol=1e-12)
    assert_allclose(
        by["K"][["below both", "fixed stiffness", "between", "constant natural frequency", "above both"]],
        [0.1, 0.2, 0.2, 0.3, 0.2],
    )
    assert by["C", "above both"] == 1


def test_the_straight_line_through_exact_stiffness_is_found() -> None:
    observations = published_observations(read_published())
    specification = ModelSpecification(name="x", likelihood="published-estimates")
    plain = Formulas(K="1 + (1|subject) + (1|trial)", C="1 + (1|subject) + (1|trial)")
    design = published_design(observations, specification, formulas=plain)
    mass = observations.cells["mass_kg"].to_numpy(float)
    a, b = 0.5, 23.0
    by_trial = observations.cells.drop_duplicates("trial")["mass_kg"].to_numpy(float)
    sites = {}
    for q in "KC":
        sites |= {
            f"intercept_{q}": np.zeros((1, 1)),
            f"sd_impact_{q}": np.zeros((1, 1)),
            f"subject_effect_{q}": np.zeros((1, 1, 10)),
            f"trial_effect_{q}": np.log(a + b * by_trial)[None, None],
        }
    lines = lines_of_means(design, sites, mass)
    assert_allclose(lines["linear_slope_K"], b, rtol=1e-11)
    assert_allclose(lines["linear_intercept_K"], a, rtol=1e-10)
    # A lognormal scatter of 0.3 raises every mean by exp(0.3² / 2).
    scattered = lines_of_means(design, sites | {"sd_impact_K": np.full((1, 1), 0.3)}, mass)
    assert_allclose(scattered["linear_slope_K"], b * np.exp(0.045), rtol=1e-11)
