"""What each source makes of an interval, against brute force and closed forms."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose

from bayestissue.base import resources
from bayestissue.inference.factors.expansions import first_guess
from bayestissue.inference.factors.sites import laplace_sites, weak_prior
from bayestissue.inference.quantities.quantity_draws import Draws
from bayestissue.inference.results import uncertainty_budget as sources
from bayestissue.inference.results.uncertainty_budget import trace_errors, uncertainty_budget
from bayestissue.model.hierarchy.specification import read_specification
from bayestissue.model.hierarchy.trace_data import Prepared, prepare
from bayestissue.model.hierarchy.trace_models import (
    TraceData,
    TraceModel,
    impact_likelihood,
    log_likelihood,
    with_contact_at,
    with_normal_errors,
)
from bayestissue.model.likelihood.record import CONTACT
from bayestissue.recordings.dataset import read_dataset
from campaigns import RECORDER, simulated

pytestmark = pytest.mark.slow

PEOPLE, CONDITIONS = 4, 3
RIDGE = 1e-9 * np.eye(3)
COLUMN = {"velocity and gain": 0, "offset": 1, "contact moment": 2}
SPREADS = {"sd_subject": 0.3, "sd_trial": 0.1, "sd_impact": 0.05}


def planned(masses: np.ndarray, **model: Any) -> Prepared:
    """Every person hit once in each condition."""
    people = {"sd_subject_K": 0.2}
    made = simulated(people, RECORDER, people=PEOPLE, masses=masses.tolist(), velocity=1.2, seed=3)
    found = read_specification(resources.shared("models", "impact.toml"))
    both = "(1|subject) + (1|trial)"
    formula = found.formula.model_copy(update={"K": both, "C": both})
    found = found.model_copy(update={"formula": formula, "gain_error": "impact", **model})
    return prepare(made.dataset("x"), found, source="the model file")


@pytest.fixture(scope="module")
def given() -> Prepared:
    """Twelve impacts of equal mass, each with an error of its own, so that the design is balanced."""
    return planned(np.full(CONDITIONS, 0.7), mass_error="impact")


@pytest.fixture(scope="module")
def u(given: Prepared) -> np.ndarray:
    """The maximum of every likelihood."""
    start = np.tile([np.log(3000.0), np.log(25.0), np.log(0.005)], (PEOPLE * CONDITIONS, 1))
    data = with_normal_errors(given.data)
    return np.asarray(laplace_sites(given.model, data, jnp.asarray(start), weak_prior(start), 30).centre)


def with_errors(given: Prepared, change: Callable[[np.ndarray], np.ndarray]) -> Prepared:
    record: Any = given.data.record
    changed = record._replace(error_sd=jnp.asarray(change(np.array(record.error_sd))))
    return replace(given, data=replace(given.data, record=changed))


def scaled(given: Prepared, column: int, factor: float) -> Prepared:
    return with_errors(given, lambda sd: sd * np.where(np.arange(3) == column, factor, 1.0))


@partial(jax.jit, static_argnames="model")
def on_grid(model: TraceModel, data: TraceData, points: jax.Array) -> jax.Array:
    return jax.lax.map(lambda u: log_likelihood(model, data, [u[:, a] for a in range(3)]), points)


def by_quadrature(given: Prepared, u: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Variance of log K of every impact under its likelihood, over six standard deviations of K and C."""
    data = with_normal_errors(given.data)
    expected = impact_likelihood(given.model, data, list(jnp.asarray(u).T)).response().d
    data = replace(data, record=data.record.with_traces(expected))
    steps = np.linspace(-6, 6, 61)
    pairs = np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1).reshape(-1, 2)
    factor = np.linalg.cholesky(covariance[:, :2, :2])
    away = np.einsum("iab,pb->pia", factor, pairs)
    points = u + np.concatenate([away, np.zeros((*away.shape[:2], 1))], axis=-1)
    logs = np.asarray(on_grid(given.model, data, jnp.asarray(points)))
    weight = np.exp(logs - logs.max(axis=0))
    weight /= weight.sum(axis=0)
    K = points[..., 0]
    return (weight * (K - (weight * K).sum(axis=0)) ** 2).sum(axis=0)


