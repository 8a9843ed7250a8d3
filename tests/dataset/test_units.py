from __future__ import annotations

import pint
import pytest

from bayestissue.recordings.dataset.units import DECLARED, Dimension, to_si

SI = {"acceleration": "m/s^2", "length": "m", "time": "s"}


@pytest.mark.parametrize("dimension", ["acceleration", "length", "time"])
def test_common_units_are_what_their_definitions_say(dimension: Dimension) -> None:
    registry = pint.UnitRegistry()
    for unit, factor in DECLARED[dimension]["common"].items():
        # Alone, g is the gram; of an acceleration it is standard gravity.
        defined = registry.Quantity(1.0, "g_0" if unit == "g" else unit)
        assert factor == pytest.approx(defined.m_as(SI[dimension]), rel=1e-15)
        assert to_si(f" {unit} ", dimension) == factor


def test_other_units_are_read_as_they_are_defined_and_others_refused() -> None:
    assert to_si("inch", "length") == pytest.approx(0.0254)
    assert to_si("cm/s^2", "acceleration") == pytest.approx(0.01)
    for unit, dimension in (("mm", "time"), ("furlongs per", "length"), ("", "time")):
        with pytest.raises(ValueError, match=r"unit|measure"):
            to_si(unit, dimension)  # type: ignore[arg-type]
