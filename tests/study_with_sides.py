"""A study of people's two sides with draws that are made up."""

from __future__ import annotations

import numpy as np

from bayestissue.inference.answers.study import Study
from designs import design_of, impacts, labelled_draws

SHAPE = (2, 100)


def study_with_sides(
    formula: str = "side + (1|subject/side)", of_C: str = "age + side + (1|subject/side)"
) -> Study:
    """Person s0 was hit on the left alone; an age that no formula of K has goes with each person."""
    rows = impacts().assign(velocity_m_s=1.5)
    rows = rows[(rows["subject"] != "s0") | (rows["side"] == "left")].reset_index(drop=True)
    design, rng = design_of(formula, of_C, rows=rows), np.random.default_rng(1)
    population = {"residual_correlation": np.zeros(SHAPE)}
    for q, part in design.responses.items():
        population |= {
            f"intercept_{q}": 7 + 0.05 * rng.standard_normal(SHAPE),
            f"sd_impact_{q}": np.full(SHAPE, 0.1),
        }
        population[f"covariate_effect_{q}"] = 0.1 * part.scale + 0.01 * rng.standard_normal(
            (*SHAPE, len(part.names))
        )
        if part.log_mass is not None:
            population[f"mass_exponent_{q}"] = 0.5 + 0.05 * rng.standard_normal(SHAPE)
        for term in part.terms:
            levels = len(design.groupings[term.grouping].levels)
            population[term.sd(q)] = np.full(SHAPE, 0.2)
            population[term.effect(q)] = 0.2 * rng.standard_normal((*SHAPE, levels))
    return Study(labelled_draws(design, population), design.recorded)
