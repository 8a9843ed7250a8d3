"""How fast, or from how high, an impact may be until a claim about it no longer holds.

With f(V) the difference of the claim's two sides, below 0 where it holds, each draw has the V of f(V) = 0:
the greatest velocity up to which the claim holds in it. A drop height is h = V² / (2 g). The lower end of the
90 % interval is where the claim holds with 95 % probability: the limit with a guard band of JCGM 106:2012.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import xarray as xr
from jaxtyping import Float

from bayestissue.base.arrays import PerDraw
from bayestissue.inference.answers.grammar import Critical, Node, QuestionError
from bayestissue.inference.answers.integration import SETTINGS
from bayestissue.inference.answers.law import DROP_HEIGHT, fall_height
from bayestissue.inference.answers.study import Study

# The columns of the motion that a claim may be followed along.
ALONG = (DROP_HEIGHT, "velocity_m_s")

# The value of a side of a claim, [chain, draw].
Value = Callable[[Node, Study], xr.DataArray]


def critical_motion(node: Critical, study: Study, value: Value) -> PerDraw:
    """The greatest value of the column up to which the claim holds, [chain, draw].

    The claim is judged at velocities from `AnswerSettings.slowest` to `AnswerSettings.fastest` in some draws,
    closer and closer about its end in them. There the end is solved for in all draws, and from all of these
    velocities where it is elsewhere.

    Args:
        node: what is asked.
        study: of whose impacts.
        value: a side of the claim, where impacts have a velocity of their own in each draw.

    Returns:
        0 where it holds at no velocity, infinite where it holds at all of them.

    Raises:
        QuestionError: the claim holds again at a greater velocity, or has no number at one.
    """
    (claim,) = node.operands
    left, right = claim.operands
    draws = (study.draws.sizes["chain"], study.draws.sizes["draw"])
    sign = 1.0 if claim.symbol in ("<", "<=") else -1.0

    def difference(velocity: Float[np.ndarray, "*draw"], at: np.ndarray | None = None) -> np.ndarray:
        """Below 0 where the claim holds, [chain, draw]."""
        chosen = study.draws
        if at is not None:
            chosen = chosen.isel(draw=at).assign_coords(draw=np.arange(len(at)))
        moved = replace(study, draws=chosen, velocity_m_s=velocity)
        return (sign * (value(left, moved) - value(right, moved))).to_numpy()

    def bracketed(ends: Float[np.ndarray, " end"], draw: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The two ends about the claim's in some draws, and the difference there, [side, chain, draw]."""
        velocity = np.broadcast_to(np.repeat(ends, len(draw)), (draws[0], len(ends) * len(draw)))
        of_all = difference(velocity, np.tile(draw, len(ends))).reshape(draws[0], len(ends), len(draw))
        holds = of_all < 0
        if (holds[:, 1:] & ~holds[:, :-1]).any():
            expected = f"a claim that holds up to one {node.column} and no longer above it"
            raise QuestionError(node.position, node.column, expected)
        last = holds.sum(axis=1) - 1
        sides = np.clip([last, last + 1], 0, len(ends) - 1)
        return ends[sides], np.stack([np.take_along_axis(of_all, n[:, None], axis=1)[:, 0] for n in sides])

    def ends_at(low: float, high: float) -> Float[np.ndarray, " end"]:
        return np.geomspace(low, high, SETTINGS.velocities)

    some = np.unique(np.linspace(0, draws[1] - 1, max(SETTINGS.tried // draws[0], 1)).astype(int))
    low, high = slowest, fastest = SETTINGS.slowest, SETTINGS.fastest
    for _ in range(3):
        sides, _ = bracketed(ends_at(low, high), some)
        low, high = float(sides.min()), float(sides.max())
        # As far to either side again: other draws end beyond these.
        low, high = max(low * low / high, slowest), min(high * high / low, fastest)
    sides = np.stack([np.full(draws, end) for end in (low, high)])
    f = np.stack([difference(velocity) for velocity in sides])
    beyond = (~(f[0] < 0) & (low > slowest)) | ((f[1] < 0) & (high < fastest))
    if elsewhere := np.flatnonzero(beyond.any(axis=0)).tolist():
        sides[..., elsewhere], f[..., elsewhere] = bracketed(ends_at(slowest, fastest), np.array(elsewhere))
    V = np.where(f[0] < 0, np.where(f[1] < 0, np.inf, _solved(difference, sides, f)), 0.0)
    return fall_height(V) if node.column == DROP_HEIGHT else V


def _solved(
    difference: Callable[[np.ndarray], np.ndarray], velocities: np.ndarray, values: np.ndarray
) -> np.ndarray:
    """Where the difference is 0 between two velocities, by the Illinois method (Dowell and Jarratt 1971).

    doi:10.1007/BF01934364. Where its values at the two have one sign, there is nothing to solve for.
    """
    (a, b), (f_a, f_b) = velocities, values
    solving = (f_a < 0) & ~(f_b < 0)
    V, side = a.copy(), np.zeros(a.shape)
    while solving.any():
        slope = np.where(solving, f_b - f_a, 1.0)
        secant = np.where(np.isfinite(slope), b - f_b * (b - a) / slope, (a + b) / 2)
        step = np.abs(secant - V)
        V = np.where(solving, secant, V)
        solving = solving & (step > SETTINGS.of_velocity * V) & (b - a > SETTINGS.of_velocity * a)
        if not solving.any():
            break
        f = difference(np.where(V > 0, V, a))
        below = f < 0
        # An end that stays twice counts for half: else the other would stay for ever where the curve bends.
        f_b = np.where(solving & below, np.where(side > 0, f_b / 2, f_b), f_b)
        f_a = np.where(solving & ~below, np.where(side < 0, f_a / 2, f_a), f_a)
        a, f_a = (np.where(solving & below, *pair) for pair in ((V, a), (f, f_a)))
        b, f_b = (np.where(solving & ~below, *pair) for pair in ((V, b), (f, f_b)))
        side = np.where(below, 1.0, -1.0)
    return V
