"""Formulas of an element's further parameters: what a model file may say, columns, priors and names."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from bayestissue.base.errors import InputError
from bayestissue.inference.results.labels import design_variables
from bayestissue.model.hierarchy import derived
from bayestissue.model.hierarchy.population import population_design
from bayestissue.model.hierarchy.specification import ModelSpecification, read_specification
from designs import design_of, impacts

FORMULA = "log(mass_kg) + room + (1|subject) + (0 + room|subject) + (1|session)"
HEAD = 'name = "x"\nlikelihood = "impact"\nelement = "wall"\n'
HALF = '{ distribution = "half-normal", scale = 0.3 }'


def read(folder: Path, text: str) -> ModelSpecification:
    path = folder / "model.toml"
    path.write_text(text, encoding="utf-8")
    return read_specification(path)


def test_priors_of_a_further_parameters_effects_are_the_files_or_wide(tmp_path: Path) -> None:
    pair = f"K = {HALF}\nC = {HALF}\nthickness_m = {HALF}\n"
    text = f'[formula]\nthickness_m = "{FORMULA}"\n[priors.sd_subject]\n{pair}'
    found = read(tmp_path, f'{HEAD}{text}[priors.sd_slope."room|subject"]\n{pair}')
    assert found.formula.further == ("thickness_m",)
    priors = found.complete_priors().by_name()
    assert priors["sd_subject_thickness_m"].scale == 0.3
    assert priors["sd_subject_effect_of_room_thickness_m"].scale == 0.3
    assert priors["sd_session_thickness_m"].scale == priors["sd_trial_thickness_m"].scale == 0.5
    assert priors["mass_exponent_thickness_m"].mean == 0.0
    assert priors["sd_log_thickness_m"].scale == 0.2
    assert type(found).model_validate(found.model_dump()) == found
    assert "thickness_m" not in str(read(tmp_path, HEAD).priors.sd_subject)


@pytest.mark.parametrize(
    ("text", "said", "column"),
    [
        ('[formula]\nstiffness = "1"\n', "formulas of K, C, thickness_m, all that this", "formula"),
        (f"[priors.sd_trial]\nK = {HALF}\nC = {HALF}\nthickness_m = {HALF}\n", "priors of K, C, all", None),
        (
            '[formula]\nthickness_m = "(1|subject)"\n[priors.sd_subject]\n'
            f'K = {HALF}\nC = {HALF}\nthickness_m = {{ distribution = "half-normal", scale = -1.0 }}\n',
            "greater than 0",
            "priors.sd_subject.thickness_m.scale",
        ),
        ("[formula]\nthickness_m = 3\n", "string", "formula.thickness_m"),
    ],
)
def test_what_a_model_file_says_of_other_parameters_is_refused(
    tmp_path: Path, text: str, said: str, column: str | None
) -> None:
    with pytest.raises(InputError, match=said) as refused:
        read(tmp_path, HEAD + text)
    if column:
        assert [problem.column for problem in refused.value.problems] == [column]


def test_results_are_named_as_those_of_k_and_c() -> None:
    design = design_of("log(mass_kg) + (log(mass_kg)|subject)", "1", thickness_m=FORMULA)
    content = {"name": "m", "likelihood": "impact", "element": "wall", "formula": {"thickness_m": FORMULA}}
    priors = ModelSpecification.model_validate(content).complete_priors()
    effects, _ = population_design(design, priors, ("noise", "log_thickness_m"))
    rng, population = np.random.default_rng(3), {}
    for each in effects.blocks:
        several = each.spread or each.name.startswith("covariate")
        population[each.name] = rng.normal(size=(2, 5, each.width) if several else (2, 5))
    for name in {*effects.spread, "sd_impact_K", "sd_impact_C", "sd_log_thickness_m"} - {""}:
        population[name] = rng.uniform(0.1, 1, size=(2, 5))
    found = derived.formula_quantities(design, population)
    found |= derived.level_quantities(design, found)
    scale = impacts()["room"].std(ddof=0)
    slope = population["covariate_effect_thickness_m"] / scale
    assert_allclose(found["effect_of_room_thickness_m"], slope[..., 0])
    own = (population["subject_effect_of_room_deviation_thickness_m"] / scale) + slope
    assert_allclose(found["subject_effect_of_room_thickness_m"], own)
    of_room = population["sd_subject_effect_of_room_thickness_m"] / scale
    assert_allclose(found["sd_subject_effect_of_room_thickness_m"], of_room)
    exponent = population["mass_exponent_K"][..., None] + population["subject_mass_exponent_deviation_K"]
    assert_allclose(found["subject_mass_exponent_K"], exponent)
    assert "subject_mass_exponent_deviation_K" not in found
    of_people = population["log_thickness_m_mean"][..., None] + population["subject_effect_thickness_m"]
    assert_allclose(np.log(found["thickness_m_subject"]), of_people)
    names = {"sd_subject_thickness_m", "sd_session_thickness_m", "sd_log_thickness_m"}
    assert names | {"session_effect_thickness_m", "mass_exponent_thickness_m"} <= set(found)
    attributes = {name: one.attrs for name, one in design_variables(design).items()}
    assert attributes["thickness_m_subject"]["unit"] == "m"
    assert attributes["subject_effect_thickness_m"]["long_name"] == "effect of the subject on log thickness_m"
    assert "intercept_K" not in attributes
