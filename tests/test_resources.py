"""Models that come with the program, by name from any folder."""

from __future__ import annotations

from pathlib import Path

import pytest

from bayestissue import fitting
from bayestissue.errors import InputError
from bayestissue.resources import model_file, shared


@pytest.fixture(autouse=True)
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def of_a_fit(content: dict) -> bool:
    return content.get("likelihood") in fitting.KINDS


def test_every_model_of_the_program_goes_by_its_name():
    names = {path.stem for path in shared("models").glob("*.toml")}
    for name in names:
        assert model_file(name, lambda _: True) == shared("models", f"{name}.toml")
    for name in names - {"causes", "dds", "exact", "plan-thesis", "published"}:
        specification, source = fitting.resolve(name)
        assert source == str(shared("models", f"{name}.toml"))
        assert specification.name == name


def test_a_name_goes_before_a_file_and_a_path_does_not(elsewhere: Path):
    for name in ("impact", "mine"):
        (elsewhere / name).write_text("")
    assert model_file("impact", of_a_fit) == shared("models", "impact.toml")
    for path in ("./impact", elsewhere / "impact", Path("impact"), "mine"):
        assert model_file(path, of_a_fit).resolve() == elsewhere / Path(path).name


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        ("impct", 'found "no such model or file"; expected .*: impact, .*wall.*Write impact'),
        ("standard-linear", ": standard_linear, .*Write standard_linear"),
        ("Maxwell", ": maxwell, .*Write maxwell"),
        ("models/impact.toml", "models/impact.toml: .*: impact, .*Write impact for the one that comes with"),
        ("causes", ": a2, arma, .*Check the spelling"),
        ("nothing_like_it", ": a2, arma, heelstrike, hunt_crossley, .*Check the spelling"),
        (".", 'found "a folder"'),
    ],
)
def test_a_wrong_name_lists_the_right_ones_the_nearest_first(wrong: str, says: str):
    with pytest.raises(InputError, match=says) as refused:
        fitting.resolve(wrong)
    assert "published" not in str(refused.value)
