"""A fit of nested, crossed and slope terms: names and dimensions of its results, and a truth given back."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import bayestissue as bt
from bayestissue.inference.fit import draws_of_chain, sample
from bayestissue.model.hierarchy import derived
from bayestissue.model.hierarchy.population import population_design
from bayestissue.model.hierarchy.priors import Priors
from bayestissue.model.hierarchy.specification import ModelSpecification, Sampler
from bayestissue.model.hierarchy.trace_data import prepare
from campaigns import COLUMNS, simulated, spreads
from designs import design_of, labelled_draws

FORMULA = "log(mass_kg) + (log(mass_kg)|subject) + (1|subject:side) + (1|session)"


def test_dimensions_and_meanings_follow_the_columns() -> None:
    design = design_of(FORMULA, "(1|subject) + (1|side)")
    effects, _ = population_design(design, Priors(), ())
    rng = np.random.default_rng(1)
    population = {
        name: rng.normal(size=(2, 3, part.stop - part.start))[
            ..., : len(design.groupings[term.grouping].levels)
        ]
        for term in design.terms
        for q in "KC"
        if (name := term.effect(q)) in effects.parts
        for part in [effects.parts[name]]
    }
    single = {*effects.spread, "sd_impact_K", "sd_impact_C", "intercept_K", "intercept_C", "mass_exponent_K"}
    population |= {name: rng.uniform(0.1, 1, (2, 3)) for name in single - {""}}
    found = labelled_draws(design, population)
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


FACTORS = [
    {"name": "side", "levels": ["left", "right"]},
    {"name": "session", "levels": 3, "every": False},
]


@pytest.mark.long
def test_a_fit_gives_back_what_a_campaign_was_made_with() -> None:
    made = simulated(
        {
            **spreads(subject=0.2, impact=0.05),
            "sd_group": {"subject:side": {"K": 0.2, "C": 0.2}, "session": {"K": 0.1, "C": 0.1}},
            "sd_slope": {"log(mass_kg)|subject": {"K": 0.4, "C": 0.4}},
        },
        {"sampling_rate_hz": 2000.0, "noise_relative_to_peak": 0.005},
        people=6,
        masses=(0.4, 0.8, 1.4),
        design={"factors": FACTORS},
        seed=3,
    )
    model = ModelSpecification.model_validate(
        {
            **{"name": "designs", "likelihood": "impact", "discrepancy": "none"},
            "formula": {"K": FORMULA, "C": FORMULA},
        }
    )
    prepared = prepare(made.dataset("designs"), model, source="the model file")
    found = draws_of_chain(prepared, sample(prepared, Sampler(chains=2), 1), 1)
    quantities = derived.formula_quantities(prepared.design, found.population)
    truth = made.truth.assign(subject=made.impacts["subject"])
    for q in "KC":
        own = quantities[f"subject_mass_exponent_{q}"].reshape(-1, 6)
        true = truth.groupby("subject")[f"subject_mass_exponent_{q}"].first()
        away = (own.mean(0) - true.to_numpy()) / own.std(0)
        # Six standard normals, were the posterior normal; 4 is passed once in 2600 fits.
        assert np.abs(away).max() < 4
        for name, sd in (("subject_side", 0.2), ("session", 0.1), ("subject_mass_exponent", 0.4)):
            low, high = np.quantile(quantities[f"sd_{name}_{q}"], [0.001, 0.999])
            assert low < sd < high, name
        values = np.log(found.impacts[q].reshape(-1, len(truth)))
        true = np.log(truth[COLUMNS[q]].to_numpy())
        assert np.abs((values.mean(0) - true) / values.std(0)).max() < 5


@pytest.mark.long
def test_a_fit_gives_back_how_a_further_parameter_differs_between_people(tmp_path: Path) -> None:
    """From the formula of a model file to the posterior, the run folder and its predictions."""
    depth = "stiffening_depth_m"
    made = simulated(
        {
            **{"K_N_per_m": 2000.0, "element": "stiffening", "parameters": {depth: 0.02}},
            **spreads(subject=0.2, impact=0.05),
            **{"sd_impact_parameters": 0.05, "sd_group": {"subject": {depth: 0.3}}},
        },
        {"sampling_rate_hz": 5000.0, "noise_relative_to_peak": 0.005},
        people=6,
        masses=(0.4, 0.8, 1.4),
        seed=3,
    )
    shared = "log(mass_kg) + (1|subject)"
    model = ModelSpecification.model_validate(
        {
            **{"name": "depths", "likelihood": "impact", "element": "stiffening", "discrepancy": "none"},
            "formula": {"K": shared, "C": shared, depth: "(1|subject)"},
            "sampler": {"chains": 2, "draws": 500},
        }
    )
    fit = bt.fit(made.dataset("depths"), model, seed=1)
    assert fit.diagnostics["pooled_parameters"] == []
    posterior = fit.posterior["posterior"].dataset
    own = posterior[f"subject_effect_{depth}"]
    assert own.dims == ("chain", "draw", "subject")
    true = made.truth.groupby(made.impacts["subject"])[own.name].first().loc[own["subject"].to_numpy()]
    away = (own.mean(("chain", "draw")) - true.to_numpy()) / own.std(("chain", "draw"))
    # Six normals that share the error of their mean: 4 is passed less than once in 2600 fits.
    assert np.abs(away).max() < 4
    for name, sd in (("sd_subject_", 0.3), ("sd_log_", 0.05)):
        low, high = posterior[f"{name}{depth}"].quantile([0.001, 0.999])
        assert low < sd < high, name
    logs = np.log(posterior[depth])
    z = (logs.mean(("chain", "draw")) - np.log(made.truth[depth].to_numpy())) / logs.std(("chain", "draw"))
    assert np.abs(z).max() < 5
    assert posterior[f"{depth}_subject"].attrs["unit"] == "m"
    assert f"sd_subject_{depth}" in set(fit.summary["variable"])
    assert f"sd_subject_{depth}" in fit.posterior["log_prior"]
    page = fit.report(tmp_path / "run").read_text(encoding="utf-8")
    assert depth in page
    # A person's greatest depth follows the person's stiffening depth.
    rows = made.impacts.groupby("subject").first().reset_index()
    at = rows[["subject", "mass_kg", "velocity_m_s"]]
    table = bt.read_run(tmp_path / "run").predict(at)
    assert not table["note"].str.contains("mixture").any()
    width = np.log(table["peak_displacement_m_high"] / table["peak_displacement_m_low"]) / 2 / 1.645
    reached = made.truth["peak_displacement_m"].loc[made.impacts.groupby("subject").head(1).index]
    off = np.log(table["peak_displacement_m"].to_numpy() / reached.to_numpy()) / width
    # A new impact of the same person and the recorded one: normals, each with the impact's scatter.
    assert np.abs(off).max() < 4 * np.sqrt(2)
