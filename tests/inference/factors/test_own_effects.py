"""Effects of one level alone, integrated out: against a dense normal."""

from __future__ import annotations

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

from bayestissue.inference.factors.scores import own_effects
from bayestissue.model.hierarchy.population import MASS_ERROR, SharedMasses, covariances_of, population_design
from bayestissue.model.hierarchy.specification import ModelSpecification
from designs import EVERYTHING, design_of

pytestmark = pytest.mark.slow

FORMULA_C = "(1|subject/side) + (1|session)"
NUISANCE = ("noise", "log_thickness_m")
PRIORS = ModelSpecification(name="m", likelihood="impact", element="wall").complete_priors()


@pytest.mark.parametrize("whose", ["impact", "subject", "session"])
@pytest.mark.parametrize("name", ["subject", "subject:side", "session", "trial"])
def test_integrating_a_levels_own_effects_is_the_dense_normal(name: str, whose: str) -> None:
    design = design_of(EVERYTHING, FORMULA_C, thickness_m="(1|subject) + (1|session)")
    code = None if whose == "impact" else design.groupings[whose].code
    masses = None if code is None else SharedMasses(code, ("K", "C", "log_thickness_m"))
    effects, columns = population_design(design, PRIORS, NUISANCE, masses)
    own = own_effects(SimpleNamespace(locations=effects, nuisance=NUISANCE), design, code)[name]
    rng = np.random.default_rng(3)
    sd = {spread: rng.uniform(0.2, 1.0) for spread in {*effects.spread} - {""}}
    sites = sd | dict.fromkeys(["sd_impact_K", "sd_impact_C", *(f"sd_{each}" for each in NUISANCE)], 1.0)
    impacts = len(design.subject)
    size = 2 + len(NUISANCE)
    root = rng.normal(size=(impacts, size, size))
    W, pull = root @ root.swapaxes(1, 2), rng.normal(size=(impacts, size))
    levels = len(design.groupings[name].levels)
    covariances = covariances_of(effects, jax.tree.map(jnp.asarray, sites), 0.3, NUISANCE)
    found = jax.jit(lambda W, pull: own.gained(covariances, *columns.of_parts(W, pull)))(
        np.moveaxis(W, 0, -1), pull.T
    )
    if name == "trial":
        assert not len(own.parameter)
        assert_allclose(found, 0.0)
        return
    # Each level by itself, over those columns of X that no other level's impacts have.
    part = design.groupings[name].code
    X = np.zeros((impacts, size, effects.size))
    for a, q in ((0, "K"), (1, "C"), (3, "thickness_m")):
        for term, column in design.responses[q].terms.items():
            begin = effects.parts[term.effect(q)].start
            X[np.arange(impacts), a, begin + design.groupings[term.grouping].code] = column.covariate
    prior = np.diag([sd[spread] ** 2 if spread else 0.0 for spread in effects.spread])
    if code is not None:
        errors = np.arange(effects.size)[effects.parts[MASS_ERROR]]
        prior[errors, errors] = 0.3**2
        for a in (0, 1, 3):
            X[np.arange(impacts), a, errors[code]] = -1.0
    for level in range(levels):
        inside = part == level
        used = np.flatnonzero((X[inside] != 0).any((0, 1)) & ~(X[~inside] != 0).any((0, 1)))
        Z, S = X[inside][:, :, used], prior[np.ix_(used, used)]
        A = np.einsum("ias,iab,ibt->st", Z, W[inside], Z)
        s = np.einsum("ias,ia->s", Z, pull[inside])
        inner = np.eye(len(used)) + S @ A
        wanted = s @ np.linalg.solve(inner, S @ s) / 2 - np.linalg.slogdet(inner)[1] / 2
        # Systems of at most a dozen equations, well conditioned.
        assert_allclose(found[level], wanted, rtol=1e-10)
