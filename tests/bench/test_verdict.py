"""Good, again or look: by the flags of estimates and of checks."""

from __future__ import annotations

import numpy as np
import pytest

from bayestissue.base.errors import Coded
from bayestissue.base.remedies import entries
from bayestissue.studies.bench.drops import Drop
from bayestissue.studies.bench.following import Stamp
from bayestissue.studies.bench.growing_study import GrowingStudy
from bayestissue.studies.bench.verdict import verdict


def test_a_sound_drop_is_good() -> None:
    assert verdict([]) == ("good", "", "")
    assert not verdict([]).spoilt


@pytest.mark.parametrize(
    ("name", "kind"), [("no-law", "again"), ("starts-above-zero", "again"), ("gravity.undeclared", "look")]
)
def test_a_spoilt_recording_is_repeated_and_a_wrong_setting_looked_at(name: str, kind: str) -> None:
    flag = Coded.stated(name)
    said = verdict([str(flag)])
    assert (*said, said.spoilt) == (kind, flag, flag.code, kind == "again")
    assert said.advice == entries()[flag.code].advice


def test_a_spoilt_recording_comes_before_what_is_wrong_with_the_bench() -> None:
    flags = [str(Coded.stated(name)) for name in ("hum", "spike")]
    assert verdict(flags).code == "spike"


def test_another_velocity_and_what_is_unlike_the_others_is_repeated_but_stays() -> None:
    said = verdict([], velocity=(1.2, 1.5, 0.05))
    assert (said.kind, said.spoilt) == ("again", False)
    assert "1.2 m/s" in said.reason
    assert verdict([], velocity=(1.5, 1.45, 0.05)).kind == "good"
    assert verdict([], unlike="K is 40 % higher").words == "again: K is 40 % higher"
    assert not verdict([], unlike="K is 40 % higher").spoilt


def fallen(number: int, mass_kg: float, K: float, C: float = 30.0, subject: str = "s01") -> Drop:
    """A drop whose K is known to 1 % and whose C to 3 %."""
    cells = {"impact": str(number), "subject": subject, "mass_kg": mass_kg, "velocity_m_s": 1.5}
    site = {"centre": [np.log(K), np.log(C)], "precision": [[1e4, 0.0], [0.0, 1e3]]}
    return Drop(f"{number}.csv", Stamp(0, 0), str(number), cells, "good", **site)


def unlike(drops: list[Drop]) -> list[str]:
    """What is said of each, given all before it."""
    return [
        GrowingStudy.unlike(drop.cells, {"centre": drop.centre, "precision": drop.precision}, drops[:n])
        for n, drop in enumerate(drops)
    ]


@pytest.mark.parametrize("masses", [(0.5, 1.0, 0.5, 1.0), (0.5, 1.0, 1.0, 0.5), (0.5, 0.5, 0.5, 0.5)])
def test_swapped_masses_do_not_hide_each_other_by_their_scatter(masses: tuple[float, ...]) -> None:
    K = (1893.0, 7704.0, 3545.0, 3863.0)
    first, second, *_ = unlike([fallen(n, *each) for n, each in enumerate(zip(masses, K, strict=True))])
    assert not first
    assert second.startswith("K is ")
    assert second.endswith("% higher than this person's other drops let expect")
    # Nor do those of a person whose other drops are as far apart.
    said = unlike([fallen(n, masses[n % 4], K[n % 4]) for n in range(8)])
    assert any(said[4:])


def test_one_sound_drop_in_a_hundred_is_unlike_its_persons_others() -> None:
    random = np.random.default_rng(0)
    said: list[str] = []
    for _ in range(10):
        drops, slope = [], random.uniform(0, 1)
        for n in range(60):
            mass = (0.5, 0.8, 1.2)[n % 3]
            middle = np.array([8.0, 3.0]) + [0.3, -0.2] * np.array(n // 12) + slope * np.log(mass)
            K, C = np.exp(middle + random.normal(0, [0.1, 0.15]))
            drops.append(fallen(n, mass, float(K), float(C), f"s{n // 12}"))
        said += unlike(drops)
    assert np.mean([bool(each) for each in said]) < 0.02
