from __future__ import annotations

from pathlib import Path

import pytest

from bayestissue.thesis.reanalysis import analysis
from command_line import bayestissue

HEAD = 'name = "mine"\nlikelihood = "published-estimates"\n'


@pytest.fixture
def refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Run ``reproduce`` on a model file that must be refused, and return what it says."""

    def never(*_: object, **__: object) -> None:
        pytest.fail("sampling began before the input was checked")

    monkeypatch.setattr(analysis, "sample_posterior", never)

    def run(model: str, *options: str) -> str:
        path = tmp_path / "model.toml"
        path.write_text(HEAD + model, encoding="utf-8")
        before = sorted(tmp_path.iterdir())
        ended = bayestissue("reproduce", "--model", path, "--out", tmp_path / "run", *options)
        assert (ended.status, ended.out) == (2, "")
        assert sorted(tmp_path.iterdir()) == before
        assert "nothing was written" in ended.err
        return ended.err

    return run


@pytest.mark.parametrize(
    ("model", "words"),
    [
        ("[sampler]\nchain = 2\n", ["sampler.chain", "chains, draws, effective"]),
        ("[formula]\nK = 'log(age) + (1|subject)'\n", ["formula.K", "age", "mass_kg"]),
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
