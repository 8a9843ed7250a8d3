"""Planned studies whose impactors were weighed once each: what is drawn, and what a running one has."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose

from bayestissue.model.hierarchy.specification import Formulas, MassError, ModelSpecification
from bayestissue.studies.planning.design_prior import BLOCK, DesignPrior, PlannedPopulation, Streams, Truths
from bayestissue.studies.planning.studies import Arrangement, Studies, arrangements, draw_studies

MASS_SD, EXACT = 0.05, 1e12
FORMULA = Formulas(K="log(mass_kg) + (1|subject)", C="log(mass_kg) + (1|subject)")


def planned(masses: list[float], whose: MassError) -> Arrangement:
    rows = pd.DataFrame(
        {
            "subject": np.repeat(["a", "b", "c"], 2 * len(masses)),
            "trial": np.tile(np.repeat([f"m{mass}" for mass in masses], 2), 3),
            "mass_kg": np.tile(np.repeat(masses, 2), 3),
            "velocity_m_s": 1.5,
        }
    )
    formula = FORMULA if len(masses) > 1 else Formulas(K="(1|subject)", C="(1|subject)")
    specification = ModelSpecification(name="m", likelihood="impact", formula=formula, mass_error=whose)
    (made,) = arrangements([rows], specification, reference_mass_kg=0.7, relative_mass_sd=MASS_SD)
    return replace(made, precision=np.tile(EXACT * np.eye(2), (len(rows), 1, 1)))


def drawn(made: Arrangement, mass_errors: np.ndarray | None = None) -> Studies:
    """Studies without scatter between impacts, so that people and errors of masses are all that is seen."""
    streams = Streams(1, 0)
    truths = DesignPrior(PlannedPopulation()).truths(made.model, made.design, streams)
    none = {name: np.zeros(BLOCK) for name in truths.hyperparameters if name.startswith("sd_impact")}
    truths = Truths(truths.hyperparameters | none, truths.fixed, truths.effects, mass_errors)
    return draw_studies(made, truths, streams)


def errors_seen(made: Arrangement, studies: Studies) -> np.ndarray:
    """True less seen log K of each impact, [study, impact]."""
    parts, part = made.model.locations.parts, made.design.responses["K"]
    log_K = studies.b[:, [parts["intercept_K"].start]] + np.zeros(len(made.rows))
    if part.log_mass is not None:
        log_K = log_K + studies.b[:, [parts["mass_exponent_K"].start]] * part.log_mass
    return log_K + studies.b[:, parts["subject_effect_K"]][:, made.design.subject] - studies.centre[..., 0]


def test_impacts_of_one_mass_share_an_error_of_the_declared_size() -> None:
    made = planned([0.5, 1.0], "mass")
    seen = errors_seen(made, drawn(made))
    light = made.rows["mass_kg"].to_numpy() == 0.5
    for same in (light, ~light):
        assert_allclose(seen[:, same], np.broadcast_to(seen[:, same][:, :1], seen[:, same].shape), atol=1e-4)
        # A standard deviation's relative standard error is 1 / sqrt(2 n).
        assert seen[:, same][:, 0].std() == pytest.approx(MASS_SD, rel=4 / np.sqrt(2 * BLOCK))
    assert abs(np.corrcoef(seen[:, light][:, 0], seen[:, ~light][:, 0])[0, 1]) < 4 / np.sqrt(BLOCK)


@pytest.mark.parametrize("masses", [[0.5, 1.0], [0.7]])
def test_an_impactor_that_has_hit_already_is_as_wrong_as_it_was(masses: list[float]) -> None:
    made = planned(masses, "mass")
    # The first impact was recorded: of the lighter mass.
    known = np.random.default_rng(3).normal(size=(BLOCK, 1))
    seen, alike = errors_seen(made, drawn(made, known)), errors_seen(made, drawn(made))
    recorded = made.rows["mass_kg"].to_numpy() == masses[0]
    assert_allclose(seen[:, recorded], np.broadcast_to(known, seen[:, recorded].shape), atol=1e-4)
    assert_allclose(seen[:, ~recorded], alike[:, ~recorded], atol=1e-4)
