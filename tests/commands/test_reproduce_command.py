from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from bayestissue import cli
from bayestissue.base import runtime

HEAD = 'name = "mine"\nlikelihood = "published-estimates"\n'


@pytest.fixture
def refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    """Run ``reproduce`` on a model file that must be refused, and return what it says."""
    from bayestissue.thesis.reanalysis import analysis as published

    def never(*_: object, **__: object) -> None:
        pytest.fail("sampling began before the input was checked")

    monkeypatch.setattr(published, "sample_posterior", never)
    # The tests have set JAX up already, and keep their own signals.
    monkeypatch.setattr(runtime, "configure", lambda **_: None)
    monkeypatch.setattr(signal, "signal", lambda *_: None)

    def run(model: str, *options: str) -> str:
        path = tmp_path / "model.toml"
        path.write_text(HEAD + model, encoding="utf-8")
        out = tmp_path / "run"
        before = sorted(tmp_path.iterdir())
        monkeypatch.setattr(
            sys, "argv", ["bayestissue", "reproduce", "--model", str(path), "--out", str(out), *options]
        )
        with pytest.raises(SystemExit) as ended:
            cli.main()
        assert ended.value.code == 2
        assert sorted(tmp_path.iterdir()) == before
        said = capsys.readouterr()
        assert said.out == ""
        assert "nothing was written" in said.err
        return said.err

    return run


@pytest.mark.parametrize(
    ("model", "words"),
    [
        ("[sampler]\nchain = 2\n", ["sampler.chain", "chains, draws, effective"]),
        ("[formulas]\nK = '1'\n", ["formulas", "formula"]),
        ("[formula]\nK = 'log(age) + (1|subject)'\n", ["formula.K", "age", "mass_kg"]),
        (
            "[priors.sd_trial]\nK = { distribution = 'half-normal', scale = -1.0 }\n"
            "C = { distribution = 'half-normal', scale = 1.0 }\n",
            ["priors.sd_trial.K", "-1.0", "greater than 0"],
        ),
        (
            "[formula]\nC = 'energy_J + velocity_m_s + log(mass_kg) + (1|trial)'\n",
            ["formula.C", "at most two", "E = ½MV²"],
        ),
        ("[comparison.formulas]\nbad = 'height'\n", ["height", "mass_kg"]),
    ],
)
def test_a_wrong_model_is_refused_in_its_own_terms(refused, model: str, words: list[str]) -> None:
    said = refused(model)
    for word in words:
        assert word in said, word


def test_a_full_result_folder_is_refused_before_anything_else(refused, tmp_path: Path) -> None:
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "kept.csv").write_text("kept")
    assert "a folder that is not empty" in refused("")
    assert "which alone --overwrite replaces" in refused("", "--overwrite")
    assert (tmp_path / "run" / "kept.csv").read_text() == "kept"


def stopped(folder: Path, signal_number: int) -> int:
    """Start ``reproduce``, send the signal once its staging folder lies there, and return its status."""
    program = subprocess.Popen(  # noqa: S603 - our own program
        [sys.executable, "-m", "bayestissue", "reproduce", "--quiet", "--out", str(folder / "run")],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env=os.environ | {"JAX_PLATFORMS": "cpu"},
    )
    try:
        # The work before it takes some 40 s, and more where others share the machine.
        until = time.monotonic() + 240
        while not list(folder.glob(".run.partial")):
            assert program.poll() is None, "ended before it began to write"
            assert time.monotonic() < until
            time.sleep(0.05)
        program.send_signal(signal_number)
        return program.wait(timeout=60)
    finally:
        program.kill()
        program.wait()


@pytest.mark.slow
def test_a_killed_run_leaves_no_result(tmp_path: Path) -> None:
    assert stopped(tmp_path, signal.SIGKILL) == -signal.SIGKILL
    assert not (tmp_path / "run").exists()


@pytest.mark.long
def test_a_terminated_run_clears_its_staging_away(tmp_path: Path) -> None:
    assert stopped(tmp_path, signal.SIGTERM) == 130
    assert list(tmp_path.iterdir()) == []
