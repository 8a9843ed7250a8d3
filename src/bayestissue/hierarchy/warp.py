"""A smooth map that makes skewed distributions normal, each number by itself."""

from __future__ import annotations

from typing import Any, NamedTuple

from jaxtyping import Float


class SinhArcsinh(NamedTuple):
    """x = location + along y + bend ((1 + y^2)^1/2 - 1), increasing and smooth, y standard normal.

    A sinh-arcsinh map with normal tails (Jones and Pewsey 2009, Biometrika 96), written as the hyperbola that
    it is: far out its slope is along + bend on the right and along - bend on the left, as of a distribution
    that ends at a wall and thins out slowly away from it.

    Attributes:
        location: x where y is 0.
        along: slope there.
        bend: less than ``along`` in size; 0 for a line.
    """

    location: Float[Any, "*number"]
    along: Float[Any, "*number"]
    bend: Float[Any, "*number"]

    def __call__(self, y: Any) -> Any:
        """The values at ``y``, an array of numpy or of JAX."""
        return self.location + self.along * y + self.bend * ((1 + y**2) ** 0.5 - 1)

    def slope(self, y: Any) -> Any:
        """Of each value, dx/dy."""
        return self.along + self.bend * y / (1 + y**2) ** 0.5

    def part(self, places: slice | int) -> SinhArcsinh:
        """That of some of the numbers."""
        return SinhArcsinh(*(values[places] for values in self))
