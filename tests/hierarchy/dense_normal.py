"""A small hierarchy as one normal over everything, which is what closed forms are checked against."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array

from bayestissue.model.hierarchy.gaussian.arrangement import arrange, expected_by_cell
from bayestissue.model.hierarchy.gaussian.effects import (
    Covariances,
    EffectsPosterior,
    integrate_effects,
)
from bayestissue.model.hierarchy.gaussian.factor import GaussianFactor, cell_factors

SIZE = 4
OWN = np.array([[0.2, -0.05], [-0.05, 0.3]])
NUISANCE_SD = (0.6, 0.4)
PEOPLE, SIDES, TRIALS = 4, 2, 3
LOG_MASS = np.array([-0.4, 0.0, 0.5])
# What the formulas of log K, log C and further parameters have besides an intercept and a mass exponent.
DESIGNS = {
    "no groups": ("", ""),
    "people": ("subject", "subject"),
    "people and trials": ("subject trial", "subject trial"),
    "people's sides": ("subject side", "subject side trial"),
    "people's own mass exponents": ("subject slope", "subject slope trial"),
    "sessions across operators": ("session operator", "session operator"),
    "trials of which one has no impact": ("subject trials_and_none", "subject"),
    "the last parameter by people and trials": ("subject", "", None, "subject slope trial"),
    "people and trials, each trial with a mass": ("subject trial", "subject trial"),
    "people and sessions, each trial with a mass": ("subject session", "subject"),
    "the third parameter across the first's": ("subject", "subject", "trial side", None),
}


def rows_of_campaign(repeats: int) -> np.ndarray:
    """Person, side and trial of every impact; one person lacks a trial, another a side, one has many more."""
    each = [
        (person, side, trial)
        for person in range(PEOPLE)
        for side in range(SIDES)
        for trial in range(TRIALS)
        if (person, trial) != (1, 2) and (person, side) != (3, 1)
    ]
    return np.array([*each * repeats, *[(2, 0, 0)] * (3 * repeats - 3)])


def columns_of(term: str, rows: np.ndarray) -> np.ndarray:
    """The columns of a group term, one an effect."""
    person, side, trial = rows.T
    number = np.arange(len(rows))
    codes, value = {
        "subject": (person, 1.0),
        "side": (person * SIDES + side, 1.0),
        "trial": (trial, 1.0),
        "trials_and_none": (np.where(trial == 2, 3, trial), 1.0),
        "slope": (person, LOG_MASS[trial]),
        "session": (number % 5, 1.0),
        "operator": (number % 3, 1.0),
    }[term]
    return (codes[:, None] == np.arange(codes.max() + 1)) * np.broadcast_to(value, len(rows))[:, None]


class Dense:
    """Everything as one normal over (b, all u), and sites as observations m + P^-1 g of u."""

    def __init__(self, name: str, repeats: int = 1, *, scale: float = 1.0) -> None:
        self.scale = scale
        self.rng = np.random.default_rng(repeats)
        rows = rows_of_campaign(repeats)
        self.number = len(rows)
        matrices, self.groups, sd = [], [], []
        formulas = (*DESIGNS[name], None, None)[:SIZE]
        for formula in formulas:
            own = [np.ones((self.number, 1))]
            sd.append(1.5)
            if formula is None:
                matrices += own
                continue
            own.append(LOG_MASS[rows[:, 2], None])
            sd.append(0.8)
            for k, term in enumerate(formula.split()):
                matrix = columns_of(term, rows)
                self.groups.append(slice(len(sd), len(sd) + matrix.shape[1]))
                sd += [0.7 - 0.2 * k] * matrix.shape[1]
                own.append(matrix)
            matrices.append(np.concatenate(own, axis=1))
        moved = None
        if name.endswith("with a mass"):
            # Of log K, log C and the last parameter.
            moved, of_mass = np.array([-1.0, -1.0, 0.0, -1.0]), columns_of(name.split()[-4], rows)
            self.groups.append(slice(len(sd), len(sd) + of_mass.shape[1]))
            sd += [0.3] * of_mass.shape[1]
            matrices.append(of_mass)
        self.sd = np.array(sd)
        self.mean = self.rng.normal(size=len(self.sd))
        whole = np.concatenate(matrices, axis=1)
        _, first, cell = np.unique(whole, axis=0, return_index=True, return_inverse=True)
        self.design = arrange([matrix[first] for matrix in matrices], cell.reshape(-1), self.groups, moved)
        begin = np.cumsum([0, *(matrix.shape[1] for matrix in matrices)])
        # Rows in the order (impact, parameter).
        self.X = np.zeros((self.number, SIZE, len(self.sd)))
        for a, matrix in enumerate(matrices[:SIZE]):
            self.X[:, a, begin[a] : begin[a + 1]] = matrix
        if moved is not None:
            self.X[..., begin[SIZE] :] = moved[:, None] * of_mass[:, None]
        self.X = self.X.reshape(-1, len(self.sd))
        self.covariances = Covariances(
            tuple(jnp.asarray(scale**2 * entry) for entry in (OWN[0, 0], OWN[0, 1], OWN[1, 1])),
            tuple(jnp.asarray(scale * sd) for sd in NUISANCE_SD),
            jnp.asarray(self.sd),
        )
        self.sites = self._sites()

    def _sites(self) -> GaussianFactor:
        root = self.rng.normal(size=(self.number, SIZE, SIZE))
        precision = root @ root.swapaxes(1, 2) + 0.2 * np.eye(SIZE)
        centre = self.rng.normal(size=(self.number, SIZE))
        slope, value = self.rng.normal(size=(self.number, SIZE)), 10 * self.rng.normal(size=self.number)
        return GaussianFactor(*map(jnp.asarray, (centre, slope, precision, value)))

    @property
    def blocked_sites(self) -> GaussianFactor:
        return self.design.blocked(self.sites)

    def sums(self, covariances: Covariances) -> GaussianFactor:
        about = expected_by_cell(self.design, jnp.asarray(self.mean))
        return cell_factors(covariances.of_impact(), about, self.blocked_sites)

    def log_density(self, own: Any, nuisance: Any, locations: Any) -> Array:
        """As a function of all standard deviations."""
        covariances = Covariances(own, nuisance, locations)
        return integrate_effects(self.design, covariances, self.sums(covariances))[1]

    def conditional(self) -> EffectsPosterior:
        return integrate_effects(self.design, self.covariances, self.sums(self.covariances))[0]

    @property
    def whole(self) -> np.ndarray:
        """Covariance of all that was seen."""
        return self.blocks(self.inverses + self.of_u) + self.X @ self.of_b @ self.X.T

    @property
    def of_b(self) -> np.ndarray:
        """Prior covariance of b."""
        return np.diag(self.sd**2)

    @property
    def of_u(self) -> np.ndarray:
        """Covariance of an impact's parameters about X b."""
        found = np.diag(np.square([0, 0, *NUISANCE_SD]))
        found[:2, :2] = OWN
        return self.scale**2 * found

    @property
    def inverses(self) -> np.ndarray:
        return np.linalg.inv(np.asarray(self.sites.precision))

    @property
    def seen(self) -> np.ndarray:
        return np.asarray(self.sites.centre) + np.einsum(
            "iab,ib->ia", self.inverses, np.asarray(self.sites.shift)
        )

    @property
    def constants(self) -> np.ndarray:
        """A site is its constant times a normal density at what was seen."""
        slope, inverse = np.asarray(self.sites.shift), self.inverses
        bend = np.einsum("ia,iab,ib->i", slope, inverse, slope) / 2
        size = (SIZE * np.log(2 * np.pi) + np.linalg.slogdet(inverse)[1]) / 2
        return np.asarray(self.sites.log_scale) + bend + size

    def blocks(self, matrices: np.ndarray) -> np.ndarray:
        whole = np.zeros((self.number * SIZE, self.number * SIZE))
        for i in range(self.number):
            part = slice(i * SIZE, (i + 1) * SIZE)
            whole[part, part] = matrices[i]
        return whole
