"""Models that come with the program, by name from any folder."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest

from bayestissue.base.errors import InputError
from bayestissue.base.resources import model_content, model_file, model_text, shared
from bayestissue.commands import program
from bayestissue.studies import fitting


@pytest.fixture(autouse=True)
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def of_a_fit(content: dict) -> bool:
    return content.get("likelihood") in fitting.KINDS


OF_A_FIT = [path.stem for path in sorted(shared("models").glob("*.toml")) if of_a_fit(model_content(path))]
LISTED = re.escape(", ".join(OF_A_FIT))


def test_every_model_of_the_program_goes_by_its_name():
    names = {path.stem for path in shared("models").glob("*.toml")}
    for name in names:
        assert model_file(name, lambda _: True) == shared("models", f"{name}.toml")
    for name in names - {"plan-thesis", "published"}:
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
        ("nothing_like_it", f": {LISTED}. Check the spelling"),
        (".", 'found "a folder"'),
    ],
)
def test_a_wrong_name_lists_the_right_ones_the_nearest_first(wrong: str, says: str):
    with pytest.raises(InputError, match=says) as refused:
        fitting.resolve(wrong)
    assert "published" not in str(refused.value)


BASE = """
name = "base"
likelihood = "impact"  # of what
discrepancy = "none"

[priors]
# By this much.
sd_noise = { distribution = "half-normal", scale = 0.3 }

[priors.intercept]
K = { distribution = "normal", mean = 8.0, sd = 0.3 }
C = { distribution = "normal", mean = 3.0, sd = 0.3 }
"""
OWN = """# Ours.
like = "base.toml"
element = "wall"  # its law

[priors.intercept]
K = { distribution = "half-student-t", df = 3 }

[priors.element.thickness_m]
log = { distribution = "normal", mean = -3.5, sd = 2.5 }
"""


def test_a_file_says_how_it_differs_from_another(elsewhere: Path):
    (elsewhere / "base.toml").write_text(BASE)
    (elsewhere / "own.toml").write_text(OWN)
    content = model_content(elsewhere / "own.toml")
    assert content["name"] == "own"
    assert (content["likelihood"], content["discrepancy"], content["element"]) == ("impact", "none", "wall")
    # A distribution is one thing: none of the other's keys are left in it.
    assert content["priors"]["intercept"]["K"] == {"distribution": "half-student-t", "df": 3}
    assert content["priors"]["intercept"]["C"]["mean"] == 3.0
    text = model_text(elsewhere / "own.toml")
    assert tomllib.loads(text) == content | {"description": ""}
    assert text.startswith("# Ours.\n")
    assert {'likelihood = "impact"  # of what', 'element = "wall"  # its law', "# By this much."} <= set(
        text.splitlines()
    )


@pytest.mark.parametrize("name", ["arma", "wall", "plan-thesis", "published"])
def test_a_model_is_printed_whole(name: str, capsys: pytest.CaptureFixture[str]):
    program.model(name)
    printed = tomllib.loads(capsys.readouterr().out)
    content = model_content(shared("models", f"{name}.toml"))
    assert {"name": name, **printed} == content
    if content.get("likelihood") in fitting.KINDS:
        assert "like" not in printed
        given = fitting.resolve({"like": name, "name": name, "description": content["description"]})[0]
        assert given == fitting.resolve(name)[0]


@pytest.mark.parametrize("like", ['"nothing"', '"own.toml"', "3"])
def test_a_file_like_none_is_refused(elsewhere: Path, like: str):
    (elsewhere / "own.toml").write_text(f'name = "own"\nlike = {like}\n')
    with pytest.raises(InputError, match=r"own\.toml, row 2, column like: found .*impact, .*Write, say"):
        fitting.resolve("./own.toml")
