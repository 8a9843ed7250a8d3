from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from numpy.testing import assert_allclose

from bayestissue.hierarchy import derived
from bayestissue.hierarchy.design import Design
from bayestissue.inference.answers.levels import Recorded, log_at_levels
from bayestissue.inference.results.labels import design_dimensions, labelled
from designs import REFERENCE, design_of, impacts

FORMULA = "log(mass_kg) + side + age + (log(mass_kg)|subject) + (1|subject:side) + (age|session) + (1|trial)"
DRAWS = (2, 5)


def sites_of(design: Design, rng: np.random.Generator) -> dict[str, np.ndarray]:
    sites = {}
    for q, part in design.responses.items():
        sites |= {name: rng.normal(size=DRAWS) for name in (f"intercept_{q}", f"mass_exponent_{q}")}
        sites[f"covariate_effect_{q}"] = rng.normal(size=(*DRAWS, len(part.names)))
        sites[f"sd_impact_{q}"] = rng.uniform(size=DRAWS)
        for term in part.terms:
            levels = len(design.groupings[term.grouping].levels)
            sites[term.sd(q)] = rng.uniform(size=DRAWS)
            sites[term.effect(q)] = rng.normal(size=(*DRAWS, levels))
    return sites


@pytest.fixture(scope="module")
def known() -> tuple[Design, dict[str, np.ndarray], xr.Dataset, Recorded]:
    rows = impacts()
    design = design_of(FORMULA, rows=rows)
    sites = sites_of(design, np.random.default_rng(1))
    values = derived.reported_sites(design, sites) | derived.people_and_conditions(design, sites)
    coordinates = {name: list(grouping.levels) for name, grouping in design.groupings.items()}
    draws = labelled(values, design_dimensions(design), coordinates)
    table = rows[["subject", "trial", "side", "mass_kg", "age", "session"]].assign(velocity_m_s=1.5)
    return design, sites, draws, Recorded(table, design.formulas.model_dump(), REFERENCE)


def test_every_recorded_row_has_the_value_that_the_fit_gave_it(known) -> None:
    design, sites, draws, recorded = known
    columns = ["subject", "trial", "side", "mass_kg", "age", "session"]
    conditions = [row | {"session": f"{row['session']}"} for row in recorded.rows[columns].to_dict("records")]
    found = log_at_levels(draws, recorded, "K", conditions)
    # The session's own slope needs the level's name and the covariate's number, which are not one column.
    assert_allclose(found, derived.row_logs(design, sites, "K"), rtol=1e-9, atol=1e-9)


def test_a_level_alone_is_at_the_reference(known) -> None:
    _, _, draws, recorded = known
    # The mean age is of the reference; a person's own follows the person unless it is given.
    at = {"age": recorded.reference["age"], "side": recorded.reference["side"]}
    conditions = [{"subject": name, **at} for name in recorded.levels("subject")]
    own = log_at_levels(
        draws, recorded, "K", [{k: v for k, v in c.items() if k != "side"} for c in conditions]
    )
    assert_allclose(own, np.log(draws["K_subject"]), rtol=1e-9)
    typical = log_at_levels(draws, recorded, "K", [{}])
    assert_allclose(typical[..., 0], draws["intercept_K"])


def test_what_belongs_to_a_person_follows_the_person_and_mass_does_not() -> None:
    rows = impacts(people=3, repeats=1).assign(velocity_m_s=1.0)
    rows["mass_kg"] = rows.groupby("subject")["mass_kg"].transform("first")
    recorded = Recorded(rows[["subject", "trial", "mass_kg", "age", "side"]], {"K": "age + (1|subject)"}, 0.8)
    assert recorded.completed({"subject": "s2"}) == {"subject": "s2", "age": 26.0}
    assert recorded.completed({"subject": "s2", "age": 40.0})["age"] == 40.0
    assert recorded.completed({"side": "left"}) == {"side": "left"}
    assert recorded.completed({"subject": "nobody"}) == {"subject": "nobody"}


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
    found = log_at_levels(wide, plain, "K", [{"subject": "x"}, {"subject": "x"}, {}, {"subject": "s0"}])
    assert found[..., 0].std() == pytest.approx(0.3, rel=3 / np.sqrt(2 * 8000))
    assert_allclose(found[..., 0], found[..., 1])
    assert not found[..., 2:].any()
    drawn = log_at_levels(wide, plain, "K", [{}], new_levels=1)
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
    assert recorded.lacking == ("shoe",)
    assert recorded.is_number("age")
    assert recorded.levels("my:side") == ["left", "right"]
    pd.testing.assert_series_equal(
        recorded.rows["subject"], pd.Series(["a", "b"], name="subject"), check_dtype=False
    )
