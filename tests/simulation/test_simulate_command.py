from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from bayestissue.base.resources import shared
from command_line import Outcome, bayestissue


def simulate(specification: Path, out: Path, *options: str) -> Outcome:
    return bayestissue("simulate", specification, "--out", out, *options)


def test_the_committed_example_is_what_its_specification_makes(tmp_path):
    example = shared("data", "example")
    assert simulate(example / "spec.toml", tmp_path / "again").status == 0
    for name in ("impacts.csv", "truth.csv"):
        made, kept = (pd.read_csv(folder / name) for folder in (tmp_path / "again", example))
        # Another processor may round the last digit otherwise.
        pd.testing.assert_frame_equal(made, kept, rtol=1e-10)
    made, kept = (pd.read_csv(folder / "traces.csv.gz") for folder in (tmp_path / "again", example))
    assert made["impact"].equals(kept["impact"])
    assert made["time_s"].equals(kept["time_s"])
    # Recorded to three decimals: at worst one value falls on the other side of a half.
    assert np.abs(made["value"] - kept["value"]).max() < 1.5e-3
    assert (made["value"] == kept["value"]).mean() > 0.999


def test_a_wrong_specification_writes_nothing(tmp_path):
    (tmp_path / "spec.toml").write_text('name = "a"\nsed = 3\n')
    refused = simulate(tmp_path / "spec.toml", tmp_path / "out")
    assert refused.status == 2
    assert "sed" in refused.err
    assert "tissue" in refused.err
    assert not (tmp_path / "out").exists()


def test_the_seed_of_the_command_line_is_the_one_kept(tmp_path):
    (tmp_path / "spec.toml").write_text(
        'name = "a"\nseed = 3\n[design]\nsubjects = 1\n[tissue]\nK_N_per_m = 3000\nC_N_s_per_m = 25\n'
    )
    assert simulate(tmp_path / "spec.toml", tmp_path / "once", "--seed", "8").status == 0
    assert simulate(tmp_path / "once" / "truth.toml", tmp_path / "again").status == 0
    for name in ("truth.csv", "traces.csv.gz", "truth.toml"):
        assert (tmp_path / "once" / name).read_bytes() == (tmp_path / "again" / name).read_bytes()
