from __future__ import annotations

import numpy as np
import pytest

from bayestissue.recordings.signal.integrals import cumulative
from bayestissue.recordings.signal.padded_traces import PaddedTraces, noise_sd


def rows(functions, lengths, dt):
    width = max(lengths)
    value = np.zeros((len(lengths), width))
    for row, (function, n) in enumerate(zip(functions, lengths, strict=True)):
        value[row, :n] = function(np.arange(n) * dt)
    n, zero = np.array(lengths), np.zeros(len(lengths))
    return PaddedTraces(value, n, zero, np.full(len(lengths), dt), np.zeros_like(value))


def test_quintics_are_integrated_exactly_to_the_end_of_every_row():
    polynomials = [
        np.polynomial.Polynomial(c) for c in ([1, -2, 3, 0.5, -0.2, 0.1], [0, 0, 0, 0, 0, 1], [2] * 6)
    ]
    recordings = rows(polynomials, [6, 7, 17], 0.3)
    result = cumulative(recordings, "quintic")
    for row, (polynomial, n) in enumerate(zip(polynomials, [6, 7, 17], strict=True)):
        # Sums of a few numbers: rounding error alone.
        np.testing.assert_allclose(
            result[row, :n], polynomial.integ()(np.arange(n) * 0.3), rtol=1e-11, atol=1e-13
        )


@pytest.mark.parametrize(("rule", "order"), [("trapezoidal", 2), ("quintic", 6)])
def test_the_error_falls_with_the_order_of_the_rule(rule, order):
    errors = [
        np.abs(cumulative(rows([np.cos], [n], 6 / (n - 1)), rule)[0] - np.sin(np.linspace(0, 6, n))).max()
        for n in (31, 61)
    ]
    # Halving the interval divides the error by 2 to the order, nearly.
    assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.5)


def test_the_ends_of_a_row_are_no_worse_than_its_middle():
    # e^{mu t} with mu dt = -0.32, the fastest of the promised impacts: nine samples of it
    pole, n = -0.32, 9
    result = cumulative(rows([lambda t: np.exp(pole * t)], [n], 1.0), "quintic")[0]
    exact = np.expm1(pole * np.arange(n)) / pole
    # the central error of each interval, all of one sign, over the whole integral
    assert np.abs(result - exact).max() < 191 / 60480 * pole**6 * exact[-1]


def test_short_rows_fall_back_on_the_trapezoidal_rule():
    recordings = rows([np.cos, np.cos], [4, 12], 0.1)
    quintic, plain = cumulative(recordings, "quintic"), cumulative(recordings, "trapezoidal")
    np.testing.assert_array_equal(quintic[0, :4], plain[0, :4])
    assert not np.array_equal(quintic[1], plain[1])


def test_noise_is_told_from_the_signal_and_from_a_jump():
    time = np.arange(2000) * 1e-4
    random = np.random.default_rng(1)
    value = np.where(time > 0.02, 60 * np.exp(-20 * time) * np.cos(70 * time), 0)
    recordings = PaddedTraces(
        (value + 0.4 * random.standard_normal(2000))[None],
        np.array([2000]),
        np.zeros(1),
        np.full(1, 1e-4),
        np.zeros((1, 2000)),
    )
    # The median of 2000 dependent absolute values is good to some 3 %; three times that.
    assert noise_sd(recordings)[0] == pytest.approx(0.4, rel=0.1)
