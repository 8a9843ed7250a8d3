"""Published values of impacts like these, on the page of a fit."""

from __future__ import annotations

import numpy as np
import pytest
from changed_fits import FALL, OWN, heavy_drops

from bayestissue import Fit
from bayestissue.reports.pages.fit import usual
from make_fit_run import changed, fit_run, with_draws

RUN = {"exponent": None, "mass_varies": False}
# What Kinoshita et al. found of heel pads.
PUBLISHED = {"peak_deceleration": 11.6, "peak_depth": 0.0113, "energy_share_with_gravity": 0.79}


def of(site: str = "heel", **motion: float) -> Fit:
    """A fit of heavy drops, with what they came to."""
    return changed(heavy_drops(fit_run(**RUN), motion or FALL), record={"site": site} if site else {})


def test_published_values_of_the_site_stand_beside_this_study_s() -> None:
    run = of()
    (first,) = (
        one
        for one in usual.comparable_measurements(run)
        if one.measurement.source.short == "Kinoshita et al. 1993"
    )
    assert first.impacts.all()
    beside = {line.quantity: line for line in usual.lines(run) if line.measurement is first.measurement}
    assert {name: line.median for name, line in beside.items()} == pytest.approx(OWN)
    for name, line in beside.items():
        assert line.ratio == pytest.approx(OWN[name] / PUBLISHED[name])
    assert [line.unusual for line in beside.values()] == ["", "", "less than half"]


def test_secant_stiffness_compares_where_an_element_has_it() -> None:
    run = of("hip", mass_kg=25.0, velocity_m_s=3.4)
    (line,) = usual.lines(run)
    assert (line.quantity, line.published) == ("K", (39e3, 55e3))
    k = run.of_impacts("K")["median"].to_numpy()
    assert line.median == pytest.approx(np.median(k))
    doubled = with_draws(run, {"K_secant": 2 * run.posterior["posterior"]["K"]})
    assert usual.lines(doubled)[0].median == pytest.approx(2 * np.median(k), rel=1e-3)


def test_numbers_that_are_no_estimates_are_held_against_nothing() -> None:
    run = of()
    form = {"undescribed": True, "impacts": {}}
    assert not usual.is_answered(changed(run, diagnostics={"model_form": form}))
