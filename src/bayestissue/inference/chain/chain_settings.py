"""The numbers that a run of the chain is made of, each with what it was chosen by."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Self

import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from bayestissue.inference.execution.kept import all_kept

# Up to so many impacts the whole population is moved along with them; of more, so many tell it first.
TOGETHER, FIRST = 4000, 500


@dataclass(frozen=True)
class ChainSettings:
    """How long the parts of a run are; the posterior is the same whatever they are.

    Attributes:
        walks: least and greatest share of an impact's moves that are walks, the others being by its site.
        surrogates: moves of the population in a transition, each an evaluation of all traces: so many where
            their steps are long, and so many where these are below ``short``.
        short: see ``surrogates``.
        levels: least and greatest share of these that move each level's effects by themselves.
        common: least and greatest share of these that are `by_common`, if the model has such a parameter.
        shorter: the share of the population's moves that are shorter, down to ``shortest``: where the sites'
            posterior has lighter tails than the true one, long moves out of a tail are seldom accepted.
        shortest: see ``shorter``.
        inner: steps of a surrogate's own walk. As many as make its end nearly independent of its
            beginning, where they still cost no more than that evaluation.
        centred: steps of the population with the impacts fixed, which cost next to nothing.
        impact_acceptance: that the walks of an impact, and of a level, are adapted to.
        population_acceptance: that the walks of hyperparameters are adapted to, about the best of a random
            walk for a dozen (Roberts, Gelman and Gilks 1997, doi:10.1214/aoap/1034625254); their steps are
            the greatest where more than this is accepted.
        segment: transitions of one compiled call, after which a run can stop.
        keep: transitions for each one of which the impacts' parameters are kept.
        first_rounds: segments of the warm-up's first rounds, while sites and covariances are still poor.
        round: segments of the next one; each further one is longer by ``growth``.
        last_round: segments of the last one, which adapts steps alone.
        most_rounds: further rounds at most.
        agreement: R-hat of the hyperparameters over the second half of the warm-up, below which it is over.
        gain: by how much the log of a step follows its acceptance, in the last round ``last_gain``.
        last_gain: see ``gain``.
        impact_steps: the least and the greatest step of the walk of an impact or a level.
        population_steps: those of the walks of hyperparameters.
        first_look: segments since the warm-up before the first look at the draws. Chains that are each in
            one of two modes look alike early.
        dropped: the share of the segments since the warm-up that is not kept, the first of them.
        growth: of the number of segments from look to look, and from round to round.
        in_a_row: looks that are to pass.
    """

    walks: tuple[float, float] = (0.1, 0.8)
    surrogates: tuple[int, int] = (1, 3)
    short: float = 0.8
    levels: tuple[float, float] = (0.1, 0.8)
    common: tuple[float, float] = (0.05, 0.5)
    shorter: float = 1 / 6
    shortest: float = 0.05
    inner: int = 10
    centred: int = 5
    impact_acceptance: float = 0.3
    population_acceptance: float = 0.25
    segment: int = 50
    keep: int = 1
    first_rounds: tuple[int, ...] = (1, 2, 3)
    round: int = 4
    last_round: int = 2
    most_rounds: int = 10
    agreement: float = 1.05
    gain: float = 0.1
    last_gain: float = 0.03
    impact_steps: tuple[float, float] = (1e-3, 20.0)
    population_steps: tuple[float, float] = (1e-3, 1.0)
    first_look: int = 10
    dropped: float = 0.25
    growth: float = 1.25
    in_a_row: int = 2

    @classmethod
    def of_size(cls, impacts: int, *, clear: bool = False) -> Self:
        """The settings for so many impacts.

        Of thousands a move of the whole population is seldom accepted. `centred` steps carry it then, which
        cost as much as there are cells, and `by_common`. They mix badly where single traces leave much open:
        up to `TOGETHER` impacts they do so only of traces that are ``clear``.
        """
        if impacts <= TOGETHER and not clear:
            return cls() if all_kept(impacts) else cls(keep=5, common=(0.5, 0.5))
        many = {"surrogates": (1, 1), "common": (1.0, 1.0), "inner": 1, "centred": 20}
        rounds = {"first_rounds": (1, 2), "round": 2, "last_round": 1, "most_rounds": 6, "first_look": 6}
        return cls(**many, **rounds, segment=20, keep=10)  # type: ignore[arg-type]

    @property
    def rounds(self) -> tuple[int, ...]:
        """Segments of each round of the warm-up but the last."""
        further = (math.ceil(self.round * self.growth**n) for n in range(self.most_rounds))
        return (*self.first_rounds, *further)

    def shortened(self, uniform: Float[Array, ""]) -> Float[Array, ""]:
        """The share of its full length that a move of the population goes, of a uniform random number."""
        return self.shortest ** jnp.maximum(1 - (1 - uniform) / self.shorter, 0.0)
