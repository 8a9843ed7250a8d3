"""What `make setup` installs, and what it says meanwhile."""

from __future__ import annotations

import importlib.util
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


def pins(name: str) -> dict[str, str]:
    text = (ROOT / name).read_text(encoding="utf-8")
    return dict(re.findall(r"^([A-Za-z0-9._-]+)==(\S+)", text, flags=re.MULTILINE))


def names(requirements: list[str]) -> set[str]:
    return {re.split(r"[<>=~!\[ ]", each)[0].lower() for each in requirements}


@pytest.fixture(scope="module")
def project() -> dict:
    return tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def install():
    """The script, which is no part of the package."""
    specification = importlib.util.spec_from_file_location("install", ROOT / "tools" / "install.py")
    assert specification is not None
    assert specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module


def test_both_locks_have_the_same_pins() -> None:
    run, every = pins("requirements.lock"), pins("requirements-dev.lock")
    assert run.items() <= every.items()


def test_a_run_installs_what_it_needs_and_no_tool_of_the_tests(project: dict) -> None:
    run, every = set(pins("requirements.lock")), set(pins("requirements-dev.lock"))
    groups = project["dependency-groups"]
    dev = names([each for each in groups["dev"] if isinstance(each, str)])
    assert names(project["project"]["dependencies"]) | names(groups["build"]) <= run
    assert not dev & run
    assert dev <= every


@pytest.mark.skipif(shutil.which("make") is None, reason="needs make")
def test_what_contributors_set_up_first_has_the_tools_that_they_are_told_to_run() -> None:
    guide = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    first = guide.partition("\nmake ")[2].split()[0]
    done = subprocess.run(["make", "-nB", first], cwd=ROOT, capture_output=True, text=True, check=True)  # noqa: S603, S607
    locks = re.findall(r"tools/install.py \S+ (\S+)", done.stdout)
    assert {"pytest", "ruff", "mypy", "import-linter"} <= set().union(*map(pins, locks))


def test_installing_says_how_far_it_is(install, capsys, monkeypatch, tmp_path) -> None:
    monkeypatch.setattr(install, "EVERY_S", 0.2)
    (tmp_path / "lib" / "python3.12" / "site-packages" / "numpy-2.dist-info").mkdir(parents=True)
    pretended = "import time; print('  Downloading numpy-2-cp312.whl (16 MB)', flush=True); time.sleep(1.2)"
    install.run([sys.executable, "-c", pretended], "installing", tmp_path)
    said = capsys.readouterr().out
    assert said.startswith("installing ...\n")
    assert "1 packages fetched, the last numpy; 1 installed" in said
    assert "done after" in said


def test_what_the_installer_said_is_shown_if_it_failed(install, tmp_path) -> None:
    with pytest.raises(SystemExit, match="no such package"):
        install.run([sys.executable, "-c", "import sys; sys.exit('no such package')"], "installing", tmp_path)


def test_a_release_tests_itself_on_every_python_that_the_project_claims(project: dict) -> None:
    tox, claimed = project["tool"]["tox"], " ".join(project["project"]["classifiers"])
    minors = re.findall(r":: Python :: 3\.(\d+)", claimed)
    # Besides those of each Python there is one of the declared dependencies alone.
    assert [*(f"py3{minor}" for minor in minors), "declared"] == tox["env_list"]
    assert len(minors) == 3
    manual = (ROOT / "docs" / "tutorial" / "install.md").read_text(encoding="utf-8")
    assert "self-test passes with Python 3.{}, 3.{} and 3.{}".format(*minors) in " ".join(manual.split())
    # The wheel with the pinned libraries, away from the checkout.
    base = tox["env_run_base"]
    assert (base["package"], base["deps"]) == ("wheel", ["-r requirements.lock"])
    assert base["change_dir"] == "{env_tmp_dir}"
    (command,) = base["commands"]
    assert command[:2] == ["bayestissue", "selftest"]


@pytest.mark.skipif(shutil.which("make") is None, reason="needs make")
def test_a_python_that_is_missing_fails_a_release_and_no_other_run(project: dict) -> None:
    assert project["tool"]["tox"]["skip_missing_interpreters"] is True
    command = ["make", "-n", "release-check"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)  # noqa: S603
    assert "tox run --skip-missing-interpreters false" in done.stdout
