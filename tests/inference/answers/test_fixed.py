"""Questions whose answer the formula fixes are refused before any work, with the term that is missing."""

from __future__ import annotations

from itertools import product

import pandas as pd
import pytest

from bayestissue.base.errors import InputError
from bayestissue.inference.answers.fixed import confounded
from bayestissue.inference.answers.grammar import parse
from bayestissue.inference.answers.questions import numbered, require_readable
from bayestissue.model.hierarchy.recorded import Recorded

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
        require_readable(numbered([question]), recorded)
    except InputError as error:
        return str(error)
    return ""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("question", "formula", "term"),
    [
        (RATIO.format(*SIDES) + " > 1.1", MAIN, "group:side"),
        (RATIO.format(*SIDES), MAIN, "group:side"),
        (RATIO.format(*SESSIONS) + " > 1", MAIN + " + group:side", "group:session"),
        ("K > 100 and " + RATIO.format(*SESSIONS) + " between 0.9 and 1.1", MAIN, "group:session"),
        (
            "log(K[group=treated, side=left]) - log(K[group=control, side=left]) > "
            "log(K[group=treated, side=right]) - log(K[group=control, side=right]) + 0.1",
            MAIN,
            "group:side",
        ),
        (
            "K[subject=t1, side=left] / K[subject=t1, side=right] > "
            "K[subject=t2, side=left] / K[subject=t2, side=right]",
            MAIN,
            "(1|subject:side)",
        ),
        (RATIO.format(*SESSIONS) + " > 1", MAIN + " + (1|subject:session)", "group:session"),
        (
            "K[group=treated, mass_kg=1] / K[group=treated, mass_kg=0.5] > "
            "K[group=control, mass_kg=1] / K[group=control, mass_kg=0.5]",
            MAIN,
            "group:log(mass_kg)",
        ),
    ],
)
def test_it_names_the_term_that_would_move_it_and_is_open_with_it(question, formula, term):
    said = refusal(question, formula)
    assert 'found "1, whatever K and C are"' in said or "log(" in question
    assert f"it has no {term}" in said
    assert not refusal(question, f"{formula} + {term}")


def test_what_is_itself_needs_no_term():
    said = refusal("K[side=left] / K[side=left] > 1", MAIN)
    assert 'found "1, whatever K and C are"' in said
    assert "it has no" not in said


@pytest.mark.parametrize(
    "question",
    [
        "K[side=left] / K[side=right] > 1.1",
        "K > 0",
        "K - 2000 > 0",
        "K[mass_kg=1] / K[mass_kg=0.5] > 1",
        "max(K[side=left] / K[side=right], 2) < 3",
        "mean(K[subject, group=treated]) / mean(K[subject, group=control])",
        "C[side=left] * K[side=right] > C[side=right] * K[side=left]",
        "K[subject=new] > K",
        "mass_exponent_K > 0.5",
        "log(K - 1000) > 2",
        "1 < 2",
    ],
)
def test_what_a_parameter_moves_is_asked(question):
    assert not refusal(question, MAIN, MAIN)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("question", "formula", "terms"),
    [
        ("mass_exponent_K < 0.5", "log(mass_kg) + (1|subject) + (1|trial)", ["(1|trial)"]),
        ("K[mass_kg=1] > 1.2 * K[mass_kg=0.5]", "log(mass_kg) + (1|subject) + (1|trial)", ["(1|trial)"]),
        ("mass_exponent_K < 0.5", "log(mass_kg) + (log(mass_kg)|subject)", []),
        ("K[side=left] > K[side=right]", "side + (1|subject) + (1|trial)", []),
        ("K > 2000", "side + (1|subject) + (1|trial)", ["(1|trial)"]),
        ("K[session=after] > K[session=before]", "session + (1|session:side)", []),
        ("sd_subject_K > 0.1", "log(mass_kg) + (1|subject) + (1|trial)", []),
    ],
)
def test_terms_that_no_number_of_people_tells_from_a_question_are_found(question, formula, terms):
    recorded = Recorded(ROWS, {"K": formula, "C": "1"}, 0.7)
    assert list(map(str, confounded(parse(question), recorded))) == terms
