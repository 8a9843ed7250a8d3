from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr

from bayestissue import Fit, read_run
from bayestissue.base.errors import InputError
from bayestissue.base.results.manifest import write_manifest
from bayestissue.inference.answers import predictions
from bayestissue.inference.answers.law import Law
from bayestissue.inference.answers.predictions import (
    NO_LAW,
    QUANTITIES,
    predict,
    predicted,
    read_conditions,
)
from bayestissue.inference.answers.questions import ask, numbered
from bayestissue.inference.answers.study import Study
from bayestissue.inference.checking.findings import ELEMENT_ALONE
from bayestissue.inference.results.labels import variables
from bayestissue.mechanics.elements import outcomes
from make_fit_run import make_fit_run

AT = pd.DataFrame(
    {
        "subject": ["s1", "nobody", None],
        "mass_kg": [0.7, 1.1, np.nan],
        "velocity_m_s": [1.5, 2.0, np.nan],
    }
)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Fit:
    return read_run(make_fit_run(tmp_path_factory.mktemp("predicted") / "run"))


def sure(run: Fit, **sd: float) -> Study:
    """The run with these standard deviations in place of its own, conditions and exponents without effect."""
    posterior = run.posterior["posterior"].to_dataset().copy()
    named = {"sd_impact_K": 0.0, "sd_impact_C": 0.0, "sd_subject_K": 0.0, "sd_subject_C": 0.0}
    named |= {"sd_trial_K": 0.0, "sd_trial_C": 0.0, "mass_exponent_K": 0.0, "mass_exponent_C": 0.0} | sd
    for name, value in named.items():
        posterior[name] = xr.full_like(posterior[name], value)
    constants = run.posterior["constant_data"].to_dataset()
    groups = {"posterior": posterior, "constant_data": constants}
    return Study.from_tree(xr.DataTree.from_dict(groups), run.about["model"])


@pytest.mark.slow
def test_a_row_of_empty_cells_is_a_row_of_a_file(run: Fit, tmp_path: Path) -> None:
    """Predictions are joined to their rows by position."""
    path = tmp_path / "at.csv"
    path.write_text("subject,mass_kg,velocity_m_s\n,,\ns1,0.7,1.5\n,,\n\ns1,1.1,2\n")
    s1 = {"subject": "s1", "mass_kg": 0.7, "velocity_m_s": 1.5}
    rows = read_conditions(path, run.study)
    assert rows == [{}, s1, {}, s1 | {"mass_kg": 1.1, "velocity_m_s": 2.0}]
    pd.read_csv(path).to_csv(path, index=False)
    assert read_conditions(path, run.study) == rows
    path.write_text('mass_kg\n""\n0.7\n')
    assert read_conditions(path, run.study) == [{}, {"mass_kg": 0.7}]


@pytest.mark.slow
def test_a_headform_has_the_head_injury_criterion_too(run: Fit) -> None:
    plain = sure(run)
    headform = replace(plain, law=replace(plain.law, headform=True))
    at = {"subject": "s1", "mass_kg": 4.6, "velocity_m_s": 3.0}
    table = predict(headform, [at])
    of = plain.draws.sel(subject="s1")
    p = {q: np.exp(of[f"intercept_{q}"] + of[f"subject_effect_{q}"]).to_numpy().ravel() for q in "KC"}
    made = outcomes("kelvin_voigt", p, 4.6, 3.0, headform=True)
    for name in ("HIC15", "HIC36"):
        assert table[name][0] == pytest.approx(np.median(made[name]), rel=1e-9)
    asked = "HIC15[subject=s1, mass_kg=4.6, velocity_m_s=3]"
    assert ask(headform, numbered([asked]))["median"][0] == pytest.approx(table["HIC15"][0], rel=1e-9)
    assert not any(name.startswith("HIC") for name in predict(plain, [at]))
    with pytest.raises(InputError, match=r"headform = true in the table \[impactor\]"):
        ask(plain, numbered([asked]))


def test_beside_a_discrepancy_there_are_no_peaks(run: Fit) -> None:
    finished = sure(run)
    without = Study(finished.draws, finished.recorded, Law(described=False))
    table = predict(without, [{"mass_kg": 1.0}])
    assert table["K_N_per_m"].notna().all()
    assert table["peak_force_N"].isna().all()
    assert table["note"][0] == NO_LAW
    # Beside K_secant, which earlier versions' runs have as K, it is the element's own.
    posterior = finished.draws.assign(K_secant_of_impacts=finished.draws["K_new"])
    alone = Study(posterior, finished.recorded, Law(described=False))
    assert predict(alone, [{"mass_kg": 1.0}])["note"][0] == f"{ELEMENT_ALONE}; {NO_LAW}"
    asked = ["K[subject=s1] > 1", "K_new", "K[impact=t0-s0]", "mass_exponent_K > 0"]
    asked += ["C", "K_secant_of_impacts"]
    notes = ask(alone, numbered(asked))["note"]
    assert notes.str.contains(ELEMENT_ALONE, regex=False).tolist() == [True] * 4 + [False] * 2
    assert not ask(without, numbered(asked[:4]))["note"].str.contains(ELEMENT_ALONE, regex=False).any()


