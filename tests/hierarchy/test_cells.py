"""People eliminated one by one give what one dense factor gives."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest
from bayestissue.hierarchy.gaussian.cell_solution import locations_of, solve
from bayestissue.hierarchy.gaussian.cells import Cells, arrange, expected_by_place, in_cells
from numpy.testing import assert_allclose

from bayestissue.hierarchy.design import build_design
from bayestissue.hierarchy.gaussian.conditional import Sites, integrate_out
from bayestissue.hierarchy.population import (
    Covariances,
    Effects,
    PopulationDesign,
    SharedMassError,
    expected,
    population_design,
)
from bayestissue.hierarchy.priors import Priors
from bayestissue.hierarchy.specification import Formulas

SIZE = 3
WITHOUT_PEOPLE = Formulas(K="log(mass_kg)", C="log(mass_kg) + (1|trial)")
OF_PEOPLE = Formulas(K="log(mass_kg) + age + (1|subject)", C="age + (1|subject) + (1|trial)")


class Problem:
    """Sites of impacts of four people in three conditions, some cells without an impact."""

    def __init__(self, formulas: Formulas, repeats: int, shared: float = 0.0) -> None:
        rng = np.random.default_rng(repeats)
        rows = pd.DataFrame(
            [
                (f"s{person}", f"t{trial}", (0.4, 0.7, 1.3)[trial], 20.0 + person**2)
                for _ in range(repeats)
                for person in range(4)
                for trial in range(3)
                if (person, trial) != (1, 2)
            ],
            columns=["subject", "trial", "mass_kg", "age"],
        )
        made = build_design(formulas, rows, reference_mass_kg=0.8, source="m.toml")
        self.named: Effects
        self.named, columns = population_design(made, Priors(), ("noise",))
        self.design = PopulationDesign(tuple(map(jnp.asarray, columns.columns)), jnp.asarray(columns.cell))
        self.mean = self.named.mean
        people = [np.r_[self.named.parts[f"subject_effect_{q}"]] for q in "KC"] if shared else []
        self.spread = Covariances(
            (jnp.asarray(0.2), jnp.asarray(-0.05), jnp.asarray(0.3)),
            (jnp.asarray(0.6),),
            jnp.asarray(np.where(np.isfinite(self.named.sd), self.named.sd, 0.7)),
            SharedMassError(*people, shared) if shared else None,
        )
        count = len(rows)
        root = rng.normal(size=(count, SIZE, SIZE))
        self.summaries = Sites(
            jnp.asarray(np.array([5.0, 2.0, -9.0]) + rng.normal(size=(count, SIZE))),
            jnp.asarray(rng.normal(size=(count, SIZE))),
            jnp.asarray(root @ root.swapaxes(1, 2) + 0.2 * np.eye(SIZE)),
            jnp.asarray(10 * rng.normal(size=count)),
        )
        reference = self.mean + 0.3 * rng.normal(size=len(self.mean))
        group = "subject" if shared else None
        self.cells: Cells = in_cells(
            arrange(self.named, self.design, group), self.summaries, self.mean, reference
        )

    def dense(self, own: tuple, nuisance: tuple) -> jax.Array:
        spread = self.spread._replace(own=own, nuisance=nuisance)
        return integrate_out(self.design, spread, jnp.asarray(self.mean), self.summaries).log_evidence

    def eliminated(self, own: tuple, nuisance: tuple) -> jax.Array:
        return solve(self.cells, self.spread._replace(own=own, nuisance=nuisance))[0].log_evidence


@pytest.fixture(
    scope="module",
    params=[
        (Formulas(), 1, 0.0),
        (OF_PEOPLE, 2, 0.0),
        (WITHOUT_PEOPLE, 2, 0.0),
        (Formulas(), 2, 0.3),
    ],
    ids=["one each", "covariate of people", "no people", "shared error"],
)
def problem(request: pytest.FixtureRequest) -> Problem:
    return Problem(*request.param)


def test_evidence_and_slopes_are_the_dense_ones(problem: Problem) -> None:
    given = problem.spread.own, problem.spread.nuisance
    value, slopes = jax.jit(jax.value_and_grad(problem.eliminated, (0, 1)))(*given)
    expected_value, expected_slopes = jax.jit(jax.value_and_grad(problem.dense, (0, 1)))(*given)
    # A few hundred operations on numbers of a few hundred, each rounded to 1e-16.
    assert_allclose(value, expected_value, rtol=1e-11)
    assert_allclose(
        jnp.stack(jax.tree.leaves(slopes)), jnp.stack(jax.tree.leaves(expected_slopes)), rtol=1e-9
    )


def test_locations_have_the_dense_mean_and_covariance(problem: Problem) -> None:
    found = jax.jit(integrate_out)(
        problem.design, problem.spread, jnp.asarray(problem.mean), problem.summaries
    )
    solution, _ = jax.jit(solve)(problem.cells, problem.spread)
    mean = locations_of(problem.cells, solution)
    assert_allclose(mean, found.mean, rtol=0, atol=1e-11 * np.abs(found.mean).max())
    unit = jnp.eye(len(problem.mean))
    # Effects are linear in the standard normals, so one of each tells the factor of the covariance.
    root = jax.jit(jax.vmap(lambda z: locations_of(problem.cells, solution, z)))(unit) - mean
    covariance = jnp.linalg.inv(found.factor @ found.factor.T)
    assert_allclose(root.T @ root, covariance, rtol=0, atol=1e-10 * float(jnp.abs(covariance).max()))


def test_every_impact_is_at_its_place(problem: Problem) -> None:
    layout = problem.cells.arrangement
    b = jnp.asarray(np.random.default_rng(3).normal(size=len(problem.mean)))
    for found, direct in zip(expected_by_place(layout, b), expected(problem.design, b), strict=True):
        assert_allclose(np.asarray(found)[layout.place], direct, rtol=1e-12)
    members = layout.members[layout.members < len(layout.place)]
    assert sorted(members) == list(range(len(layout.place)))
