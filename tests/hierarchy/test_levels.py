from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from numpy.testing import assert_allclose

from bayestissue.inference.results.labels import design_variables, labelled
from bayestissue.model.hierarchy import derived
from bayestissue.model.hierarchy.design import Design
from bayestissue.model.hierarchy.formulas.group_terms import GroupTerm
from bayestissue.model.hierarchy.levels import design_at
from bayestissue.model.hierarchy.recorded import Recorded
from designs import REFERENCE, design_of, impacts

FORMULA = "log(mass_kg) + side + age + (log(mass_kg)|subject) + (1|subject:side) + (age|session) + (1|trial)"
DRAWS = (2, 5)


def sites_of(design: Design, rng: np.random.Generator) -> dict[str, np.ndarray]:
    population = {}
    for q, part in design.responses.items():
        population |= {name: rng.normal(size=DRAWS) for name in (f"intercept_{q}", f"mass_exponent_{q}")}
        population[f"covariate_effect_{q}"] = rng.normal(size=(*DRAWS, len(part.names)))
        population[f"sd_impact_{q}"] = rng.uniform(size=DRAWS)
        for term in part.terms:
            levels = len(design.groupings[term.grouping].levels)
            population[term.sd(q)] = rng.uniform(size=DRAWS)
            population[term.effect(q)] = rng.normal(size=(*DRAWS, levels))
    return population


@pytest.fixture(scope="module")
def known() -> tuple[Design, dict[str, np.ndarray], xr.Dataset, Recorded]:
    rows = impacts()
    design = design_of(FORMULA, rows=rows)
    population = sites_of(design, np.random.default_rng(1))
    values = derived.formula_quantities(design, population)
    values |= derived.level_quantities(design, values)
    draws = labelled(values, design.levels(), design_variables(design))
    table = rows[["subject", "trial", "side", "mass_kg", "age", "session"]].assign(velocity_m_s=1.5)
    return design, population, draws, Recorded(table, design.formulas.model_dump(), REFERENCE)


def test_every_recorded_row_has_the_value_that_the_fit_gave_it(known) -> None:
    design, population, draws, recorded = known
    columns = ["subject", "trial", "side", "mass_kg", "age", "session"]
    conditions = [row | {"session": f"{row['session']}"} for row in recorded.rows[columns].to_dict("records")]
    found = design_at(recorded, "K", conditions).log(draws)
    # The session's own slope needs the level's name and the covariate's number, which are not one column.
    assert_allclose(found, derived.row_logs(design, population, "K"), rtol=1e-9, atol=1e-9)


def test_a_row_of_the_design_says_whose_effects_count(known) -> None:
    recorded, of_sides, of_sessions = known[3], GroupTerm(("subject", "side")), GroupTerm(("session",), "age")
    asked = [{}, {"subject": "s1"}, {"subject": "s1", "side": "left"}, {"subject": "x", "side": "left"}]
    at = design_at(recorded, "K", asked)
    assert at.levels[of_sides] == [[], ["s1:left", "s1:right"], ["s1:left"], ["x:left"]]
    # Sides are averaged where they are not given, and the age of s1 is the person's own.
    assert_allclose(at.covariates["side[right]"], [0.5, 0.5, 0.0, 0.0])
    assert_allclose(at.multipliers[of_sessions], at.covariates["age"])
    assert_allclose(at.covariates["age"], np.array([0.0, 23.0, 23.0, 0.0]) - [0, 24.5, 24.5, 0])


def test_a_variable_has_what_a_question_answers(known) -> None:
    _, _, draws, recorded = known
    asked = {
        "K_subject": [{"subject": name} for name in recorded.levels("subject")],
        "K_side": [{"side": name} for name in recorded.levels("side")],
        "K_trial": [{"trial": f"t{k}", "mass_kg": mass} for k, mass in enumerate((0.5, 0.8, 1.2))],
        "K_subject_side": [
            dict(zip(("subject", "side"), name.split(":"), strict=True))
            for name in draws["subject:side"].to_numpy()
        ],
        "K_typical_person": [{}],
    }
    for name, conditions in asked.items():
        found = design_at(recorded, "K", conditions).log(draws)
        assert_allclose(found, np.log(draws[name].to_numpy().reshape(found.shape)), rtol=1e-9)
    both = design_at(recorded, "K", [{"side": name} for name in ("left", "right")]).log(draws)
    assert_allclose(np.log(draws["K_typical_person"]), both.mean(-1))


# Formula, and of each variable by its levels the truth in log K: 8 + 0.2 right + 0.3 hard + people's
# 0.01, 0.02 and 0.03, of their sides a few thousandths, of sessions 0.05 and 0.06, team b 0.1.
TABLE = [
    (
        "side + surface + (1|subject) + (1|session)",
        {
            "typical_person": [8.25],
            "side": [8.15, 8.35],
            "surface": [8.1, 8.4],
            "subject": [8.26, 8.27, 8.28],
            "session": [8.3, 8.31],
        },
    ),
    (
        "side + team + (1|subject/side)",
        {
            "typical_person": [8.15],
            "team": [8.1, 8.2],
            "subject": [8.111, 8.219, 8.231],
            "subject_side": [8.014, 8.208, 8.122, 8.316, 8.133, 8.329],
        },
    ),
    ("side*surface + (1|subject)", {"typical_person": [8.2], "side": [8.15, 8.25], "surface": [8.0, 8.4]}),
]


