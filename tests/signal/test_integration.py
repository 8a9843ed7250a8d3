from __future__ import annotations

import numpy as np

from bayestissue.recordings.signal.integrals import cumulative
from bayestissue.recordings.signal.padded_traces import PaddedTraces


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


def test_short_rows_fall_back_on_the_trapezoidal_rule():
    recordings = rows([np.cos, np.cos], [4, 12], 0.1)
    quintic, plain = cumulative(recordings, "quintic"), cumulative(recordings, "trapezoidal")
    np.testing.assert_array_equal(quintic[0, :4], plain[0, :4])
    assert not np.array_equal(quintic[1], plain[1])
