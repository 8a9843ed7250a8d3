"""K as the secant stiffness of a fit with a discrepancy."""

import numpy as np
import pandas as pd

from bayestissue.hierarchy.design import Design, build_design
from bayestissue.hierarchy.specification import Formulas
from bayestissue.inference.quantities.secants import shifted

PEOPLE, CONDITIONS, DRAWS = 4, 3, 5
EPSILON = np.finfo(float).eps


def balanced_design() -> Design:
    subject, trial = (each.ravel() for each in np.mgrid[:PEOPLE, :CONDITIONS])
    mass = 0.7 * np.exp(np.linspace(-0.5, 0.5, CONDITIONS)[trial])
    rows = pd.DataFrame({"subject": subject, "trial": trial, "mass_kg": mass})
    return build_design(Formulas(), rows, reference_mass_kg=0.7, source="the model file")


def test_a_shift_of_the_hierarchy_s_own_shape_goes_where_it_belongs() -> None:
    design, random = balanced_design(), np.random.default_rng(1)
    line = random.normal(size=(2, DRAWS, 2))
    person = random.normal(size=(2, DRAWS, PEOPLE))
    person -= person.mean(-1, keepdims=True)
    log_mass = design.responses["K"].log_mass
    assert log_mass is not None
    shift = line[..., :1] + line[..., 1:] * log_mass + person[..., design.subject]
    sites = {
        "intercept_K": np.full((2, DRAWS), 8.0),
        "mass_exponent_K": np.zeros((2, DRAWS)),
        "subject_effect_K": np.zeros((2, DRAWS, PEOPLE)),
        "trial_effect_K": np.zeros((2, DRAWS, CONDITIONS)),
    }
    found = shifted(design, sites, shift)
    # A dozen sums of a dozen numbers of order one, and 8 beside them.
    limit = 200 * EPSILON
    np.testing.assert_allclose(found["intercept_K"], 8 + line[..., 0], rtol=0, atol=limit)
    np.testing.assert_allclose(found["mass_exponent_K"], line[..., 1], rtol=0, atol=limit)
    np.testing.assert_allclose(found["subject_effect_K"], person, rtol=0, atol=limit)
    np.testing.assert_allclose(found["trial_effect_K"], 0, rtol=0, atol=limit)


def test_what_one_impact_has_alone_goes_to_its_person_and_condition_in_part() -> None:
    design = balanced_design()
    shift = np.zeros((1, 1, PEOPLE * CONDITIONS))
    shift[..., 0] = 1.0
    names = {
        "intercept_K": (),
        "mass_exponent_K": (),
        "subject_effect_K": (PEOPLE,),
        "trial_effect_K": (CONDITIONS,),
    }
    sites = {name: np.zeros((1, 1, *shape)) for name, shape in names.items()}
    found = shifted(design, sites, shift)
    log_mass = design.responses["K"].log_mass
    assert log_mass is not None
    rows = (
        found["intercept_K"][..., None]
        + found["mass_exponent_K"][..., None] * log_mass
        + found["subject_effect_K"][..., design.subject]
        + found["trial_effect_K"][..., design.trial]
    )
    # The two-way layout's own projection: row mean + column mean - mean.
    table = shift.reshape(PEOPLE, CONDITIONS)
    expected = table.mean(1, keepdims=True) + table.mean(0) - table.mean()
    np.testing.assert_allclose(rows.reshape(PEOPLE, CONDITIONS), expected, rtol=0, atol=100 * EPSILON)
