from __future__ import annotations

import re
from pathlib import Path

import pytest

import bayestissue
from bayestissue.inference.model_comparison import COMPARED
from bayestissue.inference.results.labels import ATTRIBUTES
from bayestissue.inference.results.meanings import heading_words, meaning

SOURCE = Path(bayestissue.__file__).parent
# What people read: pages, tables, console and the README.
READ = [
    *SOURCE.glob("reports/pages/**/*.html"),
    *SOURCE.glob("reports/pages/**/*.py"),
    *SOURCE.glob("commands/*.py"),
]
README = SOURCE.parents[1] / "README.md"


@pytest.mark.parametrize("variable", COMPARED)
def test_all_that_compare_shows_says_what_it_is_of(variable: str) -> None:
    assert meaning(variable).what
    assert bool(meaning(variable).level) != variable.startswith("mass_exponent")
    assert "typical" not in variable or variable.endswith("_typical_person")


def test_these_impacts_a_typical_and_a_new_person_are_three_things() -> None:
    words = {meaning(f"K{of}").level for of in ("_secant_of_impacts", "_typical_person", "_new", "_subject")}
    assert len(words) == 4
    assert "these impacts" in meaning("K_secant_of_impacts").level
    assert "typical" not in meaning("K_secant_of_impacts").level


def test_one_person_is_neither_typical_nor_new() -> None:
    for variable in ("K_new", "C_trial", "K_typical_person"):
        assert "this person" in meaning(variable, people=1).level
        assert "typical" not in meaning(variable, people=1).level


def test_the_units_of_posterior_nc_say_the_same() -> None:
    assert ATTRIBUTES["K_new"]["long_name"] == f"stiffness K of {meaning('K_new').level}"


def test_a_person_is_named() -> None:
    assert heading_words("K_subject", label="s3") == "K of person s3 at the reference mass"
    assert heading_words("C_equivalent_of_subject", label="s3") == (
        "equivalent C of person s3's own impacts (geometric mean)"
    )


def test_typical_is_said_of_a_person_or_a_condition_and_of_nothing_else() -> None:
    """Of impacts the word hides whether an interval is of these or of others."""
    found = [
        (path.name, line.strip())
        for path in (*READ, README)
        for line in path.read_text(encoding="utf-8").splitlines()
        for noun in re.findall(r"(?<![\w.\"'])[Tt]ypical (\w+)", line)
        if noun not in ("person", "one", "condition", "or")
    ]
    assert found == []
