"""The force of an element along a motion that is given: nothing is solved but what the element remembers."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from bayestissue.elements.element import Element, Parameters, States
from bayestissue.elements.linear import exponential

# Of a cubic: its value and three derivatives.
_TERMS = 4


def internal_lengths(
    element: Element,
    p: Parameters,
    x: Float[Array, "impact sample"],
    v: Float[Array, "impact sample"],
    first_time: Float[Array, " impact"],
    dt: Float[Array, " impact"],
) -> States:
    """The internal lengths s at samples of a motion x(t), 0 at contact [m].

    s' = A s + u, u being what x alone adds to the rates. From sample to sample x is taken as the cubic of its
    values and rates, and then each step is exact, however fast s follows.

    Args:
        element: linear, with rates of x and s alone; or one that remembers nothing.
        p: its parameters, each [impact, 1].
        x: depth at each sample [m].
        v: its rate [m/s].
        first_time: from contact to the first sample [s].
        dt: sampling interval [s].
    """
    size = element.states
    if not size:
        return ()

    def rates(x: Array, s: States) -> Array:
        return jnp.stack(element.rates(x, jnp.zeros_like(x), s, p), axis=-1)

    still = jnp.zeros_like(x[:, :1])
    units = (tuple(still + (a == b) for b in range(size)) for a in range(size))
    matrix = jnp.stack([rates(still, unit)[:, 0] for unit in units], axis=-1)
    # Straight from contact to the first sample.
    at_contact = x[:, :1] - first_time[:, None] * v[:, :1]
    x, v = jnp.concatenate([at_contact, x], axis=1), jnp.concatenate([v[:, :1], v], axis=1)
    none = (jnp.zeros_like(x),) * size
    u, slope = rates(x, none), rates(v, none)
    step = jnp.concatenate([first_time[:, None], jnp.broadcast_to(dt[:, None], x[:, 2:].shape)], axis=1)
    begin, end = (step[..., None] * part for part in (slope[:, :-1], slope[:, 1:]))
    run = jnp.diff(u, axis=1)
    # Derivatives at the beginning of each step, in units of it.
    cubic = [u[:, :-1], begin, 2 * (3 * run - 2 * begin - end), 6 * (begin + end - 2 * run)]
    over_first, over_step = (_step(matrix, length) for length in (first_time, dt))
    added = jnp.concatenate(cubic, axis=-1)
    first = jnp.einsum("iab,ib->ia", over_first[..., size:], added[:, 0])

    def follow(s: Array, added: Array) -> tuple[Array, Array]:
        s = jnp.einsum("iab,ib->ia", over_step[..., :size], s) + added
        return s, s

    of_steps = jnp.einsum("iab,isb->sia", over_step[..., size:], added[:, 1:])
    _, later = jax.lax.scan(follow, first, of_steps)
    lengths = jnp.concatenate([first[None], later])
    return tuple(lengths[..., a].T for a in range(size))


def _step(
    matrix: Float[Array, "impact state state"], length: Float[Array, " impact"]
) -> Float[Array, "impact state column"]:
    """What s at a step's beginning, and u there with its derivatives in units of the step, add at its end.

    The rows of s of exp of a matrix with A h in its corner, h and ones above its diagonal (Van Loan 1978,
    doi:10.1109/TAC.1978.1101743).
    """
    size, h = matrix.shape[-1], length[:, None, None]
    above, unit = np.eye(_TERMS + 1, k=1), np.eye(size)
    of_u = np.kron(above * (np.arange(_TERMS + 1) == 1), unit)
    of_s = jnp.pad(matrix, ((0, 0), (0, _TERMS * size), (0, _TERMS * size)))
    return exponential(h * (of_s + of_u) + np.kron(above, unit) - of_u)[:, :size]
