"""Datasets without a free mass: what they must have, what they leave out, and back from a folder."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from bayestissue.dataset import read_dataset
from bayestissue.errors import InputError
from bayestissue.signal import displacements
from bayestissue.signal.options import SignalOptions
from bayestissue.simulation.driven import Driven, driven, write_driven


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_driven(tmp_path / "driven", Driven(seed=3, subjects=2, repeats=1))
    return tmp_path / "driven"


def changed(folder: Path, pattern: str, text: str) -> Path:
    settings = folder / "dataset.toml"
    settings.write_text(re.sub(pattern, text, settings.read_text(), flags=re.DOTALL))
    return folder


def test_it_is_read_without_masses_and_written_back(folder: Path) -> None:
    data = read_dataset(folder)
    assert not data.free
    assert data.recorded == "driven"
    assert data.impacts["mass_kg"].isna().all()
    again = read_dataset(data.write(folder.parent / "again"))
    np.testing.assert_array_equal(again.traces[0].value, data.traces[0].value)
    np.testing.assert_array_equal(again.channels[0].traces[1].value, data.channels[0].traces[1].value)


def test_masses_that_stand_there_are_not_read(folder: Path) -> None:
    table = (folder / "impacts.csv").read_text().splitlines()
    mass = [f"{row},{'mass_kg' if number == 0 else 'heavy'}" for number, row in enumerate(table)]
    (folder / "impacts.csv").write_text("\n".join(mass) + "\n")
    assert read_dataset(folder).impacts["mass_kg"].isna().all()


@pytest.mark.parametrize(
    ("pattern", "text"),
    [
        (r"\[\[channel\]\].*", ""),
        (r'quantity = "displacement"\nunit = "m"', 'quantity = "deceleration"\nunit = "g"'),
        (r'place = "base"', 'place = "impactor"\ntip_mass_kg = 0.1'),
    ],
)
def test_both_motion_and_force_are_asked_for(folder: Path, pattern: str, text: str) -> None:
    with pytest.raises(InputError) as error:
        read_dataset(changed(folder, pattern, text))
    assert any("motion.free = false" in problem.expected for problem in error.value.problems)


def test_what_the_force_may_be_late_is_read_and_written_back(folder: Path) -> None:
    data = read_dataset(changed(folder, r'place = "base"', 'place = "base"\ntime_offset_sd_s = 0.001'))
    assert data.channels[0].time_offset_sd_s == 0.001
    again = read_dataset(data.write(folder.parent / "again"))
    assert again.channels[0].time_offset_sd_s == 0.001


def test_beside_a_free_mass_the_recordings_tell_what_is_late(folder: Path) -> None:
    changed(folder, r'place = "base"', 'place = "base"\ntime_offset_sd_s = 0.001')
    with pytest.raises(InputError, match=r"time_offset_sd_s only beside motion\.free = false"):
        read_dataset(changed(folder, r"free = false", "free = true"))


def test_noise_of_a_marker_hardly_ever_ends_a_window() -> None:
    """0.2 mm, where the motion is 1 to 5 mm deep: 33 of 120 windows ended before three fifths of the way."""
    early = 0
    for seed in range(2, 7):
        exact, noisy = (
            displacements(driven(Driven(seed=seed, C=500.0, noise_m=noise))[0], SignalOptions())
            for noise in (1e-7, 2e-4)
        )
        early += (noisy.time_to_peak < 0.6 * exact.time_to_peak).sum()
    assert early <= 12


def test_contact_is_when_the_force_begins() -> None:
    data, _ = driven(made := Driven(seed=4, noise_N=0.2))
    signal = displacements(data)
    # Recordings begin between two samples, so long before contact that their clocks count from there.
    within = 1.5 / made.rate
    late = signal.contact_time_s - made.before_s
    assert ((-within < late) & (late < within)).all()
    # The jump of the damper's force leaves one sampling interval.
    np.testing.assert_allclose(signal.contact_time_sd, 1 / made.rate / np.sqrt(12), rtol=1e-6)