def test_parts_are_those_of_brute_force(given: Prepared, u: np.ndarray) -> None:
    errors = trace_errors(given, u, RIDGE)
    N = sum(errors.values())
    # Likelihoods are normal but for terms of the order of their width, a hundredth, which move a variance by
    # a few hundredths at most.
    whole = by_quadrature(given, u, N)
    assert_allclose(N[:, 0, 0], whole, rtol=0.05)
    for name, column in COLUMN.items():
        # The derivative by the log of the error's variance, over the same step twice as large.
        ends = [by_quadrature(scaled(given, column, np.exp(s * 0.1)), u, N) for s in (1, -1)]
        assert_allclose(errors[name][:, 0, 0] / whole, (ends[0] - ends[1]) / 0.4 / whole, atol=0.02)


def drawn(given: Prepared, u: np.ndarray) -> Draws:
    """A posterior that knows the spreads."""
    rng = np.random.default_rng(1)
    shape = (2, 50)
    population = {name: np.full(shape, 0.3) for name in given.model.hyperparameters}
    for q in "KC":
        population |= {f"{stem}_{q}": np.full(shape, sd) for stem, sd in SPREADS.items()}
        population[f"intercept_{q}"] = rng.standard_normal(shape)
        for term in given.design.responses[q].terms:
            population[term.effect(q)] = np.zeros((*shape, len(given.design.groupings[term.grouping].levels)))
    population["residual_correlation"] = np.zeros(shape)
    impacts = {q: np.exp(u[:, i] + 0.01 * rng.standard_normal((*shape, len(u)))) for i, q in enumerate("KC")}
    return Draws(population, impacts | {"parameters": np.broadcast_to(u, (*shape, *u.shape))}, {})


@pytest.fixture(scope="module")
def table(given: Prepared, u: np.ndarray) -> pd.DataFrame:
    return uncertainty_budget(given, drawn(given, u)).set_index(["level", "quantity", "source"]).sort_index()


def test_shares_add_up(table: pd.DataFrame) -> None:
    told = table.drop(index=["all", "as drawn"], level="source")
    assert_allclose(told.groupby(level=["level", "quantity"])["share"].sum(), 1.0, rtol=1e-9)
    assert (told["share"] > -1e-6).all()


def test_the_mean_of_a_balanced_design_by_hand(table: pd.DataFrame) -> None:
    own = table.loc[("typical person", "K")]["sd"]
    numbers = {"people": PEOPLE, "conditions": CONDITIONS, "impacts": PEOPLE * CONDITIONS}
    for (source, number), sd in zip(numbers.items(), SPREADS.values(), strict=True):
        # A prior of sd 3 takes off 0.3 % of a variance of 0.026; the traces' errors weigh 4 % of the scatter.
        assert_allclose(own[source] ** 2, sd**2 / number, rtol=0.01 if source != "impacts" else 0.1)
    assert_allclose(own["mass"] ** 2, 0.002**2 / (PEOPLE * CONDITIONS), rtol=0.1)


def test_a_new_person_differs_by_the_spreads(table: pd.DataFrame) -> None:
    variance = table.loc[("new person", "C")]["sd"] ** 2
    assert_allclose(variance["people"], 0.3**2 * (1 + 1 / PEOPLE), rtol=0.01)
    assert_allclose(variance["conditions"], 0.1**2 * (1 + 1 / CONDITIONS), rtol=0.01)


def test_an_impact_s_interval_is_that_of_all_its_sources(given, u, table) -> None:
    N = sum(trace_errors(given, u, RIDGE).values())
    own = np.diag([SPREADS["sd_impact"] ** 2] * 2 + [0.3**2])
    measured = N + 0.002**2 * np.outer([1, 1, 0], [1, 1, 0])
    V = np.linalg.inv(np.linalg.inv(own) + np.linalg.inv(measured))[:, 0, 0]
    # Person and condition add their own ignorance, drawn in by the square of what the trace leaves open.
    all_but = 1 - table.loc[("impact", "K", "person and condition"), "share"]
    assert_allclose(table.loc[("impact", "K", "all"), "sd"] ** 2 * all_but, np.median(V), rtol=0.01)


def test_a_trace_alone_has_its_own_errors_and_the_mass_s(given, u, table) -> None:
    N = sum(trace_errors(given, u, RIDGE).values())
    for place, q in enumerate("KC"):
        measured = np.median(N[:, place, place] + 0.002**2)
        # Where the population would add a millionth of what it says.
        assert sources.measurement_sd(table.reset_index(), q) == pytest.approx(np.sqrt(measured), rel=1e-3)


