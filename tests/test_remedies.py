"""Every warning and error has an entry that says what it does to K and C and what to do, and leads to it."""

from __future__ import annotations

import ast
import copy
import json
import pickle
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from string import Formatter

import pytest

import bayestissue
from bayestissue import cli
from bayestissue.base.errors import Coded, InputError, more
from bayestissue.base.remedies import codes_in, entries, flags, messages, sentences
from bayestissue.commands.program import explain
from bayestissue.inference.checking.findings import Finding, warned_codes, warnings
from bayestissue.inference.checking.recording_warnings import flagged_recordings
from bayestissue.model.hierarchy.specification import COMBINATIONS

SOURCE = Path(bayestissue.__file__).parent
# What makes a warning or an error: all of these take a code.
CARRIERS = ("Problem", "Coded", "Check", "PartialResultError")
KEY = re.compile(r"[a-z-]+\.[a-zA-Z_-]+")


@cache
def trees() -> dict[Path, ast.Module]:
    return {
        path: ast.parse(path.read_text(encoding="utf-8"))
        for path in sorted(SOURCE.rglob("*.py"))
        if path.parent.name != "remedies"
    }


def calls(tree: ast.AST) -> Iterator[ast.Call]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Call):
            name = getattr(node.func, "id", getattr(node.func, "attr", ""))
            if name in CARRIERS:
                yield node


def code_of(call: ast.Call) -> ast.expr | None:
    for keyword in call.keywords:
        if keyword.arg == "code":
            return keyword.value
    return call.args[-1] if len(call.args) > 1 else None


def test_every_entry_has_all_its_parts() -> None:
    for entry in entries().values():
        for _, text in (*entry.parts, ("title", entry.title + ".")):
            assert text
            assert text[-1] in ".`"
            assert text.count("`") % 2 == 0
        assert not entry.title.endswith(".")


def test_every_place_that_makes_a_warning_or_an_error_carries_a_known_code() -> None:
    for path, tree in trees().items():
        # The audit of a publication has checks of its own, which are findings and no warnings.
        if "audit" in path.parts or path.name == "checking.py":
            continue
        for call in calls(tree):
            code = code_of(call)
            where = f"{path.relative_to(SOURCE)}:{call.lineno}"
            assert code is not None, where
            if isinstance(code, ast.Constant):
                assert code.value in entries(), where
            else:
                assert isinstance(code, ast.Name | ast.Attribute), where


@pytest.mark.slow
def test_every_message_has_a_code_and_is_told() -> None:
    """What is written in parts, such as ``f"velocity-off.{kind}"``, counts by its code."""
    used = {text for tree in trees().values() for text in _texts_of(tree)}
    used |= {one.message for one in COMBINATIONS}
    for key, told in messages().items():
        assert told.code in entries()
        assert key in used or f"{told.code}." in used, key
        assert all(text == text.strip() and text for text in (told.expected, told.remedy))


@pytest.mark.slow
def test_every_key_of_a_message_is_known() -> None:
    for path, tree in trees().items():
        for call in ast.walk(tree):
            if isinstance(call, ast.Call) and getattr(call.func, "attr", "") == "stated":
                owner = getattr(getattr(call.func, "value", None), "id", "")
                key = call.args[0] if call.args else None
                known = {"Problem": messages(), "InputError": messages(), "Coded": flags()}.get(owner)
                if known is not None and isinstance(key, ast.Constant):
                    assert key.value in known, (path.name, call.lineno, key.value)
        several = [
            key for key in _texts_of(tree) if KEY.fullmatch(key) and key.partition(".")[0] in entries()
        ]
        of_findings = {*sentences(), *(key.rpartition(".")[0] for key in sentences())}
        assert set(several) <= {*messages(), *flags(), *of_findings}, path.name


def _texts_of(tree: ast.Module) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.value


@pytest.mark.slow
def test_every_entry_is_led_to_and_every_word_that_warns_is_said() -> None:
    used = {text for tree in trees().values() for text in _texts_of(tree)}
    assert set(entries()) - {text.partition(".")[0] for text in used} == set()
    assert set(flags()) <= used


def test_functions_that_messages_name_are_public() -> None:
    texts = [text for message in messages().values() for text in (message.expected, message.remedy)]
    texts += [text for entry in entries().values() for _, text in entry.parts]
    named = {name for text in texts for name in re.findall(r"bayestissue\.([a-z_.]+[a-z_])", text)}
    assert {"dataset", "read_dataset"} <= named <= set(dir(bayestissue))


def test_words_of_tables_are_recognised() -> None:
    assert len(flags()) > 60
    for key, flag in flags().items():
        names = {name for _, name, _, _ in Formatter().parse(flag.says) if name}
        assert codes_in(f"before; {Coded.stated(key, **dict.fromkeys(names, 7))}; after") == [flag.code], key


def test_words_keep_their_code_and_are_words() -> None:
    flag = Coded("begins below zero: an offset", "starts-below-zero")
    for same in (copy.deepcopy(flag), pickle.loads(pickle.dumps(flag))):  # noqa: S301
        assert (same, same.code) == (flag, flag.code)
    assert json.dumps([flag]) == '["begins below zero: an offset"]'


def test_a_fit_leads_to_its_warnings() -> None:
    diagnostics = {
        "passed": False,
        "checks": [{"name": "R-hat", "passed": False, "code": "r-hat"}],
        "model_form": Finding("model-form", passed=False, words="Another law.").record(),
        "measuring_chain": Finding("measuring-chain", passed=False, words="They contradict it.").record(),
        "recordings": flagged_recordings(["i7"], [[Coded.stated("spike")]]),
    }
    assert warned_codes(diagnostics) == [
        "r-hat", "measuring-chain", "model-form", "flagged-recordings", "spike",
    ]  # fmt: skip
    assert [each.code for each in warnings(diagnostics)] == ["measuring-chain", "model-form"]


def test_explain_prints_entries_and_lists_them(capsys: pytest.CaptureFixture[str]) -> None:
    explain(["clipped", "hum"], as_json=False)
    said = " ".join(capsys.readouterr().out.split())
    for code in ("clipped", "hum"):
        for heading, text in entries()[code].parts:
            assert f"{heading} {text}" in said
    explain([], as_json=False)
    listed = capsys.readouterr().out
    assert all(f"  {code} " in listed for code in entries())
    explain(["hum"], as_json=True)
    assert json.loads(capsys.readouterr().out)[0]["effect"] == entries()["hum"].effect
    with pytest.raises(InputError, match="Is it clipped") as refused:
        explain(["cliped"], as_json=False)
    assert refused.value.problems[0].code == "option-value"


def test_an_error_names_its_code_and_the_command_that_explains_it(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr("sys.argv", ["bayestissue", "check", str(tmp_path / "nothing")])
    with pytest.raises(SystemExit) as left:
        cli.main()
    said = capsys.readouterr().err.splitlines()
    assert left.value.code == 2
    assert said[1].endswith(" [no-dataset]")
    assert said[-1] == "More: bayestissue explain no-dataset"
    assert more(["hum", "spike", "hum"]) == "More: bayestissue explain hum spike"
    assert more([]) == ""
