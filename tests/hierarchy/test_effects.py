"""Fixed and group effects of any design, integrated out and drawn, against one dense normal."""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from dense_normal import SIZE, Dense
from numpy.testing import assert_allclose
from scipy.stats import multivariate_normal

from bayestissue.model.hierarchy.gaussian.arrangement import expected_by_cell
from bayestissue.model.hierarchy.gaussian.effects import effects_from_standard

pytestmark = pytest.mark.slow

# Crossed levels with small sites, nested ones with parameters without a formula, and errors of masses.
CASES = [
    ("people and trials", 3, 1e-4),
    ("people's sides", 2, 1.0),
    ("people and trials, each trial with a mass", 2, 1.0),
]
FURTHER = [
    ("sessions across operators", 1, 1.0),
    ("the last parameter by people and trials", 2, 1.0),
    ("no groups", 1, 1e3),
    ("people and sessions, each trial with a mass", 1, 1.0),
    ("people's own mass exponents", 2, 1.0),
    ("trials of which one has no impact", 2, 1.0),
    ("the third parameter across the first's", 1, 1.0),
]
EVERY = [*CASES, *(pytest.param(case, marks=pytest.mark.long) for case in FURTHER)]


class Case(NamedTuple):
    """A hierarchy, and all that is asked of it, compiled once."""

    dense: Dense
    expected: np.ndarray
    value: np.ndarray
    slopes: tuple[np.ndarray, np.ndarray, np.ndarray]
    mean: np.ndarray
    root: np.ndarray


@pytest.fixture(scope="module", params=EVERY, ids=lambda case: ", ".join(map(str, case)))
def case(request: pytest.FixtureRequest) -> Case:
    name, repeats, scale = request.param
    dense = Dense(name, repeats, scale=scale)

    @partial(jax.jit, compiler_options={"xla_backend_optimization_level": 0})
    def found() -> tuple[jax.Array, ...]:
        own = (dense.covariances.pair, dense.covariances.nuisance, dense.covariances.locations)
        value, slopes = jax.value_and_grad(lambda own: dense.log_density(*own))(own)
        conditional, mean = dense.conditional(), jnp.asarray(dense.mean)
        unit = jnp.eye(len(mean))
        b = effects_from_standard(dense.design, conditional, mean)
        drawn = jax.vmap(lambda z: effects_from_standard(dense.design, conditional, mean, z))(unit)
        return expected_by_cell(dense.design, unit), value, slopes, b, (drawn - b).T

    return Case(dense, *jax.tree.map(np.asarray, found()))


def test_every_element_of_b_has_its_place_and_every_impact_its_row(case: Case) -> None:
    dense, design = case.dense, case.dense.design
    elements = np.concatenate([np.ravel(each) for each in (*design.inner_element, *design.outer_element)])
    assert sorted(elements[elements < len(dense.sd)]) == list(range(len(dense.sd)))
    members = np.asarray(design.members)
    assert sorted(members[members < dense.number]) == list(range(dense.number))
    of_impacts = case.expected[..., design.cell].transpose(2, 0, 1)
    assert_allclose(of_impacts.reshape(dense.X.shape), dense.X, atol=1e-15)


def test_the_log_density_is_the_dense_one(case: Case) -> None:
    dense = case.dense
    direct = multivariate_normal(dense.X @ dense.mean, dense.whole).logpdf(dense.seen.ravel())
    assert_allclose(case.value, direct + dense.constants.sum(), rtol=1e-10)


def test_b_has_its_dense_conditional_mean_and_covariance(case: Case) -> None:
    dense = case.dense
    noise = np.linalg.inv(dense.blocks(dense.inverses + dense.of_u))
    precision = dense.X.T @ noise @ dense.X + np.linalg.inv(dense.of_b)
    right = dense.X.T @ noise @ (dense.seen.ravel() - dense.X @ dense.mean)
    assert_allclose(case.mean, dense.mean + np.linalg.solve(precision, right), rtol=1e-9, atol=1e-10)
    # The map is affine: its slope times its transpose is the covariance.
    assert_allclose(case.root @ case.root.T, np.linalg.inv(precision), rtol=1e-8, atol=1e-10)


def test_derivatives_are_those_of_the_dense_density(case: Case) -> None:
    """Of log N(r; 0, S) by S: (S^-1 r r' S^-1 - S^-1) / 2."""
    dense = case.dense
    inverse = np.linalg.inv(dense.whole)
    turned = inverse @ (dense.seen.ravel() - dense.X @ dense.mean)
    by_whole = (np.outer(turned, turned) - inverse) / 2
    by_u = np.einsum("iaib->ab", by_whole.reshape(dense.number, SIZE, dense.number, SIZE))
    own, nuisance, locations = case.slopes
    # By logs, as chains move; the terms that cancel in a slope are about as many as there are impacts.
    entries, sd = np.asarray(dense.covariances.pair), np.asarray(dense.covariances.nuisance)
    by_entries = np.array([by_u[0, 0], 2 * by_u[0, 1], by_u[1, 1]])
    assert_allclose(entries * np.asarray(own), entries * by_entries, rtol=1e-7, atol=1e-7)
    assert_allclose(sd * np.asarray(nuisance), 2 * sd**2 * np.diag(by_u)[2:], rtol=1e-7, atol=1e-7)
    by_b = np.diag(dense.X.T @ by_whole @ dense.X)
    assert_allclose(locations, 2 * dense.sd * by_b, rtol=1e-8, atol=1e-8)


def test_the_factor_of_most_levels_is_eliminated_with_all_that_is_nested_in_it() -> None:
    of_people = Dense("people's sides").design
    assert [len(each) for each in of_people.inner_element] == [3, 3, 0, 0]
    assert of_people.inner_element[0].shape[1] == 4
    crossed = Dense("sessions across operators").design
    assert [each.shape for each in crossed.inner_element] == [(1, 5), (1, 5), (0, 5), (0, 5)]
    assert not any(each.size for each in Dense("no groups").design.inner_element)
