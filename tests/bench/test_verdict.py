"""Good, again or look: by the flags of estimates and of checks."""

from __future__ import annotations

import pytest

from bayestissue.bench.verdict import _SPOILT, verdict
from bayestissue.remedies import entries
from bayestissue.signal.quality.inspection import KINDS


def test_a_sound_drop_is_good() -> None:
    assert verdict([]) == ("good", "", "", False)


@pytest.mark.parametrize(
    ("name", "kind"), [("no-law", "again"), ("starts-above-zero", "again"), ("gravity-undeclared", "look")]
)
def test_a_spoilt_recording_is_repeated_and_a_wrong_setting_looked_at(name: str, kind: str) -> None:
    flag = KINDS[name].flag
    said = verdict([str(flag)])
    assert said == (kind, flag, flag.code, kind == "again")
    assert said.advice == entries()[flag.code].advice


def test_a_spoilt_recording_comes_before_what_is_wrong_with_the_bench() -> None:
    flags = [str(KINDS[name].flag) for name in ("hum", "spike")]
    assert verdict(flags).code == "spike"


def test_another_velocity_and_what_is_unlike_the_others_is_repeated_but_stays() -> None:
    said = verdict([], velocity=(1.2, 1.5, 0.05))
    assert (said.kind, said.spoilt) == ("again", False)
    assert "1.2 m/s" in said.reason
    assert verdict([], velocity=(1.5, 1.45, 0.05)).kind == "good"
    assert verdict([], unlike="K is 40 % higher").words == "again: K is 40 % higher"
    assert not verdict([], unlike="K is 40 % higher").spoilt


def test_every_code_has_an_entry() -> None:
    assert set(entries()) >= _SPOILT
