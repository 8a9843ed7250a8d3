"""How formulas are read: every character is used or refused with its place, and arithmetic is as written."""

from __future__ import annotations

import re

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from bayestissue.model.hierarchy.formulas.formula import resolve
from designs import REFERENCE, impacts

ROWS = impacts().assign(sex=lambda t: np.where(t["subject"].isin(t["subject"].unique()[::2]), "f", "m"))
ROWS["age"] = 20.0 + 3.0 * ROWS["subject"].factorize()[0] + ROWS["session"] ** 2
WORDS = ["side", "sex", "age", "mass_kg", "subject", "trial", "1", "0", "2", "1e400", "'left'", "`side`"]
SIGNS = [*"+-*/:|(){}[],.=<>!%~^\\", "**", "//", "==", "||", "and", "log(", "C(", "\n", " ", "+ (1|subject)"]
PIECES = st.lists(st.sampled_from(WORDS + SIGNS), max_size=12)


@pytest.mark.parametrize(
    ("formula", "place"),
    [
        ("log(mass_kg) + side) + (1|subject)", 20),
        ("log(mass_kg) side + (1|subject)", 14),
        ("log(mass_kg), side", 13),
        ("side sex", 6),
        ('side["left"]', 5),
        ("side\nsex", 6),
        ("side // sex", 7),
        ("C(side, levels=1)", 15),
    ],
)
def test_what_cannot_be_read_is_refused_with_its_place(formula, place):
    reasons = [fault.reason for fault in resolve(formula, ROWS, REFERENCE).faults]
    assert any(f"at character {place}, after" in reason for reason in reasons)


@pytest.mark.parametrize(
    ("formula", "reason"),
    [
        ("age**2", "as {age**2}"),
        ("(side + age)**1000000000", "as in (a + b)**2"),
        ("2*mass_kg", "2 is no term"),
        ("1e400*mass_kg", "beyond 1e308"),
        ("'side'", "a column stands without quotes"),
        ("age > 30", "as {age > 30}"),
        ("age*age", "adds nothing"),
        ("-side", "a minus takes out a term that stands before it"),
        ("1|subject", "a group term stands in parentheses"),
        ("(age + (1|subject)) * side", "no part of a term with *"),
        ("((1|subject)|side)", "no part of a term with |"),
        ("log(age, mass_kg)", "log() is of one column"),
        ("age(side)(sex)", "behind what is no function"),
        ("{age:side}", ": is no arithmetic"),
        ("*".join(f"(a{i} + b{i} + c{i})" for i in range(12)), "256 at most"),
        (" + ".join(["age"] * 3000), "too long"),
        ("log.accumulate(age)", "there is no log.accumulate()"),
    ],
)
def test_what_would_be_passed_over_is_refused(formula, reason):
    assert reason in " ".join(fault.reason for fault in resolve(formula, ROWS, REFERENCE).faults)


@pytest.mark.slow
@settings(max_examples=60, deadline=None)
@example(["{", "(", "age", "-", "2", ")", "**", "2", "}"])
@example(["side", ":", "sex"])
@given(PIECES)
def test_no_piece_of_an_accepted_formula_is_lost(pieces):
    """Refused, or every name and number in it stands in the terms, which are read as the same again."""
    formula = " ".join(pieces)
    found = resolve(formula, ROWS, REFERENCE)
    if found.faults:
        return
    text = str(found.terms)
    again = resolve(text, ROWS, REFERENCE)
    assert again.terms == found.terms
    assert_allclose(again.columns, found.columns)
    assert not set(formula) & set("[]=!%~^\\,.") - set(text)
    if "-" not in pieces:
        for word in re.findall(r"\w+", formula):
            assert (
                word in text
                or word in ("0", "1")
                or (word == "2" and ")** 2" in formula.replace(" **", "**"))
            )


@st.composite
def arithmetic(draw, depth=3):
    """Arithmetic as Python has it too."""
    if depth == 0 or draw(st.booleans()):
        return draw(st.sampled_from(["age", "mass_kg", "2", "0.5", "3"]))
    left, right = draw(arithmetic(depth=depth - 1)), draw(arithmetic(depth=depth - 1))
    form = draw(
        st.sampled_from(["{}+{}", "{}-{}", "{}*{}", "{}/{}", "{}**{}", "-{}", "({}-{})", "({}/{})", "-({})"])
    )
    return form.format(left, right)


@pytest.mark.slow
@settings(max_examples=60, deadline=None)
@example("-age**2")
@example("2**3**2*age")
@example("(age-3)**2")
@example("age-(3-age)")
@given(arithmetic())
def test_arithmetic_has_the_values_that_it_has_in_python(text):
    numbers = {name: ROWS[name].to_numpy(float) for name in ("age", "mass_kg")}
    reference = {"age": np.float64(numbers["age"].mean()), "mass_kg": np.float64(REFERENCE)}
    floats = re.sub(r"(?<![\w.])(\d+)(?![\w.])", r"\1.0", text)
    with np.errstate(all="ignore"):
        try:
            expected = eval(floats, {}, numbers) - eval(floats, {}, reference)  # noqa: S307 - text of ours
        except (OverflowError, ZeroDivisionError):
            return
    if not np.isfinite(expected).all() or np.iscomplexobj(expected) or np.ptp(expected) == 0:
        return
    found = resolve(f"{{{text}}}", ROWS, REFERENCE)
    assume(not found.faults)
    assert_allclose(found.columns[:, 0], expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())
    assert resolve(str(found.terms), ROWS, REFERENCE).terms == found.terms


def test_quoted_columns_within_arithmetic_and_products_keep_their_quotes():
    rows = ROWS.rename(columns={"age": "age in years", "side": "left foot"})
    for formula in ("{2 * `age in years`}", "`left foot`:sex", "(`age in years`|trial)", "(1|`left foot`)"):
        found = resolve(formula, rows, REFERENCE)
        assert not found.faults
        assert resolve(str(found.terms), rows, REFERENCE).terms == found.terms


def test_a_product_alone_has_the_columns_of_full_rank():
    found = resolve("side:sex", ROWS, REFERENCE)
    cells = (ROWS["side"] + ROWS["sex"]).factorize()[0]
    whole = np.column_stack([np.ones(len(ROWS)), found.columns])
    assert not found.faults
    assert np.linalg.matrix_rank(whole) == 4
    assert np.linalg.matrix_rank(np.column_stack([whole, np.eye(4)[cells]])) == 4
