"""Every fast path off: the same answers."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.stats import norm

from bayestissue import runtime
from bayestissue.errors import InputError
from bayestissue.fitting import earlier_run, resolve
from make_fit_run import write_fit_run
from plain_answers import FITS, QUICK, SLOW, Numbers, both_ways, differences

# Of a column's largest number: sums of some hundred terms in another order, of samples that nearly cancel.
ROUNDING = 1e-9
FARTHER = {
    # These begin with a search, which ends at steps of 1e-9.
    **dict.fromkeys(("estimates", "estimate of one impact", "short chain"), 1e-6),
    # Where a likelihood is greatest is known to the root of its rounding.
    "point estimates, exact": 1e-6,
    # Displacements far from the model's are a thousand times what errors of level and ramp leave of them.
    "log density of a2": 1e-6,
}
# Chains that part by a rounding have other random numbers. Of some hundred means the farthest apart, in Monte
# Carlo errors: chance once in ten thousand tests.
DRAWN = float(norm.isf(1e-4 / 2 / 300))


@pytest.fixture(scope="module")
def quick(tmp_path_factory: pytest.TempPathFactory) -> tuple[Numbers, Numbers]:
    """The ten answers."""
    return both_ways(tmp_path_factory.mktemp("plain"), QUICK)


def test_the_paths_are_off_in_one_of_two_processes(quick: tuple[Numbers, Numbers]) -> None:
    fast, plain = (numbers["paths"] for numbers in quick)
    assert plain.all()
    # A machine may have one core.
    assert not np.delete(fast, 2).any()


def test_ten_answers_are_the_same_to_rounding(quick: tuple[Numbers, Numbers]) -> None:
    apart = differences(*quick)
    assert list(apart) == list(QUICK)
    assert {name: size for name, size in apart.items() if not size <= FARTHER.get(name, ROUNDING)} == {}


@pytest.mark.slow
@pytest.mark.parametrize("name", [*SLOW, *(pytest.param(one, marks=pytest.mark.long) for one in FITS)])
def test_longer_answers_are_the_same(name: str, tmp_path: Path) -> None:
    (apart,) = differences(*both_ways(tmp_path, [name])).values()
    assert apart <= (DRAWN if name in FITS else FARTHER.get(name, ROUNDING))


@pytest.mark.parametrize(("plain", "refused"), [(True, True), (False, False)])
def test_a_run_does_not_go_on_with_arrays_of_other_sizes(
    plain: bool, refused: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(runtime, "PLAIN", plain)
    nothing: Any = SimpleNamespace(input_hash="", name="another", design=SimpleNamespace(resolved=dict))
    with pytest.raises(InputError) as raised:
        earlier_run(write_fit_run(tmp_path / "run"), nothing, resolve("a2")[0], nothing)
    assert ("BAYESTISSUE_PLAIN" in str(raised.value)) == refused


def test_a_difference_and_a_number_that_one_way_lacks_are_seen() -> None:
    fast = {"a: x": np.array([1.0, 4.0]), "b: mean": np.array([1.0]), "b: error": np.array([0.3])}
    plain = fast | {"a: x": np.array([1.0, 4.4]), "b: mean": np.array([2.0]), "b: error": np.array([0.4])}
    assert differences(fast, plain) == pytest.approx({"a": 0.1, "b": 2.0})
    assert differences(fast, fast | {"a: x": np.array([1.0, np.nan])})["a"] == np.inf
