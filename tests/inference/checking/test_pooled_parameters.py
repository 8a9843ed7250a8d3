"""A further parameter that differs between levels that share it: found, and seldom where it does not."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
import xarray as xr

from bayestissue.base.remedies import codes_in
from bayestissue.inference.answers import predictions
from bayestissue.inference.answers.law import Law
from bayestissue.inference.answers.study import Study
from bayestissue.inference.checking.findings import headline, warned_codes, warnings
from bayestissue.inference.checking.formula_checks import pooled_parameters
from bayestissue.mechanics.elements import element
from bayestissue.model.hierarchy.design import Design
from designs import design_of

NAME, STIFFENING = "stiffening_depth_m", element("stiffening")
MEAN, SD, SHAPE = np.log(0.02), 0.3, (1, 200)
# Each pad's traces tell its log as well as this.
ERRORS = np.array([0.02, 0.1, 0.3, 1.0])


def rows(repeats: int = 6) -> pd.DataFrame:
    """Four pads and three days, each pad on each as often as on the others."""
    pads, days = np.repeat(list("abcd"), repeats), np.resize([1, 2, 3], 4 * repeats)
    table = pd.DataFrame({"pad": pads, "day": days, "subject": "tower", "trial": "drop", "mass_kg": 2.0})
    return table.assign(velocity_m_s=np.resize([1.0, 1.5], len(table)), impact=np.arange(len(table)))


def drawn(design: Design, seed: int, effect: float = 0.0, own: tuple[float, ...] = ()) -> xr.Dataset:
    """The posterior of normal traces of log depths about MEAN and of pad a ``effect`` beside it.

    ``own`` are the effects of pads b, c and d on the formula of the depth, if it has one.
    """
    rng, table = np.random.default_rng(seed), design.recorded.rows
    pad = table["pad"].map(dict(zip("abcd", range(4), strict=True))).to_numpy()
    expected = MEAN + np.array([0.0, *(own or (0.0, 0.0, 0.0))])[pad]
    s, truth = ERRORS[pad], expected + SD * rng.standard_normal(len(pad)) + effect * (pad == 0)
    told = truth + s * rng.standard_normal(len(pad))
    precision = SD**-2 + s**-2
    log = (expected / SD**2 + told / s**2) / precision
    log = log + rng.standard_normal((*SHAPE, len(pad))) / np.sqrt(precision)
    one, dims = np.ones(SHAPE), ("chain", "draw")
    values = {f"log_{NAME}_mean": MEAN * one, f"sd_log_{NAME}": SD * one}
    for name in "bcd"[: len(own)]:
        values[f"effect_of_pad[{name}]_{NAME}"] = own["bcd".index(name)] * one
    values |= {f"intercept_{q}": np.log(x) * one for q, x in {"K": 2e4, "C": 40.0}.items()}
    values |= {f"sd_impact_{q}": 0.01 * one for q in "KC"}
    for q in "KC":
        values |= {f"effect_of_{name}_{q}": 0.0 * one for name in design.responses[q].names}
    return xr.Dataset({k: (dims, v) for k, v in values.items()} | {NAME: ((*dims, "impact"), np.exp(log))})


def test_a_pad_that_stiffens_more_than_others_is_named_with_the_line_to_write() -> None:
    design = design_of("pad + C(day)", "pad", rows=rows())
    posterior = drawn(design, 1, effect=-2.0)
    (found,) = pooled_parameters(posterior, design.recorded, STIFFENING)
    assert (found.parameter, found.factor, found.term) == (NAME, "pad", "pad")
    assert min(found.medians, key=found.medians.__getitem__) == "a"
    assert f'{NAME} = "pad" in [formula]' in found.words
    diagnostics = {"checks": [], "pooled_parameters": [found.record()]}
    assert warnings(diagnostics) == [found.words]
    assert warned_codes(diagnostics) == codes_in(found.words) == codes_in(found.note) == ["pooled-parameter"]
    assert "differs between levels" in headline({"passed": True, **diagnostics})
    finished = Study(posterior, design.recorded, Law("stiffening", described=False))
    table = predictions.predict(finished, [{"pad": "a"}, {"pad": "b"}])
    assert all(found.note in note for note in table["note"])


def test_a_parameter_whose_formula_has_the_factor_is_predicted_at_its_levels(monkeypatch) -> None:
    """Pad a at 20 mm and b at 200 mm, as the formula has them; nothing is left to warn of."""
    design, effects = design_of("pad", "pad", rows=rows(), **{NAME: "pad"}), (np.log(10), 0.0, 0.0)
    posterior = drawn(design, 2, own=effects)
    assert pooled_parameters(posterior, design.recorded, STIFFENING) == []
    simulated: dict[str, np.ndarray] = {}

    def without_motion(_: Law, parameters: dict[str, np.ndarray], *others: object) -> dict[str, np.ndarray]:
        simulated.update(parameters)
        return {"peak_depth": np.zeros_like(parameters["K"])}

    monkeypatch.setattr(Law, "outcomes", without_motion)
    finished = Study(posterior, design.recorded, Law("stiffening"))
    table = predictions.predict(finished, [{"pad": pad, "velocity_m_s": 2.0} for pad in "ab"])
    assert not any("mixture" in note for note in table["note"])
    logs = np.log(simulated[NAME])
    # 200 draws of each: four standard errors of a mean and of a standard deviation.
    assert logs.mean((0, 1)) == pytest.approx(np.log([0.02, 0.2]), abs=4 * SD / np.sqrt(200))
    assert logs.std((0, 1)) == pytest.approx([SD, SD], rel=4 / np.sqrt(400))


def test_a_group_of_the_formula_is_asked_for_as_a_group() -> None:
    design = design_of("(1|pad) + (1|day)", "1", rows=rows())
    (found,) = pooled_parameters(drawn(design, 3, effect=-2.0), design.recorded, STIFFENING)
    assert found.term == "(1|pad)"


def test_chance_is_noted_once_in_a_hundred_at_most() -> None:
    """Of 100 fits without a difference 1, and 5 standard errors."""
    design, count = design_of("pad", "pad", rows=rows()), 100
    found = [pooled_parameters(drawn(design, 10 + n), design.recorded, STIFFENING) for n in range(count)]
    assert sum(map(bool, found)) <= 0.01 * count + 5 * np.sqrt(0.01 * count)
