from __future__ import annotations

import pandas as pd
import pytest

from bayestissue.thesis.pages.causes_answers import (
    CausesRun,
    answer,
    cannot_tell,
    confused_pairs,
    failing,
    p_words,
    ruled_out,
)

MECHANISMS = {"own_time": "own time", "anticipation": "active", "none": "none"}


def run(
    p: tuple[float, float, float], probability: tuple[float, float, float], *, level: bool = True
) -> CausesRun:
    words = ["refuted" if each < 0.01 else "doubtful" if each < 0.1 else "possible" for each in p]
    fails = ["mass_exponent_K, zeta_median" if word == "refuted" else "" for word in words]
    causes = pd.DataFrame(
        {
            "cause": list(MECHANISMS), "title": ["own length", "tense muscles", "fixed tissue"], "p_joint": p,
            "smallest_p": 0.002, "probability": probability, "probability_error": 0.01, "fails": fails,
            "verdict": words,
        }
    )  # fmt: skip
    statistics = ["mass_exponent_K", "mass_exponent_C", "zeta_median", "K_over_M_mean"]
    compared = ["yes", "yes", "yes", "yes" if level else "no"]
    return CausesRun(
        record={
            "model": {
                "causes": {
                    name: {"mechanism": mechanism, "after_the_fact": name == "own_time"}
                    for name, mechanism in MECHANISMS.items()
                }
            },
            "subject": {"title": "the estimates"},
        },
        causes=causes,
        predictive=pd.DataFrame(),
        observed=pd.DataFrame(
            {"statistic": statistics, "value": [0.96, 1.19, 0.23, 24.0], "compared": compared}
        ),
        confusion=pd.DataFrame(
            {"truth": list(MECHANISMS), "own_time": [0.7, 0.3, 0], "anticipation": [0.3, 0.6, 0.1],
             "none": [0, 0.1, 0.9]}
        ),
        reliability=pd.DataFrame(),
    )  # fmt: skip


def test_a_cause_in_the_method_that_fits() -> None:
    told = " ".join(answer(run((0.4, 0.002, 0.002), (0.97, 0.03, 0.0))))
    assert told.startswith("In the estimates K goes with the mass to the power 0.96 and C to the power 1.19.")
    assert "very probably lies in how K was found and not in the tissue (posterior probability 0.97)" in told
    assert "The likeliest is “own length” (0.97 ± 0.01)" in told
    assert (
        "Acting alone “own length” (p = 0.40) can have made all 4 numbers compared; every other misses"
        in told
    )
    assert (
        "No change of the tissue does it, not even the best of them, “tense muscles” (p below 0.004)" in told
    )
    assert "it misses the mass exponent of K and median ζ" in told


def test_a_cause_in_the_tissue_that_fits() -> None:
    told = " ".join(answer(run((0.002, 0.4, 0.002), (0.04, 0.96, 0.0))))
    assert "lies in the tissue and not in how K was found (posterior probability 0.96)" in told
    assert "No change of the tissue" not in told


def test_fixed_tissue_needs_no_cause() -> None:
    told = " ".join(answer(run((0.002, 0.002, 0.6), (0.0, 0.04, 0.96))))
    assert "That needs no cause: “fixed tissue” makes such numbers (p = 0.60, posterior probability" in told
    assert "No change of the tissue" not in told


def test_causes_that_fit_badly_or_not_at_all() -> None:
    told = " ".join(answer(run((0.02, 0.002, 0.002), (0.97, 0.03, 0.0))))
    assert "Acting alone even “own length” (p = 0.020) would rarely make all 4 numbers" in told
    told = " ".join(answer(run((0.002, 0.002, 0.002), (0.97, 0.03, 0.0))))
    assert "But none of them, acting alone, makes all 4 numbers compared" in told
    assert any("edge" in words for words in cannot_tell(run((0.02, 0.002, 0.002), (1.0, 0.0, 0.0))))


def test_what_is_left_open() -> None:
    assert confused_pairs(run((0.4, 0.002, 0.002), (0.9, 0.1, 0.0))) == [("own length", "tense muscles")]
    told = cannot_tell(run((0.4, 0.002, 0.002), (0.9, 0.1, 0.0), level=False))
    # g / 24 s^-2 is 41 cm.
    assert any("a pendulum of 41 cm" in words for words in told)
    assert len(ruled_out(run((0.4, 0.002, 0.002), (0.9, 0.1, 0.0)))) == 2


def test_a_cause_made_for_the_numbers_says_so() -> None:
    told = cannot_tell(run((0.4, 0.002, 0.002), (0.9, 0.08, 0.02)))
    assert "with these numbers in view" in told[0]
    assert "Without it the likeliest is “tense muscles” (p below 0.004), with 0.80 of what is left" in told[0]
    assert "in view" not in cannot_tell(run((0.002, 0.4, 0.002), (0.1, 0.8, 0.1)))[0]


@pytest.mark.parametrize(
    ("p", "words"), [(0.002, "below 0.004"), (0.018, "0.018"), (0.4, "0.40"), (0.004, "0.004")]
)
def test_p_values_in_words(p: float, words: str) -> None:
    assert p_words({"p_joint": p, "smallest_p": 0.002}) == words


def test_statistics_that_are_missed_in_words() -> None:
    row = {"fails": "zeta_median, sd_rest_C, mass_exponent_K, mass_exponent_C"}
    assert failing(row, 2) == "median ζ, scatter of C within conditions and 2 more"
    assert failing({"fails": ""}) == ""
