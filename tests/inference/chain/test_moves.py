"""Every move leaves the posterior as it is: draws from the joint law of everything stay draws from it.

Hyperparameters, effects, impacts and traces are drawn together, the move is made given the traces, and what
comes out is compared with what went in, over thousands of such sets (a joint test as Geweke's, 2004,
doi:10.1198/016214504000001132, of independent draws). Sites are deliberately bad: the moves are exact
whatever they are.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import Array
from scipy.stats import norm

from bayestissue.inference.chain import moves
from bayestissue.inference.chain.chain_settings import ChainSettings
from bayestissue.inference.chain.moves import State
from bayestissue.inference.execution.kept import some_of
from gaussian_traces import GaussianTarget, bad_tuning, from_prior, prepared, target_of

PEOPLE = {"subject": list("aabb"), "trial": ["x", "y"] * 2, "mass_kg": [0.5, 1.0] * 2}
THRICE = {"subject": list("aaabbb"), "trial": list("xyz") * 2, "mass_kg": [0.5, 0.8, 1.2] * 2}
# No grouping: all effects are of one level.
PADS = {"subject": ["tower"] * 4, "pad": ["A", "A", "B", "C"], "mass_kg": [5.0] * 4}
STRUCTURES: dict[str, tuple[str, dict[str, Any], dict[str, Any]]] = {
    "one impact": ("1", {"subject": ["a"], "mass_kg": [0.8]}, {}),
    "pads": ("pad", PADS, {}),
    "people": ("log(mass_kg) + (1|subject)", PEOPLE, {}),
    "slopes": ("log(mass_kg) + (log(mass_kg)|subject) + (1|trial)", THRICE, {}),
    "a person's mass": ("(1|subject)", PEOPLE, {"mass_error": "subject"}),
    "masses across people": ("log(mass_kg) + (1|subject)", PEOPLE, {"mass_error": "mass"}),
    "a person of no impact": ("log(mass_kg) + (log(mass_kg)|subject) + (1|trial)", THRICE, {}),
}
# Where these alone are left, and the design is still of all.
LEFT = {"a person of no impact": np.array([0, 1, 2])}
# Of all statistics of a test together: that it fails where nothing is wrong.
FALSE_ALARM = 1e-4


def by(name: str, several: int, target: GaussianTarget, state: State, key: Array) -> State:
    """The state after one move."""
    tuning, steps = bad_tuning(target, several)
    kernel = moves.Kernel(target, ChainSettings(), tuning)
    if name == "centred":
        numbers = moves.walk_numbers(target, kernel.settings.centred, key)
        return moves.centred(kernel, steps, state, numbers)[0]
    of_move = moves.move_numbers(target, kernel.settings, key)
    proposal = getattr(moves, name)(kernel, steps, state, of_move)
    return moves.decided(target, state, proposal, of_move.decision)[0]


def statistics(target: GaussianTarget, state: State) -> Array:
    """First and second moments of all, and what holds impacts to traces and people to impacts."""
    expected = target.prior_mean(state.b)
    left, apart = state.u.T - target.traces.centre, state.u - expected
    parts = [state.y, state.b, state.u[:, 0], left[0], apart[:, 0], apart[:, 0] * left[0]]
    first = jnp.concatenate([jnp.ravel(part) for part in parts])
    # Bounded: squares of heavy tails have no law of large numbers worth the name.
    return jnp.concatenate([jnp.tanh(first / 2), jnp.tanh(first**2 / 4)])


def z_scores(made: GaussianTarget, name: str, several: int, number: int, repeats: int) -> np.ndarray:
    """Of each statistic's change by the move; none may be other than standard normal."""

    def one(key: Array) -> Array:
        keys = jax.random.split(key)
        target, state = from_prior(made, keys[0])
        before = statistics(target, state)
        after = jax.lax.fori_loop(
            0, repeats, lambda n, at: by(name, several, target, at, jax.random.fold_in(keys[1], n)), state
        )
        return statistics(target, after) - before

    change = jax.jit(partial(jax.lax.map, one, batch_size=50))(
        jax.random.split(jax.random.PRNGKey(7), number)
    )
    change = np.asarray(change)
    assert np.isfinite(change).all()
    mean, sd = change.mean(0), change.std(0)
    return np.where(sd > 0, mean / np.maximum(sd, 1e-300) * np.sqrt(number), 0.0)


def leaves_the_joint_law(structure: str, name: str, several: int, number: int, repeats: int, **further: Any):
    K, table, model = STRUCTURES[structure]
    made = prepared(K, table, **model, **further)
    here = some_of(made, LEFT.get(structure, np.arange(len(made.impacts))))
    z = z_scores(target_of(here), name, several, number, repeats)
    moved = z[z != 0]
    assert len(moved) > 3
    assert np.abs(moved).max() < norm.isf(FALSE_ALARM / 2 / len(moved))


@pytest.mark.parametrize("several", [1, 2])
@pytest.mark.parametrize("name", [*(move.__name__ for move in moves.MOVES), "centred"])
@pytest.mark.parametrize("structure", list(STRUCTURES))
@pytest.mark.long
def test_a_move_leaves_the_joint_law_as_it_is(structure, name, several):
    if several == 2 and name in ("by_level", "centred"):
        pytest.skip("asks for no site")
    leaves_the_joint_law(structure, name, several, 4000, 5)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("structure", "name", "model"),
    [
        *(("people", name, {}) for name in ("by_population", "by_level", "centred")),
        ("pads", "by_level", {}),
        # Both step where K and C are over M + m: no volume may change by that.
        *(("people", name, {"element": "moving_mass"}) for name in ("by_common", "by_walk")),
        ("people", "by_common", {"gain_sd": 0.3}),
    ],
)
def test_a_move_leaves_the_joint_law_as_it_is_in_few_draws(structure, name, model):
    leaves_the_joint_law(structure, name, 1, 1000, 3, **model)