@pytest.mark.slow
@pytest.mark.parametrize(("formula", "truth"), TABLE)
def test_every_value_is_the_truth_at_the_levels_that_it_names(formula, truth) -> None:
    cells = [
        (person, team, side, surface, session)
        for person, team in (("s1", "a"), ("s2", "b"), ("s3", "b"))
        for side in ("left", "right")
        for surface in ("soft", "hard")
        for session in ("d1", "d2")
        for _ in range(2)
    ]
    rows = pd.DataFrame(cells, columns=["subject", "team", "side", "surface", "session"])
    rows = rows.assign(trial="t", mass_kg=np.resize([0.6, 1.0], len(rows)), velocity_m_s=1.0)
    design = design_of(formula, rows=rows)
    coefficients = {"side[right]": 0.2, "surface[soft]": -0.3, "team[b]": 0.1, "side:surface": -0.2}
    effects = {
        "subject": [0.01, 0.02, 0.03],
        "subject:side": [0.004, -0.002, 0.002, -0.004, 0.003, -0.001],
        "session": [0.05, 0.06],
    }
    one = np.ones((1, 1))
    population = {f"sd_impact_{q}": one for q in "KC"}
    for q, part in design.responses.items():
        # Of the first row, left and soft.
        population[f"intercept_{q}"] = 8.0 * one
        values = [coefficients.get(name, -0.2 if ":" in name else 0.0) for name in part.names]
        population[f"covariate_effect_{q}"] = (np.array(values) * part.scale)[None, None]
        for term in part.terms:
            population[term.sd(q)] = one
            population[term.effect(q)] = np.array(effects[term.grouping])[None, None]
    found = derived.level_quantities(design, derived.formula_quantities(design, population))
    for stem, logs in truth.items():
        assert_allclose(np.log(found[f"K_{stem}"]).ravel(), logs, rtol=1e-12, err_msg=stem)


def test_what_belongs_to_a_person_follows_the_person_and_nothing_follows_a_side() -> None:
    rows = impacts(people=3, repeats=1).assign(velocity_m_s=1.0)
    rows["mass_kg"] = rows.groupby("subject")["mass_kg"].transform("first")
    rows["session"] = rows["side"] + "1"
    columns = ["subject", "trial", "mass_kg", "age", "side", "session"]
    recorded = Recorded(rows[columns], {"K": "age + side + (1|session) + (1|subject)"}, 0.8)
    assert recorded.completed({"subject": "s2"}) == {"subject": "s2", "age": 26.0}
    assert recorded.completed({"subject": "s2", "age": 40.0})["age"] == 40.0
    assert recorded.completed({"subject": "nobody"}) == {"subject": "nobody"}
    assert recorded.completed({"side": "left"}) == {"side": "left"}
    assert recorded.completed({"session": "right1"}) == {"session": "right1", "side": "right"}


def test_a_new_level_has_an_effect_of_the_population(known) -> None:
    recorded = known[3]
    wide = xr.Dataset(
        {
            "intercept_K": (("chain", "draw"), np.zeros((2, 4000))),
            "sd_subject_K": (("chain", "draw"), np.full((2, 4000), 0.3)),
            "subject_effect_K": (("chain", "draw", "subject"), np.zeros((2, 4000, 1))),
        },
        {"subject": ["s0"]},
    )
    plain = Recorded(recorded.rows, {"K": "(1|subject)"}, REFERENCE)
    found = design_at(plain, "K", [{"subject": "x"}, {"subject": "x"}, {}, {"subject": "s0"}]).log(wide)
    assert found[..., 0].std() == pytest.approx(0.3, rel=3 / np.sqrt(2 * 8000))
    assert_allclose(found[..., 0], found[..., 1])
    assert not found[..., 2:].any()
    drawn = design_at(plain, "K", [{}]).log(wide, new_levels=1)
    assert drawn.std() == pytest.approx(0.3, rel=3 / np.sqrt(2 * 8000))


def test_columns_come_back_from_a_run() -> None:
    at = ("impact",)
    constants = xr.Dataset(
        {
            "mass_kg": (at, [1.0, 2.0]),
            "velocity_m_s": (at, [1.0, 1.0]),
            "impact_subject": (at, ["a", "b"]),
            "impact_trial": (at, ["t", "t"]),
            "impact_subject_side": (at, ["a:left", "b:right"]),
            "column_my_side": xr.Variable(at, ["left", "right"], {"column": "my:side"}),
            "column_age": xr.Variable(at, [20.0, 30.0], {"column": "age"}),
        }
    )
    model = {"formula": {"K": "age + shoe"}, "reference_mass_kg": 1.5}
    recorded = Recorded.of_run(constants, model)
    assert set(recorded.rows) == {"mass_kg", "velocity_m_s", "subject", "trial", "my:side", "age"}
    assert recorded.is_number("age")
    assert recorded.levels("my:side") == ["left", "right"]
    pd.testing.assert_series_equal(
        recorded.rows["subject"], pd.Series(["a", "b"], name="subject"), check_dtype=False
    )
