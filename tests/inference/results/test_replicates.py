"""Predicted traces, as a fit writes them."""

from __future__ import annotations

import h5py
import numpy as np
import pytest
import xarray as xr

from bayestissue.base.results.files import write_tree
from bayestissue.inference.quantities.quantity_draws import rounded

DRAWS, SAMPLES = 100, 200
NOISE = np.array([3e-4, 0.3])


def replicates() -> np.ndarray:
    """Two impacts with a peak of 100 m/s², one of them almost without noise; NaN behind the second's end."""
    rng = np.random.default_rng(5)
    noise = NOISE[:, None] * rng.standard_normal((DRAWS, 2, SAMPLES))
    found = 100 * np.sin(np.linspace(0, 2, SAMPLES)) + noise
    found[:, 1, 150:] = np.nan
    return found


def test_replicates_are_rounded_far_below_their_noise() -> None:
    exact = replicates()
    error = rounded(exact) - exact
    # A step is at most a 64th of the standard deviation of second differences, sqrt(6) of the noise; the
    # number of 32 bits adds 2e-6 of a peak of 100 where the noise is small.
    assert np.nanmax(np.abs(error[:, 1])) <= NOISE[1] * np.sqrt(6) * 1.1 / 64 / 2
    assert np.nanmax(np.abs(error[:, 0])) <= NOISE[0] * np.sqrt(6) * 1.1 / 64 / 2 + 4e-6
    assert np.isnan(error[:, 1, 150:]).all()
    assert np.isfinite(error[:, 0]).all()


def test_what_has_no_noise_is_not_rounded() -> None:
    still = np.broadcast_to(np.linspace(0, 1, 9), (3, 1, 9))
    np.testing.assert_array_equal(rounded(still), still.astype(np.float32))
    np.testing.assert_array_equal(rounded(still[:1]), still[:1].astype(np.float32))


def test_a_file_packs_predictions_and_leaves_draws_as_they_are(tmp_path) -> None:
    dims = ("chain", "draw", "impact", "time_index")
    predicted = xr.Dataset({"deceleration": (dims, rounded(replicates())[None])})
    drawn = xr.Dataset({"K": (dims[:2], np.random.default_rng(6).standard_normal((1, DRAWS)))})
    tree = xr.DataTree.from_dict({"posterior_predictive": predicted, "posterior": drawn})
    write_tree(tree, tmp_path / "posterior.nc")
    with h5py.File(tmp_path / "posterior.nc") as file:
        packed = file["posterior_predictive/deceleration"]
        # Of 100 at a step of a hundredth there are 13 bits, which is below half of 32.
        assert packed.id.get_storage_size() < 0.55 * packed.nbytes
        assert file["posterior/K"].dtype == np.float64
    with xr.open_datatree(tmp_path / "posterior.nc", engine="h5netcdf") as again:
        xr.testing.assert_identical(again.load(), tree)


def test_a_file_keeps_text_single_numbers_and_what_is_empty(tmp_path) -> None:
    words = xr.Dataset(
        {"mass_kg": ("impact", [1.0, np.nan]), "n": ((), 3), "site": ("impact", ["Ferse", "größer"])},
        {"impact": ["a", "b"], "side": ("impact", ["left", "right"])},
        {"made": 1},
    )
    nothing = xr.Dataset({"K": ("level", np.zeros(0), {"unit": "N/m"})}, {"level": np.array([], str)})
    tree = xr.DataTree.from_dict({"/": xr.Dataset(attrs={"of": "ä"}), "words": words, "nothing": nothing})
    write_tree(tree, tmp_path / "posterior.nc")
    with xr.open_datatree(tmp_path / "posterior.nc", engine="h5netcdf") as again:
        xr.testing.assert_identical(again.load(), tree)


@pytest.mark.filterwarnings("error")
def test_a_trace_that_is_all_nan_stays_so() -> None:
    assert np.isnan(rounded(np.full((4, 1, 9), np.nan))).all()
