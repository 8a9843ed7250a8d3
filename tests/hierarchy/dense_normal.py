"""A small hierarchy as one normal over everything, which is what closed forms are checked against."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pandas as pd

from bayestissue.hierarchy.design import build_design
from bayestissue.hierarchy.gaussian.conditional import (
    Conditional,
    Sites,
    integrate_out,
)
from bayestissue.hierarchy.population import (
    Covariances,
    PopulationDesign,
    SharedMassError,
    expected,
    population_design,
)
from bayestissue.hierarchy.priors import Priors
from bayestissue.hierarchy.specification import Formulas

SIZE = 4
OWN = np.array([[0.2, -0.05], [-0.05, 0.3]])
NUISANCE_SD = (0.6, 0.4)


class Dense:
    """Everything as one normal over (b, all u), and summaries as observations m + P^-1 g of u."""

    def __init__(self, repeats: int, *, shared: float = 0.0) -> None:
        self.rng = np.random.default_rng(repeats)
        rows = pd.DataFrame(
            {
                "subject": np.tile(np.repeat(["a", "b", "c"], 2), repeats),
                "trial": np.tile(["x", "y"], 3 * repeats),
                "mass_kg": np.tile([0.5, 1.2], 3 * repeats),
            }
        )
        made = build_design(Formulas(), rows, reference_mass_kg=0.8, source="m.toml")
        self.named, columns = population_design(made, Priors(), ("noise", "atanh_theta1"))
        self.design = PopulationDesign(tuple(map(jnp.asarray, columns.columns)), jnp.asarray(columns.cell))
        self.number = len(rows)
        self.mean = self.named.mean
        self.sd = np.where(np.isfinite(self.named.sd), self.named.sd, 0.7)
        self.spread = Covariances(
            tuple(map(jnp.asarray, (OWN[0, 0], OWN[0, 1], OWN[1, 1]))),
            tuple(map(jnp.asarray, NUISANCE_SD)),
            jnp.asarray(self.sd),
        )
        self.of_b = np.diag(self.sd**2)
        if shared:
            on_K, on_C = (np.r_[self.named.parts[f"subject_effect_{q}"]] for q in "KC")
            self.spread = self.spread._replace(shared=SharedMassError(on_K, on_C, shared**2))
            ones = np.zeros((len(self.sd), len(on_K)))
            ones[on_K, np.arange(len(on_K))] = ones[on_C, np.arange(len(on_C))] = 1
            self.of_b += shared**2 * ones @ ones.T
        self.covariance = np.zeros((SIZE, SIZE))
        self.covariance[:2, :2] = OWN
        self.covariance[2:, 2:] = np.diag(NUISANCE_SD) ** 2
        self.summaries = self._summaries()
        self.X = self._matrix()

    def _summaries(self) -> Sites:
        root = self.rng.normal(size=(self.number, SIZE, SIZE))
        precision = root @ root.swapaxes(1, 2) + 0.2 * np.eye(SIZE)
        centre = np.array([5.0, 2.0, -9.0, 0.0]) + self.rng.normal(size=(self.number, SIZE))
        slope, value = self.rng.normal(size=(self.number, SIZE)), 10 * self.rng.normal(size=self.number)
        return Sites(*map(jnp.asarray, (centre, slope, precision, value)))

    def _matrix(self) -> np.ndarray:
        """X with rows in the order (impact, parameter), one column of b at a time."""
        unit = np.eye(len(self.mean))
        columns = [np.stack(expected(self.design, jnp.asarray(e)), axis=1).ravel() for e in unit]
        return np.stack(columns, axis=1)

    @property
    def inverses(self) -> np.ndarray:
        return np.linalg.inv(np.asarray(self.summaries.precision))

    @property
    def seen(self) -> np.ndarray:
        return np.asarray(self.summaries.centre) + np.einsum(
            "iab,ib->ia", self.inverses, np.asarray(self.summaries.slope)
        )

    @property
    def constants(self) -> np.ndarray:
        """A summary is its constant times a normal density at what was seen."""
        slope, inverse = np.asarray(self.summaries.slope), self.inverses
        bend = np.einsum("ia,iab,ib->i", slope, inverse, slope) / 2
        size = (SIZE * np.log(2 * np.pi) + np.linalg.slogdet(inverse)[1]) / 2
        return np.asarray(self.summaries.log_likelihood) + bend + size

    def blocks(self, matrices: np.ndarray) -> np.ndarray:
        whole = np.zeros((self.number * SIZE, self.number * SIZE))
        for i in range(self.number):
            part = slice(i * SIZE, (i + 1) * SIZE)
            whole[part, part] = matrices[i]
        return whole

    def conditional(self) -> Conditional:
        return integrate_out(self.design, self.spread, jnp.asarray(self.mean), self.summaries)
