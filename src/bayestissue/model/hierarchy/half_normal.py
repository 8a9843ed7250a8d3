"""The half-normal prior of a standard deviation, on a coordinate without a wall."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpyro.distributions as dist
from numpyro.distributions import biject_to, constraints
from numpyro.distributions.transforms import AffineTransform, ComposeTransform, SoftplusTransform


class PositiveOfScale(constraints.Constraint):
    """Positive numbers, s log(1 + e^y) of an unconstrained y.

    Attributes:
        scale: s.
    """

    def __init__(self, scale: Any) -> None:
        self.scale = scale

    def __call__(self, x: Any) -> Any:
        """Whether ``x`` is one of them."""
        return x > 0

    def feasible_like(self, prototype: Any) -> Any:
        """One of them, in the prototype's shape."""
        return jnp.broadcast_to(self.scale, jnp.shape(prototype))

    def tree_flatten(self) -> Any:
        """For JAX."""
        return (self.scale,), (("scale",), {})


@biject_to.register(PositiveOfScale)
def _transform(constraint: PositiveOfScale) -> ComposeTransform:
    stretch = AffineTransform(0.0, constraint.scale, domain=constraints.positive)
    return ComposeTransform([SoftplusTransform(), stretch])


class HalfNormalSpread(dist.HalfNormal):
    """A half-normal number whose unconstrained coordinate y gives it as scale log(1 + e^y).

    On the log scale, numpyro's choice, the upper tail falls as exp(-e^{2y} / 2). A chain climbs it in
    steps that multiply every impact's deviation at once, and diverges. As a function of this y that tail is
    a normal's, and the lower one is the same as on the log scale.
    """

    @constraints.dependent_property(is_discrete=False, event_dim=0)
    def support(self) -> PositiveOfScale:
        """The positive numbers."""
        return PositiveOfScale(self.scale)
