"""Channel frequency classes of SAE J211-1."""

from __future__ import annotations

import numpy as np

from bayestissue.errors import InputError, Problem
from bayestissue.signal.traces import Column, Rows

# The standard's figure: a two-pole filter with its corner here, run forth and back, has its -3 dB corner
# at 5/3 of the class, since (1 + 0.8022⁴)⁻¹ = 2^(-1/2) and 2.0775 × 0.8022 = 5/3.
_DESIGN_CORNER = 2.0775


def low_pass(values: Rows, dt: Column, frequency_class: int) -> Rows:
    """Four-pole phaseless Butterworth low-pass of a channel frequency class, row by row.

    The -3 dB corner lies at 5/3 of the class in Hz. Either end is continued by its reflection through the
    end point, so that a row that begins at a jump keeps it.

    Args:
        values: [impact, sample].
        dt: sampling interval of each row in s.
        frequency_class: 60, 180, 600 or 1000.

    Raises:
        InputError: an impact is sampled too slowly for this class.

    Source: SAE J211-1, appendix C; ISO 6487.
    """
    # A third of a second to import, which only those who filter should wait for.
    from scipy.signal import butter, sosfiltfilt

    rates = np.round(1 / dt, 3)
    too_slow = rates <= 2 * _DESIGN_CORNER * frequency_class
    if too_slow.any():
        raise InputError(
            Problem(
                "signal options",
                f"a sampling rate above {2 * _DESIGN_CORNER * frequency_class:.0f} Hz for class "
                f"{frequency_class}",
                'Choose a lower class, or filter = "none".',
                column="signal.filter",
                value=f"{rates[too_slow].min():g} Hz",
                code="filter-too-slow",
            )
        )
    filtered = np.empty_like(values)
    for rate in np.unique(rates):
        rows = rates == rate
        sections = butter(2, _DESIGN_CORNER * frequency_class, fs=rate, output="sos")
        reach = min(values.shape[1] - 1, int(rate / frequency_class))
        filtered[rows] = sosfiltfilt(sections, values[rows], axis=1, padlen=reach)
    return filtered