def test_a_gain_of_all_impacts_is_a_source_by_itself(given: Prepared, u: np.ndarray) -> None:
    shared = planned(np.full(CONDITIONS, 0.7), gain_error="all")
    draws = drawn(shared, np.insert(u, 3, 0.0, axis=1))
    spread = {"log_gain_mean": 0.004 * draws.population["intercept_K"]}
    draws = replace(draws, population=draws.population | spread)
    found, own = (
        uncertainty_budget(prepared, of).set_index(["level", "quantity", "source"])
        for prepared, of in ((shared, draws), (given, drawn(given, u)))
    )
    for q in "KC":
        # What a trace alone leaves open is the same, whoever else has the error.
        whole, by_itself = (table.loc[("trace alone", q, "all"), "sd"] for table in (found, own))
        assert_allclose(whole, by_itself, rtol=0.01)
        gain, velocity = (
            found.loc[("trace alone", q, name), "sd"] for name in ("gain of all impacts", "velocity and gain")
        )
        together = own.loc[("trace alone", q, "velocity and gain"), "sd"]
        assert_allclose(np.hypot(gain, velocity), together, rtol=0.02)
    told = found.drop(index=["all", "as drawn"], level="source")
    assert_allclose(told.groupby(level=["level", "quantity"])["share"].sum(), 1.0, rtol=1e-9)


@pytest.mark.parametrize(("whose", "errors"), [("subject", PEOPLE), ("mass", CONDITIONS)])
def test_a_mass_that_impacts_share_is_a_source_of_the_mean(monkeypatch, whose, errors) -> None:
    masses = np.linspace(0.5, 0.9, CONDITIONS)
    given = planned(masses, mass_error=whose)
    given = replace(given, model=replace(given.model, log_mass_sd=0.2))
    u = np.zeros((PEOPLE * CONDITIONS, 3))
    alone = np.tile(1e-6 * np.eye(3), (len(u), 1, 1))
    monkeypatch.setattr(sources, "trace_errors", lambda *_: {"noise": alone})
    found = uncertainty_budget(given, drawn(given, u))
    found = found.set_index(["level", "quantity", "source"]).sort_index()
    for q in "KC":
        variance = found.loc[("typical person", q)]["sd"] ** 2
        # K and C have one design, so that neither lends the other anything: a mean of independent errors. The
        # prior of variance 9 draws a mean of variance 0.036 in by 0.4 %, and so its parts by twice that.
        assert_allclose(variance["mass"], 0.2**2 / errors, rtol=0.02)
        assert_allclose(variance["people"], 0.3**2 / PEOPLE, rtol=0.02)
    # Of an impact, whose trace tells all but the mass: of what is left of its error by how much its prior
    # variance makes it, and the whole.
    code = given.mass_group
    assert code is not None

    def left(variance: float) -> float:
        own = np.ones((len(u), 1)), given.design.subject[:, None] == range(PEOPLE)
        block = np.hstack([*own, given.design.trial[:, None] == range(CONDITIONS)]).astype(float)
        X = np.hstack([np.kron(np.eye(2), block), -np.tile(1.0 * (code[:, None] == range(errors)), (2, 1))])
        of_response = [priors.sd**2, *[0.3**2] * PEOPLE, *[0.1**2] * CONDITIONS]
        prior = np.array([*of_response, *of_response, *[variance] * errors])
        return float(np.linalg.inv(X.T @ X / (0.05**2 + 1e-6) + np.diag(1 / prior))[-errors, -errors])

    priors = given.model.priors.intercept.K
    assert priors.sd == given.model.priors.intercept.C.sd
    step = 1e-3
    made = (left(0.2**2 * np.exp(step)) - left(0.2**2 * np.exp(-step))) / (2 * step)
    of_impact = found.loc[("impact", "K")]["sd"] ** 2
    # Differences are off by a share of the step's square; impacts are alike, and so is their median.
    assert_allclose(of_impact["mass"], made, rtol=1e-5)
    assert_allclose(of_impact["all"], left(0.2**2) + 1e-6, rtol=1e-3)


def test_contact_that_the_traces_tell_is_known_but_for_a_normal_error() -> None:
    """About a moment with a uniform error a likelihood is flat, and has no curvature to be expanded by."""
    dataset = read_dataset(resources.shared("data", "published").parent / "example")
    specification = read_specification(resources.shared("models", "impact.toml").parent / "maxwell.toml")
    given = prepare(dataset, specification, source="maxwell")
    assert given.data.record.contact.reach
    stated = impact_likelihood(given.model, given.data, list(jnp.asarray(first_guess(given)).T))
    record = with_contact_at(given.data, stated, stated.mean_first_time()).record.with_normal_errors()
    assert not record.contact.reach
    assert not np.asarray(record.contact.uniform).any()
    assert (np.asarray(record.error_sd)[:, CONTACT] > 0).all()
