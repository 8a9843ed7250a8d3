"""What a fit says of recordings that the checks of single impacts name."""

from __future__ import annotations

from bayestissue.inference.checking.findings import headline, verdict_in_words
from bayestissue.inference.checking.recording_warnings import (
    clipped_recordings,
    contradicted_velocity,
    flagged_recordings,
    unused_channels,
)
from bayestissue.inference.points.notes import ANOTHER_VELOCITY
from bayestissue.recordings.dataset.dataset_file import ChannelSettings

SOUND = {
    "passed": True,
    "checks": [],
    "worst": {"r_hat": {"value": 1.0}, "ess_bulk": {"value": 900.0}, "ess_tail": {"value": 800.0}},
}


def test_sound_recordings_are_not_spoken_of() -> None:
    assert flagged_recordings(["a", "b"], [[], []]) == {}


def test_flagged_recordings_are_named_in_the_verdict() -> None:
    flags = [["a spike"], [], ["a spike", "hum"], *[["hum"]] * 6]
    found = flagged_recordings(list("abcdefghi"), flags)
    assert found["flagged"]["c"] == ["a spike", "hum"]
    words = verdict_in_words(SOUND | {"recordings": found})
    assert "of 9 recordings 8 are flagged: hum (7), a spike (2); a, c, d, e, f and 3 more" in words
    # One in a hundred sound recordings is flagged too: the headline is of the fit.
    assert headline(SOUND | {"recordings": found}) == "Diagnostics passed."


def test_another_velocity_is_a_warning_and_in_the_headline() -> None:
    found = SOUND | {"velocity": contradicted_velocity([[ANOTHER_VELOCITY], [ANOTHER_VELOCITY], []], {})}
    assert "WARNING: The recordings imply another velocity" in verdict_in_words(found)
    assert "2 of 3" in verdict_in_words(found)
    assert "another velocity at contact" in headline(found)


def test_clipped_recordings_are_named_beside_the_flagged() -> None:
    assert clipped_recordings(["a", "b"], [False, False]) == {}
    found = {
        "recordings": flagged_recordings(["a", "b"], [["hum"], []]),
        "clipped": clipped_recordings(["a", "b"], [False, True]),
    }
    words = verdict_in_words(SOUND | found)
    assert found["recordings"]["words"] in words
    assert "Of 2 recordings 1 is clipped: b." in words
    assert headline(SOUND | found) == "Diagnostics passed."


def test_a_channel_that_is_not_used_is_named_with_why() -> None:
    plate = ChannelSettings(name="plate", quantity="force", place="base", unit="N", file="force.csv")
    words = unused_channels([plate], "why")["words"]
    assert words.startswith("The further channel plate (force) is not used here: why.")
    assert words.endswith("`bayestissue check` compares the two.")
