"""Group terms of any number: their grammar, what is refused, their columns, priors and names."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from bayestissue.base.errors import InputError
from bayestissue.model.hierarchy import derived
from bayestissue.model.hierarchy.formulas.formula import resolve
from bayestissue.model.hierarchy.formulas.group_terms import GroupTerm
from bayestissue.model.hierarchy.population import expected, population_design
from bayestissue.model.hierarchy.specification import ModelSpecification
from designs import EVERYTHING, REFERENCE, design_of, impacts, indicator


@pytest.mark.parametrize(
    ("formula", "read_as"),
    [
        ("(1|subject:side)", "(1|subject:side)"),
        ("(1|subject/side)", "(1|subject) + (1|subject:side)"),
        ("(1|subject) + (0 + log(mass_kg)|subject)", "(log(mass_kg)|subject)"),
        ("room + (room + log(mass_kg)|subject)", "room + (room + log(mass_kg)|subject)"),
        (EVERYTHING, EVERYTHING),
    ],
)
def test_a_formula_is_read_and_written_as_it_is_meant(formula: str, read_as: str) -> None:
    found = resolve(formula, impacts(), REFERENCE)
    assert not found.faults
    assert str(found.terms) == read_as
    assert resolve(read_as, impacts(), REFERENCE).terms == found.terms


@pytest.mark.slow
@pytest.mark.parametrize(
    ("formula", "reason", "left"),
    [
        ("(1|room)", "with one impact of each room", "1"),
        ("(1|nation)", "there is one nation only", "1"),
        ("(1|impact)", "an impact's own scatter is in every model", "1"),
        ("(1|session) + (1|day)", "every session has one day", "(1|session)"),
        ("(age|subject)", "age has one value in every subject", "(1|subject)"),
        ("(side|subject)", "side is a category", ""),
        ("(center(room)|subject)", "there is no center()", ""),
        ("(1|hole)", "hole is missing in 5 of 48 impacts, such as impact i0", ""),
        ("(1|sample)", "rename the column", "1"),
        ("(1|subject:side) + (1|side:subject)", "(1|side:subject) is asked for twice", "(1|subject:side)"),
    ],
)
def test_what_the_rows_cannot_tell_is_refused_with_the_formula_that_is_left(
    formula: str, reason: str, left: str
) -> None:
    rows = impacts().assign(nation="x", day=lambda t: t["session"] + 10)
    rows = rows.assign(hole=rows["side"].where(rows.index >= 5), sample=rows["side"])
    with pytest.raises(InputError) as caught:
        design_of(formula, "1", rows)
    (problem,) = caught.value.problems
    assert (problem.column, problem.value) == ("formula.K", formula)
    assert reason in problem.remedy
    if not left:
        # A formula without the term is not what was asked for.
        assert "Write" not in problem.remedy
        return
    assert f'Write "{left}" instead' in problem.remedy
    design_of(left, "1", rows)


@pytest.mark.parametrize(
    ("formula", "name"), [("(1|hand)", "hand"), ("(hand|subject)", "hand"), ("(1|log(age))", "log(age)")]
)
def test_a_column_that_is_not_there_leaves_no_formula_without_it(formula: str, name: str) -> None:
    """What was asked for is not taken out: its name may be a slip."""
    with pytest.raises(InputError) as caught:
        design_of(formula, "1", impacts())
    (problem,) = caught.value.problems
    assert f"there is no column {name}" in problem.remedy
    assert "instead" not in problem.remedy


def test_levels_that_a_colon_gives_one_name_are_refused() -> None:
    names = {"s0": "a", "s1": "a:left", "s2": "b", "s3": "c"}
    rows = impacts().assign(subject=lambda t: t["subject"].map(names))
    rows["side"] = np.where(rows["subject"] == "a", "left:" + rows["side"], rows["side"])
    (fault,) = resolve("(1|subject:side)", rows, REFERENCE).faults
    assert fault.reason == "two levels would be called a:left:left"
    assert not resolve("(1|subject)", rows, REFERENCE).faults


def test_a_slope_needs_more_impacts_than_coefficients() -> None:
    rows = impacts(repeats=1)
    rows = rows[(rows["side"] == "left") & (rows["trial"] != "t1")].reset_index(drop=True)
    (fault,) = resolve("log(mass_kg) + (log(mass_kg)|subject)", rows, REFERENCE).faults
    assert fault.expected == "more than 2 impacts for at least one subject"


def test_terms_that_make_one_pattern_together_are_told_from_each_other_or_refused() -> None:
    """With two impacts a pair, x = ±1: 1 + scatter = half of the intercept's and half of the slope's."""
    rows = impacts(repeats=1).assign(x=lambda t: np.where(t["side"] == "left", -1.0, 1.0))
    rows = rows.assign(pair=rows["subject"] + rows["trial"])
    assert resolve("(x|pair)", rows, REFERENCE).faults[0].term == "(x|pair)"
    # The two intercepts alone share no pattern.
    assert not resolve("(1|pair) + (1|subject:side)", rows, REFERENCE).faults


def test_the_columns_are_those_of_the_matrix_by_hand() -> None:
    rows = impacts()
    formulas = {
        "K": EVERYTHING,
        "C": "room + (0 + room|subject)",
        "thickness_m": "log(mass_kg) + (1|session)",
    }
    priors = specification(element="wall", formula=formulas).complete_priors()
    effects, columns = population_design(
        design_of(rows=rows, **formulas), priors, ("noise", "log_thickness_m")
    )
    log_mass = np.log(rows["mass_kg"].to_numpy() / REFERENCE)[:, None]
    room = rows["room"].to_numpy()
    room = ((room - room.mean()) / room.std())[:, None]
    ones, person = np.ones((len(rows), 1)), indicator(rows, "subject")
    session = indicator(rows, "session")
    by_hand = [
        {
            "intercept_K": ones,
            "mass_exponent_K": log_mass,
            "subject_effect_K": person,
            "subject_mass_exponent_deviation_K": log_mass * person,
            "subject_side_effect_K": indicator(rows, "subject", "side"),
            "session_effect_K": session,
            "operator_effect_K": indicator(rows, "operator"),
        },
        {
            "intercept_C": ones,
            "covariate_effect_C": room,
            "subject_effect_of_room_deviation_C": room * person,
        },
        {"noise_mean": ones},
        {
            "log_thickness_m_mean": ones,
            "mass_exponent_thickness_m": log_mass,
            "session_effect_thickness_m": session,
        },
    ]
    assert list(effects.parts) == [name for part in by_hand for name in part]
    b = np.random.default_rng(2).normal(size=effects.size)
    for logs, part in zip(np.asarray(expected(columns, b)), by_hand, strict=True):
        # Parts of b may be wider than their levels are.
        each = [matrix @ b[effects.parts[name]][: matrix.shape[1]] for name, matrix in part.items()]
        # Sums of a dozen numbers of order one.
        assert_allclose(logs, np.sum(each, axis=0), rtol=0, atol=50 * np.finfo(float).eps)
    assert set(effects.spread[effects.parts["subject_side_effect_K"]]) == {"sd_subject_side_K"}
    of_exponents = effects.spread[effects.parts["subject_mass_exponent_deviation_K"]]
    assert set(of_exponents) == {"sd_subject_mass_exponent_K"}


def test_levels_are_labelled_in_order_of_appearance() -> None:
    design = design_of(EVERYTHING)
    assert design.groupings["subject:side"].levels[:3] == ("s0:left", "s0:right", "s1:left")
    assert set(design.groupings["session"].levels) == {"1", "2", "3"}
    assert list(design.groupings) == ["subject", "trial", "subject:side", "session", "operator"]


def test_a_new_impact_has_a_new_level_of_every_grouping() -> None:
    """The variance of its log beside the intercept's is the sum of all intercepts' variances."""
    design = design_of(EVERYTHING, "1")
    count = 20_000
    terms = [term for term in design.responses["K"].terms if not term.slope]
    population = {term.sd("K"): np.full((1, count), 0.1 * (1 + n)) for n, term in enumerate(terms)}
    population |= {f"sd_impact_{q}": np.full((1, count), 0.05) for q in "KC"}
    typical = {f"{q}_typical_person": np.ones((1, count)) for q in "KC"}
    found = np.log(derived.new_impact(design, population, typical, np.random.default_rng(1))["K_new"])
    variance = 0.05**2 + sum((0.1 * (1 + n)) ** 2 for n in range(len(terms)))
    # Five standard errors of a normal's variance.
    assert_allclose(found.var(), variance, rtol=5 * np.sqrt(2 / count))


def specification(**changes) -> ModelSpecification:
    return ModelSpecification.model_validate(
        {"name": "m", "likelihood": "impact", "formula": {"K": EVERYTHING, "C": "(1|subject/side)"}} | changes
    )


COMPARED = {"likelihood": "published-estimates", "comparison": {"formulas": {"energy": "(1|energy_J)"}}}


def scale(width: float) -> dict[str, object]:
    return {"distribution": "half-normal", "scale": width}


def test_priors_of_group_terms_are_the_files_or_as_wide_as_peoples() -> None:
    own = {q: scale(0.2) for q in "KC"}
    slope = {q: scale(0.3) for q in "KC"}
    priors = specification(
        priors={"sd_group": {"subject:side": own}, "sd_slope": {"log(mass_kg)|subject": slope}}
    ).complete_priors()
    assert priors.by_name()["sd_subject_side_K"].scale == 0.2
    assert priors.by_name()["sd_subject_mass_exponent_C"].scale == 0.3
    assert priors.by_name()["sd_session_K"] == priors.sd_subject.K
    assert set(priors.sd_group) == {"subject:side", "session", "operator"}
    assert "sd_energy_J_C" in specification(**COMPARED).complete_priors().by_name()
    population = {
        "sd_subject_side_K": np.array([[0.1, 0.5]]),
        "sd_subject_mass_exponent_K": np.array([[0.2]]),
    }
    densities = priors.log_densities(population)
    assert set(densities) == set(population)
    half = np.log(2 / (0.2 * np.sqrt(2 * np.pi))) - (population["sd_subject_side_K"] / 0.2) ** 2 / 2
    assert_allclose(densities["sd_subject_side_K"], half, rtol=1e-12)


@pytest.mark.parametrize("key", ["subject", "room:side"])
def test_a_prior_of_no_term_is_refused(key: str) -> None:
    with pytest.raises(ValueError, match=r"priors\.sd_group"):
        specification(priors={"sd_group": {key: {q: scale(0.2) for q in "KC"}}})


def test_a_prior_of_a_term_that_is_the_subject_s_in_the_data_is_named() -> None:
    own = {"sd_group": {"patient": {q: scale(0.2) for q in "KC"}}}
    model = specification(priors=own, formula={"K": "(1|patient)", "C": "(1|patient)"})
    assert model.priors_passed_over([GroupTerm(("subject",))]) == ["(1|patient)"]
    assert model.priors_passed_over([GroupTerm(("Patient",))]) == []
