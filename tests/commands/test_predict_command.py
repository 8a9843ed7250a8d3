from __future__ import annotations

import json
from pathlib import Path

import pandas as pd
import pytest

from command_line import bayestissue
from make_fit_run import make_fit_run


@pytest.mark.slow
def test_predictions_are_printed_and_written_in_the_dataset_s_nouns(tmp_path: Path) -> None:
    run, at = make_fit_run(tmp_path / "run"), tmp_path / "new.csv"
    record = json.loads((run / "run.json").read_text(encoding="utf-8"))
    words = json.dumps(record | {"words": {"subject": "pad", "impact": "drop"}})
    (run / "run.json").write_text(words, encoding="utf-8")
    at.write_text("subject,mass_kg\ns1,1.1\nnobody,\n", encoding="utf-8")
    told = bayestissue("predict", run, "--at", at, "--out", tmp_path / "out")
    assert (told.status, told.err) == (0, "")
    assert "row 2: subject nobody, mass_kg 0.6952, velocity_m_s 1.5; new: subject, trial" in told.out
    table = pd.read_csv(tmp_path / "out" / "predictions.csv")
    assert (table["peak_force_N_low"] < table["peak_force_N"]).all()
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "2 new drops by a fit of made up" in page
    # Names of columns and levels stay.
    assert "subject nobody, mass_kg 0.6952, velocity_m_s 1.5<br>" in page
    shown = json.loads(bayestissue("predict", run, "--at", at, "--json").out)["predictions"]
    assert shown[1]["K_N_per_m"] == pytest.approx(table["K_N_per_m"][1], rel=1e-9)
    at.write_text("subject,mass_kg\ns1,9\n", encoding="utf-8")
    assert "More: bayestissue explain beyond-measured" in bayestissue("predict", run, "--at", at).out
    at.write_text("subject,mass_kg\ns1,heavy\n", encoding="utf-8")
    refused = bayestissue("predict", run, "--at", at, "--out", tmp_path / "other")
    assert refused.status == 2
    assert 'new.csv, row 2, column mass_kg: found "heavy"' in refused.err
    assert not (tmp_path / "other").exists()


def test_joint_draws_lie_beside_the_folder_of_predictions(tmp_path: Path) -> None:
    run, at = make_fit_run(tmp_path / "run"), tmp_path / "new.csv"
    at.write_text("subject,mass_kg\ns1,0.7\ns1,1.1\n", encoding="utf-8")
    out, draws = tmp_path / "out", tmp_path / "joint.parquet"
    within = bayestissue("predict", run, "--at", at, "--out", out, "--draws", out / draws.name)
    assert (within.status, "expected a folder that does not hold" in within.err) == (2, True)
    assert not out.exists()
    told = bayestissue("predict", run, "--at", at, "--out", out, "--draws", draws)
    assert (told.status, told.err) == (0, "")
    assert f"wrote {draws}" in told.out.replace("\n", "")
    wide = pd.read_parquet(draws).pivot_table(index=["chain", "draw"], columns="row", values="peak_force_N")
    assert (wide[1] < wide[2]).mean() > 0.9
