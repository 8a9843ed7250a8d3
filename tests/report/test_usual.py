"""Published values of impacts like these, on the page of a fit."""

from __future__ import annotations

import re
from collections.abc import Callable

import numpy as np
import pandas as pd
import pytest

from bayestissue.reports.pages.fit import usual
from bayestissue.reports.pages.fit.fit_page import page_of
from bayestissue.reports.pages.fit.fit_run import FitRun
from bayestissue.reports.pages.run_folder import read_about
from make_fit_run import CONDITIONS, PEOPLE, changed, make_fit_run, read_fit_run

pytestmark = pytest.mark.usefixtures("read_once")
FALLS = {"mass_kg": 5.0, "velocity_m_s": 0.93}
# Of heel pads: what each of these came to, and what Kinoshita et al. found.
OWN = {"peak_deceleration": 9.0, "peak_depth": 0.0113, "energy_share_with_gravity": 0.2}
PUBLISHED = {"peak_deceleration": 11.6, "peak_depth": 0.0113, "energy_share_with_gravity": 0.79}


def plain(html: str) -> str:
    return re.sub(r"\s+", " ", re.sub(r"<[^>]+>", " ", html)).replace("\N{NO-BREAK SPACE}", " ")


def section(html: str) -> str:
    return plain(html[html.index('<section id="usual"') :].partition("</section>")[0]).strip()


@pytest.fixture(scope="module")
def of(tmp_path_factory) -> Callable[..., FitRun]:
    """A fit of so many heavy drops, with what its impacts came to."""
    folder = make_fit_run(tmp_path_factory.mktemp("usual") / "run", mass_varies=False, exponent=None)
    run = read_fit_run(folder, read_about(folder))

    def made(site: str = "heel", *, motion: dict[str, float] = FALLS) -> FitRun:
        constants = run.groups["constant_data"].copy()
        for name, value in motion.items():
            constants[name] = constants[name].dims, np.full(constants[name].shape, value)
        rows = pd.concat(
            run.of_impacts("K").assign(label=run.impacts, variable=name, median=value)
            for name, value in OWN.items()
        )
        return changed(
            run,
            groups=run.groups | {"constant_data": constants},
            summary=pd.concat([run.summary, rows.reset_index(drop=True)], ignore_index=True),
            record=run.record | ({"site": site} if site else {}),
        )

    return made


def test_published_values_of_the_site_stand_beside_this_study_s(of) -> None:
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


def test_the_page_says_what_is_unusual_first_and_then_the_numbers(of) -> None:
    html = page_of(of())
    words = section(html)
    assert '<a href="#usual">Is this usual?</a>' in html
    assert html.index('id="usual"') > html.index('id="residuals"')
    assert words.startswith("Is this usual? Not all of it. Of 9 published values of impacts like these")
    assert "energy share with gravity (less than half)." in words
    assert "peak depth (mm) 11.3 11.3 11.3 1.0 5 kg at 0.93 m/s Kinoshita et al. 1993" in words
    assert "Heel pads of 16 adults, hit by a dropped mass: 5 kg at 0.93 m/s" in words
    assert "https://doi.org/10.1055/s-2007-1021184" in words
    assert f"{PEOPLE * CONDITIONS} of {PEOPLE * CONDITIONS} impacts here" in words
    assert "other site" not in words


def test_without_a_site_the_rows_are_called_other_sites(of) -> None:
    words = section(page_of(of("")))
    assert "The dataset does not say what was hit, so these are other sites" in words
    assert "Of 9 published values of impacts like these elsewhere some are beyond a factor of two" in words
    assert "other site published for by" in words
    assert "heel 5 kg at 0.93 m/s" in words


def test_a_stated_site_without_a_like_measurement_is_answered(of) -> None:
    words = section(page_of(of("hip")))
    assert "no published measurement of the hip" in words


def test_of_quantities_that_a_fit_lacks_the_measurements_are_named(of) -> None:
    run = of()
    lacking = changed(run, summary=run.summary[~run.summary["variable"].isin(OWN)])
    words = section(page_of(lacking))
    assert (
        "have peak deceleration, peak depth and energy share with gravity, of which this fit has nothing"
        in words
    )
    assert "Heel pads of 16 adults" in words
    assert not usual.is_answered(changed(lacking, record=lacking.record | {"site": ""}))


def test_a_page_of_other_motions_says_nothing_of_it(of) -> None:
    html = page_of(of("", motion={"mass_kg": 0.5, "velocity_m_s": 1.5}))
    assert 'id="usual"' not in html
    assert "Is this usual?" not in html


def test_secant_stiffness_compares_where_an_element_has_it(of) -> None:
    run = of("hip", motion={"mass_kg": 25.0, "velocity_m_s": 3.4})
    (line,) = usual.lines(run)
    assert (line.quantity, line.published) == ("K", (39e3, 55e3))
    k = run.of_impacts("K")["median"].to_numpy()
    assert line.median == pytest.approx(np.median(k))
    secant = run.of_impacts("K").assign(label=run.impacts, variable="K_secant", median=2 * k)
    doubled = pd.concat([run.summary, secant.reset_index(drop=True)], ignore_index=True)
    assert usual.lines(changed(run, summary=doubled))[0].median == pytest.approx(2 * np.median(k))


def test_numbers_that_are_no_estimates_are_held_against_nothing(of) -> None:
    run = of()
    diagnostics = run.diagnostics | {"model_form": {"undescribed": True, "impacts": {}}}
    assert not usual.is_answered(changed(run, diagnostics=diagnostics))
