"""What a finished run says of itself, whatever of it was read."""

from __future__ import annotations

import pytest
import xarray as xr

from bayestissue import read_run
from bayestissue.inference.answers.study import Study
from make_fit_run import make_fit_run


@pytest.mark.slow
def test_beside_a_discrepancy_there_is_no_law_whatever_was_read(tmp_path):
    # `compare` leaves out most of what impacts have. The element's own force is not the tissue's: its peak
    # had a narrow interval that missed the tissue's.
    run = read_run(make_fit_run(tmp_path / "run", discrepancy=True))
    posterior = run.posterior["posterior"].to_dataset()
    of_population = posterior.drop_vars([name for name, each in posterior.items() if "impact" in each.dims])
    constants = run.posterior["constant_data"].to_dataset()
    tree = xr.DataTree.from_dict({"posterior": of_population, "constant_data": constants})
    finished = Study.from_tree(tree, run.about["model"])
    assert not finished.law.everywhere
