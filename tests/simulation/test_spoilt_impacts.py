"""Sound recordings are left alone and spoilt ones are found: benchmarks/spoilt_impacts.py, in small."""

from __future__ import annotations

from functools import reduce
from operator import add

import numpy as np
import pandas as pd
import pytest
from scipy.stats import binom

from bayestissue.simulation.sound import impacts
from bayestissue.simulation.spoiling import DISPLACEMENT, KINDS
from bayestissue.simulation.spoilt import judged, sound_ones, spoilt_ones

EACH, SOUND = 12, 200
# By chance a share this far from the promised one comes up once in a thousand runs.
CHANCE = 1e-3
DECELERATIONS = [kind for kind in KINDS if kind not in DISPLACEMENT]


@pytest.fixture(scope="module")
def pool():
    # A closed form, which needs no compiled solver; the benchmark has all six elements.
    return impacts(200, seed=3, elements=("kelvin_voigt",))


@pytest.fixture(scope="module")
def spoilt(pool) -> pd.DataFrame:
    sets = [spoilt_ones(kind, pool, EACH, seed=1) for kind in DECELERATIONS]
    return judged(reduce(add, sets)).assign(kind=np.repeat(DECELERATIONS, EACH))


def test_there_are_at_least_fifteen_ways_to_spoil_a_recording():
    assert len(KINDS) >= 15


@pytest.mark.parametrize(("quantity", "count"), [("deceleration", SOUND), ("displacement", SOUND // 2)])
def test_fewer_than_one_sound_recording_in_twenty_is_flagged(pool, quantity, count):
    flagged = (judged(sound_ones(pool, count, quantity, seed=1))["flags"] != "").sum()
    assert flagged <= binom.ppf(1 - CHANCE, count, 0.05)


def test_nine_in_ten_spoilt_recordings_that_move_K_or_C_are_found(spoilt):
    off = spoilt["off"] > 0.05
    assert off.sum() > 150
    assert (off & (spoilt["flags"] != "")).sum() >= binom.ppf(CHANCE, off.sum(), 0.9)


@pytest.mark.parametrize(
    ("kind", "flag"),
    [
        ("clipped, noise behind it", ("no force of depth", "flatter at the top")),
        ("soft saturation", ("flatter at the top",)),
        ("begins 1 ms late", ("begins above zero",)),
        ("begins 2 ms late", ("begins above zero",)),
        ("begins 4 ms late", ("begins above zero",)),
        ("spike before contact", ("a spike",)),
        ("zero moves during the impact", ("the zero after contact",)),
        ("hum of 50 Hz", ("hum", "drift")),
        ("hum of 60 Hz", ("hum", "drift")),
        ("drift", ("drift",)),
        ("samples repeated", ("samples that repeat",)),
        ("coarse steps", ("steps of the recorder",)),
    ],
)
def test_a_spoilt_recording_is_called_by_its_name(spoilt, kind, flag):
    mine = spoilt.loc[(spoilt["kind"] == kind) & (spoilt["off"] > 0.05), "flags"]
    named = sum(any(words in text for words in flag) for text in mine)
    assert named >= binom.ppf(CHANCE, len(mine), 0.75)


def test_a_displacement_that_begins_deep_is_found_and_one_at_contact_is_not(pool):
    deep = judged(spoilt_ones(*DISPLACEMENT, pool, EACH))["flags"]
    assert deep.str.contains("contact came before the recording").sum() >= binom.ppf(CHANCE, EACH, 0.95)
    sound = judged(sound_ones(pool, EACH, "displacement"))["flags"]
    assert not sound.str.contains("contact came before").any()
