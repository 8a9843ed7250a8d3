"""Questions whose answer the formula fixes are refused before any work, with the term that is missing."""

from __future__ import annotations

from itertools import product

import pandas as pd
import pytest
import xarray as xr

from bayestissue.base.errors import InputError
from bayestissue.inference.answers.fixed import confounded
from bayestissue.inference.answers.grammar import parse
from bayestissue.inference.answers.questions import numbered, require_readable
from bayestissue.inference.answers.study import Study
from bayestissue.model.hierarchy.recorded import Recorded
from cases import cases

ROWS = pd.DataFrame(
    [
        (f"{group[0]}{person}", side, session, group, mass, 20.0 + 3 * person)
        for group, person, side, session, mass in product(
            ("treated", "control"), range(3), ("left", "right"), ("before", "after"), (0.5, 1.0)
        )
    ],
    columns=["subject", "side", "session", "group", "mass_kg", "age"],
).assign(trial=lambda t: t["mass_kg"].astype(str), velocity_m_s=1.5)
MAIN = "log(mass_kg) + group + side + session + (1|subject)"
RATIO = "K[group=treated, {0}] / K[group=treated, {1}] / (K[group=control, {0}] / K[group=control, {1}])"
SIDES, SESSIONS = ("side=left", "side=right"), ("session=after", "session=before")


def refusal(question: str, formula: str, C: str = "1") -> str:
    recorded = Recorded(ROWS, {"K": formula, "C": C}, 0.7)
    try:
        require_readable(numbered([question]), Study(xr.Dataset(), recorded))
    except InputError as error:
        return str(error)
    return ""


@pytest.mark.slow
@pytest.mark.parametrize(("question", "formula", "term"), cases(__file__, "fixed"))
def test_it_names_the_term_that_would_move_it_and_is_open_with_it(question, formula, term):
    question = question.format(sides=RATIO.format(*SIDES), sessions=RATIO.format(*SESSIONS))
    formula = formula.replace("MAIN", MAIN)
    said = refusal(question, formula)
    assert 'found "1, whatever K and C are"' in said or "log(" in question
    assert f"it has no {term}" in said
    assert not refusal(question, f"{formula} + {term}")


def test_what_is_itself_needs_no_term():
    said = refusal("K[side=left] / K[side=left] > 1", MAIN)
    assert 'found "1, whatever K and C are"' in said
    assert "it has no" not in said


@pytest.mark.parametrize("question", [question for (question,) in cases(__file__, "open")])
def test_what_a_parameter_moves_is_asked(question):
    assert not refusal(question, MAIN, MAIN)


@pytest.mark.slow
@pytest.mark.parametrize(("question", "formula", "terms"), cases(__file__, "confounded"))
def test_terms_that_no_number_of_people_tells_from_a_question_are_found(question, formula, terms):
    recorded = Recorded(ROWS, {"K": formula, "C": "1"}, 0.7)
    assert list(map(str, confounded(parse(question), recorded))) == terms
