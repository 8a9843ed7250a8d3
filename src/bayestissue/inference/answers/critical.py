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

from bayestissue.inference.answers.grammar import Critical, Node, QuestionError
from bayestissue.inference.answers.law import DROP_HEIGHT, Law, fall_height
from bayestissue.inference.answers.settings import SETTINGS

# The columns of the motion that a claim may be followed along, with their units.
ALONG = {DROP_HEIGHT: "cm", "velocity_m_s": "m/s"}


def critical_motion(node: Critical, law: Law, value: Callable[[Node, Law], xr.DataArray]) -> xr.DataArray:
    """The greatest value of the column up to which the claim holds, by draw.

    The claim is judged at velocities from `AnswerSettings.slowest` to `AnswerSettings.fastest`, and its end
    is solved for between two of them.

    Args:
        node: what is asked.
        law: what impacts follow.
        value: a side of the claim in each draw, with a law that has its own velocity in each.

    Returns:
        0 where it holds at no velocity, infinite where it holds at all of them.

    Raises:
        QuestionError: the claim holds again at a greater velocity, or has no number at one.
    """
    from scipy.optimize import elementwise

    left, right = node.claim.operands
    sign = 1.0 if node.claim.symbol in ("<", "<=") else -1.0

    def difference(velocity: Float[np.ndarray, "*draw"]) -> xr.DataArray:
        """Below 0 where the claim holds, in each draw."""
        moved = replace(law, velocity_m_s=velocity)
        return sign * (value(left, moved) - value(right, moved))

    ends = np.geomspace(SETTINGS.slowest, SETTINGS.fastest, SETTINGS.velocities)
    tried = [difference(np.array(end)) for end in ends]
    like = tried[0]
    holds = np.stack([one.to_numpy().ravel() < 0 for one in tried])
    if (holds[1:] & ~holds[:-1]).any():
        expected = f"a claim that holds up to one {node.column} and no longer above it"
        raise QuestionError(node.position, node.column, expected)
    count = holds.sum(axis=0)
    V = np.choose(count > 0, [0.0, np.inf])
    between = np.flatnonzero((count > 0) & (count < len(ends)))
    log_v = np.log(ends[np.minimum(count, len(ends) - 1)])

    def at(x: Float[np.ndarray, " root"], index: Float[np.ndarray, " root"]) -> Float[np.ndarray, " root"]:
        """The difference of some draws; all are computed, since an array of another size is compiled anew."""
        numbers = index.astype(int)
        log_v[numbers] = x
        return difference(np.exp(log_v).reshape(like.shape)).to_numpy().ravel()[numbers]

    if between.size:
        last, next_ = np.log(ends[count[between] - 1]), np.log(ends[count[between]])
        root = elementwise.find_root(
            at,
            (last, next_),
            args=(between.astype(float),),
            tolerances={"xatol": SETTINGS.of_velocity, "xrtol": 0.0},
        )
        V[between] = np.exp(root.x)
    answer = fall_height(V) if node.column == DROP_HEIGHT else V
    return like.copy(data=answer.reshape(like.shape))
