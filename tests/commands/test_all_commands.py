"""What all commands that write results have in common: --out, --overwrite, --quiet, --json, statuses."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from bayestissue.base.resources import shared
from command_line import bayestissue, options
from make_fit_run import make_fit_run, make_scored_run
from stand_in_planner import kernel

Command = list[str | Path]


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    folder = tmp_path_factory.mktemp("inputs")
    make_fit_run(folder / "run")
    for name in ("one", "other"):
        make_scored_run(folder / name, likelihood="a2")
    (folder / "new.csv").write_text("subject,mass_kg\ns1,0.7\n")
    with kernel():
        yield folder


RECORDED, SPECIFICATION = shared("data", "tutorial", "recorded"), shared("data", "example", "spec.toml")
SAID = options(quantity="deceleration", set={"velocity_m_s": 1.5})
ASKED = options(people=20, masses="0.5,1", ask="mass_exponent_K < 0.5", studies=100)
# Of each command what it is given, and whether its table can be printed as JSON.
COMMANDS: dict[str, tuple[Callable[[Path], Command], bool]] = {
    "init": (lambda _: [RECORDED, *SAID], True),
    "check": (lambda _: [SPECIFICATION.parent], True),
    "estimate": (lambda _: [SPECIFICATION.parent, "--method", "dds"], True),
    "simulate": (lambda _: [SPECIFICATION], False),
    "ask": (lambda folder: [folder / "run", "K > 1000"], True),
    "predict": (lambda folder: [folder / "run", "--at", folder / "new.csv"], True),
    "compare": (lambda folder: [folder / "one", folder / "other"], True),
    "plan": (lambda _: ASKED, False),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", COMMANDS)
def test_results_are_replaced_on_request_alone_and_quiet_says_nothing(
    name: str, inputs: Path, tmp_path: Path
) -> None:
    given, has_json = COMMANDS[name]
    command, out, mine = [name, *given(inputs), "--out"], tmp_path / "out", tmp_path / "mine"
    first = bayestissue(*command, out, *(["--json"] if has_json else []))
    assert first.status == 0, first.err
    assert not has_json or json.loads(first.out)
    names = {path.name for path in out.iterdir()}
    refused = bayestissue(*command, out)
    assert refused.status == 2
    assert "a folder that is not empty" in refused.err
    assert "--overwrite" in refused.err
    again = bayestissue(*command, out, "--overwrite", "--quiet")
    assert (again.status, again.out, again.err) == (0, "", "")
    assert {path.name for path in out.iterdir()} == names
    mine.mkdir()
    (mine / "mine.txt").write_text("keep")
    for more in ([], ["--overwrite"]):
        assert bayestissue(*command, mine, *more).status == 2
    assert [path.name for path in mine.iterdir()] == ["mine.txt"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["mine", "out"]
