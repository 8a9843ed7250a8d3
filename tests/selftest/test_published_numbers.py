"""Numbers of others that need no data file, each by the program; mixed models are in tests/hierarchy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.stats import norm

from bayestissue.studies.selftest.decaying import LANCZOS3, TIME, element_of_rates
from bayestissue.studies.selftest.published_numbers import PUBLISHED

ELSEWHERE = {"Dyestuff", "Pastes", "Penicillin", "sleepstudy"}


@pytest.mark.parametrize("name", [name for name in PUBLISHED if name not in ELSEWHERE])
def test_published_numbers_are_the_program_s(name: str) -> None:
    published = PUBLISHED[name]
    computed = published.computed()
    assert published.numbers.keys() <= computed.keys()
    assert published.differences(computed) == {}


def test_a_number_that_is_off_is_named_with_its_difference() -> None:
    published = PUBLISHED["four inputs"]
    assert published.differences({"combined": 2.06}) == {"combined": pytest.approx(0.06)}
    assert list(published.differences({"combined": float("nan")})) == ["combined"]


def test_three_rates_are_those_of_an_overdamped_element() -> None:
    rates = (0.7, 4.2, 6.3)
    K, C, ratio = element_of_rates(rates)
    # Of (x, v, s) on 1 kg.
    motion = [[0, 1, 0], [-(1 + ratio) * K, 0, ratio * K], [ratio * K / C, 0, -ratio * K / C]]
    np.testing.assert_allclose(sorted(-np.linalg.eigvals(motion).real), rates, rtol=1e-9)


def test_the_certified_exponentials_leave_the_certified_squares() -> None:
    values = PUBLISHED["Lanczos3"].numbers
    made = sum(values[f"b{k}"] * np.exp(-values[f"b{k + 1}"] * TIME) for k in (1, 3, 5))
    # Eleven digits of parameters that nearly cancel.
    assert ((LANCZOS3 - made) ** 2).sum() == pytest.approx(values["squares"], rel=1e-6)


def test_the_budget_s_normal_interval_is_the_wider_one() -> None:
    """JCGM 101, tables 2 to 5: inputs are rectangular, the law of propagation has a normal output.

    Of equal inputs it has 3.92 for 3.88, of one that is ten times as large 19.9 for 17.0. The budget has
    standard deviations alone; intervals are those of draws.
    """

    def beyond(half: float, widths: tuple[float, ...]) -> float:
        # The distribution function of a sum of rectangular inputs, by its characteristic function.
        t = np.linspace(1e-9, 60, 60_001)
        of_sum = np.prod([np.sinc(t * width / np.pi) for width in widths], axis=0)
        inside = 2 / np.pi * np.trapezoid(of_sum * np.sin(t * half) / t, t)
        return inside - 0.95

    for u, exact, normal in (((1, 1, 1, 1), 3.88, 3.92), ((1, 1, 1, 10), 17.0, 19.9)):
        widths = tuple(np.sqrt(3) * each for each in u)
        name = "four inputs" if max(u) == 1 else "one large input"
        combined = PUBLISHED[name].computed()["combined"]
        digits = 0.005 if max(u) == 1 else 0.05
        assert norm.ppf(0.975) * combined == pytest.approx(normal, abs=digits)
        assert brentq(beyond, 2, 25, args=(widths,), xtol=1e-5) == pytest.approx(exact, abs=digits)