def test_from_the_run_and_its_table_all_faults_at_once(run: Fit, tmp_path: Path) -> None:
    file = tmp_path / "new.csv"
    file.write_text("subject,mass_kg,velocity_m_s\ns1,-2,x\ns1,,1e9\n", encoding="utf-8")
    with pytest.raises(InputError) as error:
        run.predict(file)
    told = [str(problem) for problem in error.value.problems]
    assert len(told) == 3
    assert 'new.csv, row 2, column mass_kg: found "-2"; expected a number of kg above 0' in told[0]
    for wrong, words in (
        (pd.DataFrame({"masskg": [1.0]}), 'Is it "mass_kg"'),
        (tmp_path / "nothing.csv", "no such file"),
        (pd.DataFrame({"mass_kg": [1.0, -1.0]}), r"table \(rows from 0\), row 1, column mass_kg"),
        (pd.DataFrame({"impact": ["t0-s0"], "mass_kg": [1.0]}), "Each row is a new impact"),
    ):
        with pytest.raises(InputError, match=words):
            run.predict(wrong)


def test_the_caller_may_compute_in_float32(run: Fit) -> None:
    import jax

    with jax.enable_x64(False):
        table = run.predict(AT.iloc[:1])
        assert not jax.config.jax_enable_x64
    assert table["peak_force_N"].dtype == np.float64
    assert table["peak_force_N"].iloc[0] == pytest.approx(run.predict(AT.iloc[:1])["peak_force_N"].iloc[0])


def test_a_place_that_cant_be_written_is_refused(run: Fit, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="can be made and written"):
        run.predict(AT, draws=tmp_path / "file" / "joint.nc")


def test_a_long_table_is_predicted_in_blocks(run: Fit, monkeypatch: pytest.MonkeyPatch) -> None:
    """200,000 rows asked for all their draws at once. What a block draws anew is the scatter alone."""
    rows = pd.concat([AT] * 4, ignore_index=True).assign(mass_kg=np.linspace(0.4, 0.7, 12))
    whole = run.predict(rows)
    draws, told = int(whole["draws"].iloc[0]), list[tuple[str, int, int]]()
    monkeypatch.setattr(predictions, "SETTINGS", replace(predictions.SETTINGS, predicted=5 * draws))
    blocks = run.predict(rows, say=lambda *said: told.append(said))
    assert told == [("predicting", done, 12) for done in (0, 5, 10)]
    assert list(blocks.columns) == list(whole.columns)
    same = ["subject", "mass_kg", "velocity_m_s", "new", "draws", "simulated", "note"]
    pd.testing.assert_frame_equal(blocks[same], whole[same])
    # An end of an interval is known to some hundredths of a scatter of some per cent.
    for column in ("K_N_per_m", "C_N_s_per_m_low", "peak_force_N_high"):
        np.testing.assert_allclose(blocks[column], whole[column], rtol=0.1)


def test_joint_draws_are_those_of_the_table(run: Fit, tmp_path: Path) -> None:
    draws = run.predicted_draws(AT)
    assert draws.sizes == {"chain": 2, "draw": 100, "row": 3}
    table = run.predict(AT, draws=tmp_path / "joint.parquet")
    for name, column in QUANTITIES.items():
        assert draws[name].attrs["unit"] == variables()[name].attrs["unit"]
        median = draws[name].median(["chain", "draw"]).to_numpy()
        assert median == pytest.approx(table[column].to_numpy(), rel=1e-12), name
    long = pd.read_parquet(tmp_path / "joint.parquet")
    assert list(long)[:3] == ["chain", "draw", "row"]
    assert long.groupby("row")["peak_force_N"].median().to_numpy() == pytest.approx(
        table["peak_force_N"].to_numpy(), rel=1e-12
    )
    run.predict(AT, draws=tmp_path / "joint.nc")
    with xr.open_dataset(tmp_path / "joint.nc", engine="h5netcdf") as kept:
        xr.testing.assert_equal(kept, draws)
        assert kept["peak_force"].attrs == {"unit": "N", "long_name": "greatest force on the impactor"}


def test_a_difference_of_rows_is_as_unsure_as_it_is(run: Fit) -> None:
    """Two impacts on one new person share that person, whom nobody knows; on two they do not."""
    finished = sure(run, sd_subject_K=0.5)
    at = pd.DataFrame({"subject": ["new", "new", "another"], "mass_kg": 0.7, "trial": "t0"})
    log_K = np.log(predicted(finished, read_conditions(at, finished)).draws["K"])
    one, again, another = (log_K.sel(row=row) for row in (1, 2, 3))
    assert float(np.abs(one - again).max()) == 0.0
    # Quantiles of 200 draws tell a standard deviation to 5 % at best.
    assert float((one - another).std()) == pytest.approx(np.sqrt(2) * 0.5, rel=0.2)


def test_draws_are_whole_or_not_there_and_cost_no_other_file(run: Fit, tmp_path: Path) -> None:
    path, at = tmp_path / "joint.nc", AT.iloc[:1]
    with pytest.raises(InputError, match=r'found "\.csv"; expected a name that ends in \.parquet or \.nc'):
        run.predict(at, draws=tmp_path / "joint.csv")
    run.predict(at, draws=path)
    with pytest.raises(InputError, match="a name not yet taken"):
        run.predict(at, draws=path)
    run.predict(at, draws=path, overwrite=True)
    path.write_text("something else", encoding="utf-8")
    with pytest.raises(InputError, match="no such file of bayestissue"):
        run.predict(at, draws=path, overwrite=True)
    assert path.read_text(encoding="utf-8") == "something else"
    assert run.folder is not None
    write_manifest(run.folder, "fit")
    with pytest.raises(InputError, match="a folder inside other results"):
        run.predict(at, draws=run.folder / "posterior.nc", overwrite=True)
    with pytest.raises(InputError, match="masskg"):
        run.predict(at.rename(columns={"mass_kg": "masskg"}), draws=tmp_path / "new.nc")
    assert [file.name for file in tmp_path.iterdir()] == ["joint.nc"]
