"""The arrays that most functions take and return, by what they have a number of.

Those of numpy come from files and go to tables; those of jax, whose names begin with Jax, stand in what is
compiled.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float, Int

if TYPE_CHECKING:
    from jax import Array

type PerImpact = Float[np.ndarray, " impact"]
type IndexPerImpact = Int[np.ndarray, " impact"]
type MaskPerImpact = Bool[np.ndarray, " impact"]
type PerSample = Float[np.ndarray, "impact sample"]
type PerParameter = Float[np.ndarray, "impact parameter"]
type PerDraw = Float[np.ndarray, "chain draw"]
type JaxPerImpact = Float[Array, " impact"]
type JaxPerSample = Float[Array, "impact sample"]
type JaxPerParameter = Float[Array, "impact parameter"]
