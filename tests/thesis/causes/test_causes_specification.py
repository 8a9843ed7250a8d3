from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from causes_bench import specification

from bayestissue.errors import InputError
from bayestissue.resources import shared
from bayestissue.thesis.causes.specification import Range, chosen, read_causes


def test_the_causes_that_the_thesis_and_the_audit_propose_come_with_the_program() -> None:
    mechanisms = {cause.mechanism for cause in specification().causes.values()}
    assert mechanisms == {
        "none", "centring", "conversion", "fixed window", "own time", "velocity", "active", "stiffening",
        "wall", "maxwell", "standard linear", "moving mass",
    }  # fmt: skip
    drivers = {cause.driver for cause in specification().causes.values()}
    assert drivers == {None, "mass", "energy", "momentum"}


def test_ranges_are_uniform_or_uniform_in_the_logarithm() -> None:
    random = np.random.default_rng(0)
    plain = Range(low=2, high=8).draw(random, 10_000)
    ratio = Range(low=2, high=8, log=True).draw(random, 10_000)
    assert plain.mean() == pytest.approx(5, abs=4 * 6 / np.sqrt(12e4))
    assert np.log(ratio).mean() == pytest.approx(np.log(4), abs=4 * np.log(4) / np.sqrt(12e4))
    assert (plain.min(), ratio.min()) > (2, 2)


@pytest.mark.parametrize(
    ("before", "after", "told"),
    [
        ("low = 300, high = 30000", "low = 30000, high = 300", "low not above high"),
        ("low = 0.02, high = 1.0, log = true", "low = 0, high = 1.0, log = true", "low above 0"),
        ('driver = "mass"\n', "", "a driver for the mechanism"),
        ("error_m_s =", "error_km_h =", "error_m_s"),
        ('mechanism = "centring"', 'mechanism = "magic"', "magic"),
        ("each = 1000", "each = 3", "40"),
    ],
)
def test_says_what_is_wrong(tmp_path: Path, before: str, after: str, told: str) -> None:
    text = shared("models", "causes.toml").read_text(encoding="utf-8")
    assert before in text
    path = tmp_path / "causes.toml"
    path.write_text(text.replace(before, after, 1), encoding="utf-8")
    with pytest.raises(InputError, match=told):
        read_causes(path)


def test_only_known_causes_can_be_chosen() -> None:
    assert list(chosen(specification(), ("wall", "none"), "f").causes) == ["wall", "none"]
    with pytest.raises(InputError, match="anticipation"):
        chosen(specification(), ("magic",), "f")
