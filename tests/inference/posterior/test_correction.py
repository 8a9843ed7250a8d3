"""When a correction is trusted, what is tried where it is not, and how a fit tells its route."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import pytest
import xarray as xr

from bayestissue.errors import InputError
from bayestissue.hierarchy.specification import ModelSpecification, Sampler
from bayestissue.inference import fit as fitting
from bayestissue.inference.factors.conditional import PopulationDraws
from bayestissue.inference.fit import fit_traces
from bayestissue.inference.posterior import recipe
from bayestissue.inference.posterior.correction import NEEDED, Correction, Route, duration, needed_size
from bayestissue.inference.posterior.recipe import Attempt, corrected_draws
from bayestissue.inference.samplers.diagnostics import diagnose
from bayestissue.inference.samplers.psis import relative_variance
from bayestissue.inference.samplers.sampling import Draws

SETTINGS = Sampler(chains=4, warmup=200, draws=1000)


def correction(share: float, k: float = 0.1, chains: int = 4, transitions: int = 1000) -> Correction:
    """Of so many draws that a share of each chain has all the weight."""
    weight = np.zeros((chains, transitions))
    weight[:, : round(share * transitions)] = 1.0
    return Correction(weight, k, needed_size(4000))


def test_the_effective_number_is_that_of_the_worst_chains() -> None:
    even = correction(0.5)
    assert even.effective == pytest.approx(2000)
    assert even.relative == pytest.approx(0.5)
    weight = even.weight.copy()
    weight[0] = 0.0
    weight[0, :10] = 1.0
    # A quarter of the draws kept then stands on ten: the variance of a mean of four chains' means.
    one_bad = replace(even, weight=weight)
    assert one_bad.effective == pytest.approx(16 / (1 / 10 + 3 / 500))
    weight[0] = 0.0
    assert replace(even, weight=weight).effective == 0


def test_too_few_effective_draws_are_refused_whatever_pareto_k_says() -> None:
    """The stiffening tissue that had 2 % left at a Pareto k of 0.41."""
    spent = correction(0.02, k=0.41)
    assert not spent.trusted
    assert [check.passed for check in spent.checks()] == [True, False]
    assert spent.lacks_only_draws
    assert correction(0.5, k=0.41).trusted
    heavy = correction(0.5, k=0.72)
    assert not heavy.trusted
    assert not heavy.lacks_only_draws
    assert not np.isfinite(Correction.from_log_weights(np.full((2, 50), -np.inf), 100).pareto_k)
    assert Correction.from_log_weights(np.full((2, 50), -np.inf), 100).row()["pareto_k"] is None


def test_needed_draws_keep_the_greatest_of_dozens_of_r_hats_below_its_limit() -> None:
    from arviz_stats.base import array_stats

    rng = np.random.default_rng(0)
    # Independent draws, as many as are needed, of 60 quantities.
    drawn = rng.standard_normal((60, 4, NEEDED // 4))
    worst = max(float(array_stats.rhat(each)) for each in drawn)
    assert worst < 1.01
    few = max(float(array_stats.rhat(each[:, : NEEDED // 16])) for each in drawn)
    assert few > 1.01
    assert needed_size(10**6) == NEEDED
    assert needed_size(300) == 100


class _Tried:
    """`corrected_draws` with sites that are mere names, whose corrections are given."""

    def __init__(
        self,
        monkeypatch: pytest.MonkeyPatch,
        found: dict[str, Correction],
        grid: Any = None,
        **model: bool,
    ) -> None:
        self.prepared: Any = SimpleNamespace(
            model=SimpleNamespace(
                **{"discrepancy": False, "weakly_identified": False, "may_have_grid": False} | model
            ),
            impacts=range(3),
        )
        self.first, self.sampled, self.settings = self._approximation("first", grid), [], []
        self._found, self.placed = found, []
        monkeypatch.setattr(recipe, "population_attempt", self._draws)
        monkeypatch.setattr(recipe, "refitted", self._about)
        monkeypatch.setattr(recipe, "fitted_to_population", self._placed)
        monkeypatch.setattr(recipe, "with_second_order", lambda prepared, approximation, *_: approximation)
        monkeypatch.setattr(recipe, "approximate", lambda *_, **__: self._approximation("normal"))
        monkeypatch.setattr(recipe, "with_impacts", lambda problem, found: found.approximation.name)

    def _approximation(self, name: str, grid: Any = None) -> Any:
        return SimpleNamespace(name=name, grid=grid, coordinates=None, expansions=None)

    def _draws(self, problem: Any, approximation: Any) -> Any:
        self.sampled.append(approximation.name)
        self.settings.append(problem.settings)
        name = approximation.name if problem.settings.thinning == 1 else f"{approximation.name}, longer"
        none = np.zeros((4000, 2))
        draws = PopulationDraws({"sd": none[:, 0]}, {}, none, none[:, :, None])
        return Attempt(approximation, None, draws, none, self._found[name])  # type: ignore[arg-type]

    def _about(self, prepared: Any, approximation: Any, draws: Any, seed: int) -> Any:
        assert len(draws.b) == 512
        number = int(approximation.name.removeprefix("again ")) + 1 if "again" in approximation.name else 1
        return self._approximation(f"again {number}")

    def _placed(self, problem: Any, approximation: Any) -> Any:
        self.placed.append(approximation.name)
        return approximation

    def run(self) -> tuple[Any, Any, Correction]:
        return corrected_draws(self.prepared, SETTINGS, 0, approximation=self.first)


def test_sites_are_fitted_about_the_corrected_draws_until_the_correction_holds(monkeypatch) -> None:
    tried = _Tried(
        monkeypatch, {"first": correction(0.02), "again 1": correction(0.2), "again 2": correction(0.8)}
    )
    approximation, draws, found = tried.run()
    assert tried.sampled == ["first", "again 1", "again 2"]
    assert approximation.name == draws == "again 2"
    assert found.trusted
    assert [row["effective_draws"] for row in found.attempts] == [80, 800, 3200]
    taken = [row["step"] for row in found.steps if not row["refused"]]
    assert taken == ["fit_and_sample", "refit_about_draws", "refit_about_draws"]
    assert found.steps[-1] == {"step": "lengthen_chains", "refused": "the correction can be trusted"}
    assert sum(row["step"] == "normal_instead_of_grid" for row in found.steps) == 1
    assert not Route("automatic", found).exact


def test_a_correction_that_holds_at_once_is_the_only_one(monkeypatch) -> None:
    tried = _Tried(monkeypatch, {"first": correction(0.6)}, weakly_identified=True, may_have_grid=True)
    _, _, found = tried.run()
    assert tried.sampled == tried.placed == ["first"]
    assert len(found.attempts) == 1


def test_where_no_site_helps_the_best_is_returned_and_the_exact_path_follows(monkeypatch) -> None:
    given = {"first": correction(0.02), "again 1": correction(0.025), "normal": correction(0.4, k=1.1)}
    tried = _Tried(monkeypatch, given, object(), weakly_identified=True, may_have_grid=True)
    approximation, _, found = tried.run()
    # No longer chains either: 54 times as many draws cost more than the exact path.
    assert tried.sampled == ["first", "normal", "again 1"]
    assert approximation.name == "normal"
    assert not found.trusted
    route = Route("automatic", found)
    assert route.exact
    assert "the best of 3 attempts has 1600 effective draws of 4000" in route.words
    assert "Pareto k of the correction" in route.words
    assert route.record()["path"] == "exact"
    assert route.checks() == ()


def test_no_grid_takes_the_place_of_a_normal_that_the_traces_suggested(monkeypatch) -> None:
    """It would have its places further apart than what the traces tell is wide, and pass for right."""
    given = {"first": correction(0.02, k=20.0), "again 1": correction(0.02, k=14.0)}
    tried = _Tried(monkeypatch, given, weakly_identified=True, may_have_grid=True)
    _, _, found = tried.run()
    assert tried.sampled == ["first", "again 1"]
    assert Route("automatic", found).exact


def test_where_only_draws_are_lacking_chains_are_longer(monkeypatch) -> None:
    given = {
        "first": correction(0.15),
        "again 1": correction(0.16),
        "again 1, longer": correction(0.16, transitions=3000),
    }
    tried = _Tried(monkeypatch, given)
    _, _, found = tried.run()
    # 1333 effective draws are needed, 640 are there: a fifth more than 2.1 times as many transitions.
    assert [settings.transitions for settings in tried.settings] == [1000, 1000, 3000]
    assert found.trusted
    assert len(found.attempts) == 3


def test_chains_are_no_longer_where_some_draws_judge_all(monkeypatch) -> None:
    """However long they are, as many draws get a weight, and as few of these are effective."""
    given = {"first": correction(0.15), "again 1": correction(0.16)}
    tried = _Tried(monkeypatch, given)
    tried.prepared.impacts = range(10_000)
    tried.run()
    assert tried.sampled == ["first", "again 1"]


class _Left(NamedTuple):
    """A fit whose corrections are made up, and what it said."""

    route: Any
    said: list[tuple[str, int, int]]


def left(
    monkeypatch, k: float, *, seconds: float = 3.0, contradicted: str = "", spoilt: bool = False
) -> _Left:
    """Weights of this Pareto k, 80 draws of them effective; so long for a hundred transitions of 4800.

    Where an impact is ``spoilt`` the third of twelve makes most of what the weights vary.
    """
    of_impacts = 0.1 * np.random.default_rng(1).standard_normal((400, 12))
    of_impacts[:, 2] *= 10.0 if spoilt else 1.0
    row = correction(0.02).row()
    spent = replace(correction(0.02, k=k), attempts=(row,), of_impacts=of_impacts)
    clock = iter([100.0, 100.0 + seconds])
    monkeypatch.setattr(fitting.time, "monotonic", lambda: next(clock))
    for name in ("expanded", "approximate"):
        monkeypatch.setattr(fitting, name, lambda *_, **__: SimpleNamespace(sites=None, grid=None))
    summary = SimpleNamespace(sites=None, grid=None), None, spent
    monkeypatch.setattr(fitting, "corrected_draws", lambda *_, **__: summary)

    def exact_draws(*_: Any, progress: Any, **__: Any) -> Draws:
        for done in (0, 100, 4800):
            progress(done, 4800)
        return Draws({}, {}, 10)

    monkeypatch.setattr(fitting, "exact_draws", exact_draws)
    monkeypatch.setattr(fitting, "label_standard", lambda *given: given[-1])
    said: list[tuple[str, int, int]] = []
    names = pd.DataFrame({"impact": [f"drop {number}" for number in range(12)]})
    route = fit_traces(
        SimpleNamespace(model=SimpleNamespace(discrepancy=True), impacts=names),  # type: ignore[arg-type]
        ModelSpecification(name="m", likelihood="impact", sampler=SETTINGS),
        0,
        lambda *told: said.append(told),
        contradicted=lambda: contradicted,
    )
    return _Left(route, said)


def test_a_fit_that_leaves_the_short_way_tells_why_and_how_long_it_takes(monkeypatch) -> None:
    found = left(monkeypatch, k=0.9)
    assert found.route.exact
    why = next(stage for stage, *_ in found.said if stage.startswith("sampling by the exact path, since"))
    assert "80 effective draws of 4000 (relative effective sample size 2.0%), Pareto k 0.90" in why
    # Three seconds for the first hundred of 4800 transitions.
    assert ("exact path, 0.03 s a transition, about 2 min in all", 4800, 4800) in found.said
    assert ("first transitions of the exact path", 0, 4800) in found.said


def test_a_long_exact_path_is_not_begun_unasked(monkeypatch) -> None:
    with pytest.raises(InputError, match="about 24 min") as slow:
        left(monkeypatch, k=0.9, seconds=30.0)
    assert "--path exact" in str(slow.value)
    with pytest.raises(InputError, match=r"The velocity is off\. To go on all the same"):
        left(monkeypatch, k=0.9, contradicted="The velocity is off.")


def test_the_impact_that_spoils_the_weights_is_named_and_no_longer_warm_up_is_asked_for(monkeypatch) -> None:
    named = "of one impact, drop 2: look at its recording"
    with pytest.raises(InputError, match=named):
        left(monkeypatch, k=0.9, seconds=30.0, spoilt=True)
    with pytest.raises(InputError) as unnamed:
        left(monkeypatch, k=0.9, seconds=30.0)
    assert "one impact" not in str(unnamed.value)
    # Of a fit that is finished by the short way, with too few draws.
    checks = left(monkeypatch, k=0.41, spoilt=True).route.checks()
    assert [named in check.next_step for check in checks] == [False, True]
    steps = {check["name"]: check["next_step"] for check in few_draws(checks)["checks"]}
    assert "more warm-up brings no more" in steps["R-hat"]
    assert "Raise sampler.warmup" in {c["name"]: c["next_step"] for c in few_draws(())["checks"]}["R-hat"]


def few_draws(further: tuple[Any, ...]) -> dict[str, Any]:
    """The diagnostics of draws that agree badly."""
    summary = pd.DataFrame({"variable": ["K"], "r_hat": [1.1], "ess_bulk": [30.0], "ess_tail": [20.0]})
    dims, energy = ("chain", "draw"), np.random.default_rng(1).standard_normal((2, 100))
    columns = {"energy": energy, "diverging": energy > 9, "tree_depth": np.full((2, 100), 3)}
    statistics = xr.Dataset({k: (dims, v) for k, v in columns.items()}, attrs={"max_tree_depth": 10})
    return diagnose(summary, statistics, further)


def test_good_weights_are_used_however_few_draws_are_effective(monkeypatch) -> None:
    found = left(monkeypatch, k=0.41, contradicted="Not asked.")
    assert not found.route.exact
    assert "weights are good, though few draws are effective: 80 effective" in found.route.words
    # The diagnostics say so.
    assert [check.passed for check in found.route.checks()] == [True, False]


def test_a_route_in_words() -> None:
    good = replace(correction(0.5), attempts=(correction(0.02).row(), correction(0.5).row()))
    words = Route("automatic", good).words
    assert words.startswith("Sampled with a normal approximation")
    assert "(2 attempts), since the correction can be trusted: 2000 effective draws of 4000" in words
    assert Route("exact").words.endswith("every trace in every step, as the model file asks.")
    asked = Route("summary", correction(0.02))
    assert not asked.exact
    assert "though the correction can't be trusted (effective number of draws" in asked.words
    assert len(asked.checks()) == 2
    assert [duration(each) for each in (59.6, 119, 600, 9000)] == ["60 s", "119 s", "10 min", "2 h"]


@pytest.mark.parametrize(("scatter", "trusted"), [(0.3, True), (4.0, False)])
def test_a_correction_is_refused_where_most_points_have_no_weight(scatter: float, trusted: bool) -> None:
    log_ratio = scatter * np.random.default_rng(6).normal(size=(64, 400))
    found = replace(correction(0.9), varies=relative_variance(log_ratio))
    assert found.trusted is trusted
    assert [check.passed for check in found.checks()] == [True, True, trusted]
    if trusted:
        # Of log-normal weights exp(-s^2) of the points are left, in one impact by 64 points to about 0.01.
        assert abs(found.relative_of_points - np.exp(-(scatter**2))) < 5 * 0.01
