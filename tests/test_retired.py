"""A name that is gone is refused by one mechanism, which says what to do instead."""

import pytest

from bayestissue import cli
from bayestissue.base.errors import InputError
from bayestissue.base.remedies import retired
from bayestissue.base.resources import model_file, with_base
from bayestissue.base.settings import TomlTable, checked
from bayestissue.commands.program import explain


class Inner(TomlTable):
    """A table.

    Attributes:
        place: one of one.
    """

    place: int = 1


class Schema(TomlTable):
    """A file.

    Attributes:
        channel: a list.
    """

    channel: tuple[Inner, ...] = ()


def test_an_unknown_key_that_was_known_says_what_to_do() -> None:
    with pytest.raises(InputError) as refused:
        checked({"motion": {"free": False}}, Schema, file="dataset.toml")
    (problem,) = refused.value.problems
    assert (problem.code, problem.column) == ("retired", "motion")
    assert problem.remedy == retired()["key"]["motion"]


def test_so_does_a_value_within_a_list_of_tables() -> None:
    with pytest.raises(InputError) as refused:
        checked({"channel": [{"place": "hammer"}]}, Schema, file="dataset.toml")
    (problem,) = refused.value.problems
    assert (problem.code, problem.column) == ("retired", "channel.0.place")
    assert problem.remedy == retired()["value"]["channel.place = hammer"]


def test_so_does_a_model() -> None:
    name = next(iter(retired()["model"]))
    for asked in (
        lambda: model_file(name, lambda _: True),
        lambda: with_base({"like": name}, "mine.toml", f'like = "{name}"'),
    ):
        with pytest.raises(InputError) as refused:
            asked()
        assert refused.value.problems[0].remedy == retired()["model"][name]


@pytest.mark.parametrize(
    "words", [[name] for name in retired()["command"]] + [name.split() for name in retired()["option"]]
)
def test_so_do_commands_and_options(
    words: list[str], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    given = words if not words[-1].startswith("--") or len(words) > 1 else ["fit", *words]
    monkeypatch.setattr("sys.argv", ["bayestissue", *given])
    with pytest.raises(SystemExit) as left:
        cli.main()
    assert left.value.code == 2
    assert (retired()["command"] | retired()["option"])[" ".join(words)] in capsys.readouterr().err


def test_explain_shows_what_to_do_instead(capsys: pytest.CaptureFixture[str]) -> None:
    explain(["retired"], as_json=False)
    listed = " ".join(capsys.readouterr().out.split())
    assert all(
        f"{kind} {name}: {instead}" in listed
        for kind in retired()
        for name, instead in retired()[kind].items()
    )
