"""Which level is best, and up to which motion a claim holds, against the same by hand."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import rankdata

from bayestissue.base.errors import InputError
from bayestissue.commands.finished_runs import ask as help_of_ask
from bayestissue.inference.answers.evaluation import draws_of
from bayestissue.inference.answers.grammar import parse
from bayestissue.inference.answers.law import Law
from bayestissue.inference.answers.questions import ask, numbered
from bayestissue.inference.answers.study import Study
from bayestissue.mechanics.elements import outcomes
from bayestissue.model.hierarchy.levels import design_at
from cases import cases
from study_with_sides import study_with_sides

G = 9.80665


@pytest.fixture(scope="module")
def study() -> Study:
    return study_with_sides()


def parameters(study: Study, *sides: str) -> dict[str, np.ndarray]:
    """K and C of a typical person on each side: [draw, side]."""
    conditions = [{"side": side} for side in sides]
    logs = {q: design_at(study.recorded, q, conditions).log(study.draws) for q in ("K", "C")}
    return {q: np.exp(log).reshape(-1, len(sides)) for q, log in logs.items()}


def peak_force(study: Study, mass: float, velocity: float, *sides: str) -> np.ndarray:
    p = parameters(study, *sides)
    flat = {q: values.ravel() for q, values in p.items()}
    force = outcomes("kelvin_voigt", flat, np.full(flat["K"].shape, mass), np.full(flat["K"].shape, velocity))
    return np.asarray(force["peak_force"]).reshape(p["K"].shape)


def test_the_best_level_has_its_probability_rank_and_loss(study: Study) -> None:
    answers = ask(study, numbered(["best(side, lowest peak_force[mass_kg=2, velocity_m_s=1.2])"]))
    force = peak_force(study, 2, 1.2, *answers["level"])
    assert sorted(answers["level"]) == ["left", "right"]
    assert answers["posterior"].to_numpy() == pytest.approx((force == force.min(1)[:, None]).mean(0))
    assert answers["posterior"].sum() == pytest.approx(1)
    assert answers["expected_loss"].to_numpy() == pytest.approx(
        (force - force.min(1)[:, None]).mean(0), rel=1e-9
    )
    assert answers["median"].to_numpy() == pytest.approx(np.median(force, axis=0), rel=1e-9)
    ranks = rankdata(force, axis=1)
    assert answers["rank_high"].to_numpy() == pytest.approx(np.quantile(ranks, 0.95, axis=0))
    assert answers[["rank", "rank_low", "rank_high"]].dtypes.eq(float).all()
    assert (answers["unit"] == "N").all()
    assert not answers["note"].str.contains("averaged").any()


def test_levels_that_a_draw_has_equal_share_it(study: Study) -> None:
    answers = ask(study, numbered(["best(side, lowest max(1e9 * K[side=left], K))"]))
    assert answers["posterior"].tolist() == [0.5, 0.5]
    assert answers["expected_loss"].tolist() == [0.0, 0.0]


def test_the_velocity_up_to_which_a_claim_holds(study: Study) -> None:
    """Of a spring and damper the greatest force is in proportion to the velocity."""
    row = ask(study, numbered(["critical(velocity_m_s, peak_force[side=left, mass_kg=2] < 105)"])).iloc[0]
    velocity = 105 / peak_force(study, 2, 1.0, "left")
    expected = np.quantile(velocity, [0.05, 0.5, 0.95])
    assert [row["low"], row["median"], row["high"]] == pytest.approx(expected, rel=1e-8)
    assert row["unit"] == "m/s"
    share = (velocity > 1.5).mean()
    beyond = f"in {100 * share:.3g} % of the draws beyond those measured, up to 1.5 m/s"
    assert (beyond in row["note"]) == bool(share)


@pytest.mark.slow
def test_the_height_up_to_which_a_claim_holds_at_that_height(study: Study) -> None:
    falling = replace(study, law=Law(gravity=G))
    row = ask(falling, numbered(["critical(drop_height_cm, peak_force[side=left, mass_kg=2] < 100)"])).iloc[0]
    assert row["unit"] == "cm"
    at = f"peak_force[side=left, mass_kg=2, drop_height_cm={row['median']:.12g}]"
    assert ask(falling, numbered([at])).iloc[0]["median"] == pytest.approx(100, rel=1e-6)


def test_a_motion_is_solved_for_in_every_draw_with_few_simulations(study: Study, monkeypatch) -> None:
    simulated = []

    def counted(self, parameters, *others):
        simulated.append(parameters["K"].shape)
        return solved(self, parameters, *others)

    solved = Law.outcomes
    monkeypatch.setattr(Law, "outcomes", counted)
    falling, names = replace(study, law=Law(gravity=G), prior=None), "side=left, mass_kg=2"
    # Draws far from the others, in which the claim ends elsewhere.
    far = falling.draws.copy()
    far["intercept_K"] = far["intercept_K"].copy()
    far["intercept_K"][0, 5], far["intercept_K"][1, 7] = 14.0, 2.0
    one = replace(falling, draws=far)
    V = draws_of(parse(f"critical(velocity_m_s, peak_force[{names}] < 100)"), one).to_numpy()
    assert len(simulated) < 16
    force = draws_of(parse(f"peak_force[{names}]"), replace(one, velocity_m_s=V)).to_numpy()
    np.testing.assert_allclose(force, 100, rtol=1e-5)


def test_what_always_or_never_holds(study: Study) -> None:
    """The restitution of spring and damper is the same at every velocity."""
    p = parameters(study, "left")
    middle = float(
        np.median(outcomes("kelvin_voigt", {q: v[:, 0] for q, v in p.items()}, 2.0, 1.0)["restitution"])
    )
    text = f"critical(velocity_m_s, restitution[side=left, mass_kg=2] > {middle:.12g})"
    row = ask(study, numbered([text])).iloc[0]
    assert (row["low"], row["high"]) == (0, np.inf)
    assert row["note"].startswith("never up to 30 m/s in 50 % of the draws")


def test_the_examples_of_the_commands_help_have_answers() -> None:
    examples = re.findall(r"^ *- `(.+?)`", help_of_ask.__doc__ or "", re.MULTILINE)
    answers = ask(study_with_sides("log(mass_kg) + side + (1|subject/side)"), numbered(examples))
    assert len(examples) == 5
    assert answers["question"].drop_duplicates().tolist() == examples


@pytest.mark.parametrize(("question", "expected"), cases(__file__, "refused"))
def test_what_has_no_answer_is_refused(study: Study, question: str, expected: str) -> None:
    with pytest.raises(InputError) as refused:
        ask(study, numbered([question]))
    (problem, *_) = refused.value.problems
    assert expected in f"{problem.value} {problem.expected}"


def test_a_claim_that_comes_true_again_has_no_critical_motion(study: Study) -> None:
    """The force grows with the velocity, so that it lies between two limits at two of them."""
    middle = "abs(log(peak_force[side=left]) - 4) < 1"
    with pytest.raises(InputError, match="holds up to one velocity_m_s and no longer above it"):
        ask(study, numbered([f"critical(velocity_m_s, {middle})"]))
