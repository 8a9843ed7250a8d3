"""Numbers of others that need no data file, each by the program; mixed models are in tests/hierarchy."""

from __future__ import annotations

import pytest

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
