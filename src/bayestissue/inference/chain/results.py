"""What a run of the chain leaves: its draws, and where its chains ended."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
from jax import Array
from jaxtyping import Bool, Float, Int

from bayestissue.base.impact_arrays import evenly_spaced
from bayestissue.inference.chain.ending import LookVerdict
from bayestissue.inference.chain.moves import State, Steps, StudentT, Tuning
from bayestissue.inference.chain.run import read_arrays, write_arrays
from bayestissue.inference.execution.compiling import by_row
from bayestissue.model.hierarchy.gaussian.factor import GaussianFactor
from bayestissue.model.hierarchy.population import Hyperparameters, Population
from bayestissue.model.hierarchy.trace_models import Hierarchy, hyperparameters_at

# Draws of one call.
DRAWS = 64


class ChainEnd(NamedTuple):
    """Where the chains of a run ended: all that another run needs to go on as if this one had not stopped.

    Attributes:
        state: of each chain, [chain, ...].
        steps: likewise.
        tuning: of all of them.
        segments: how many each had, those of the warm-up and of earlier runs included.
        continued: whether there was an earlier run.
    """

    state: State
    steps: Steps
    tuning: Tuning
    segments: Int[np.ndarray, ""]
    continued: Bool[np.ndarray, ""]

    def write(self, path: Path) -> None:
        """Write all of it to a file, which is there when it is whole."""
        write_arrays(path, self)

    @classmethod
    def read(cls, path: Path) -> ChainEnd:
        """What `write` wrote.

        Raises:
            KeyError: it is the file of a version whose chains had other parts.
            ValueError, BadZipFile: it is damaged.
        """
        none: Any = np.zeros(0)
        state, steps = of_nothing(State), of_nothing(Steps)
        tuning = Tuning(
            of_nothing(GaussianFactor), of_nothing(StudentT), none, none, of_nothing(StudentT), none
        )
        end: ChainEnd = read_arrays(path, cls(state, steps, tuning, none, none))
        return end


@dataclass(frozen=True)
class ChainDraws:
    """All transitions since the warm-up but the first of them, [chain, draw, ...], impacts before parameters.

    Attributes:
        population: hyperparameters and effects.
        log_likelihood: of all traces.
        log_ratios: log of likelihood over site of each impact that is shown, under "impact", and its sum over
            the levels of each grouping.
        impact_draws: numbers of the draws of which there is ``u``.
        u: each impact's parameters.
        acceptance: of each move, the mean.
        sites: of the traces, the first of each, as the warm-up left them.
        end: where the chains ended, from which another run goes on.
        segments: since the warm-up, or since an earlier run that this one goes on with.
        segment: transitions of one.
        verdict: of the last look.
    """

    population: Population
    log_likelihood: Float[np.ndarray, "chain draw"]
    log_ratios: dict[str, Float[np.ndarray, "chain draw one"]]
    impact_draws: Int[np.ndarray, " kept"]
    u: Float[np.ndarray, "chain kept impact parameter"]
    acceptance: dict[str, float]
    sites: GaussianFactor
    end: ChainEnd
    segments: int
    segment: int
    verdict: LookVerdict

    @property
    def shape(self) -> tuple[int, int]:
        """The numbers of chains and of draws of each."""
        chains, draws = self.log_likelihood.shape
        return chains, draws

    def thinned(self, draws: int) -> ChainDraws:
        """The same with at most so many draws of each chain, evenly spaced, the last among them."""
        rows = evenly_spaced(self.shape[1], draws)
        among = np.isin(self.impact_draws, rows)
        of_all = self.population, self.log_likelihood, self.log_ratios
        population, log_likelihood, log_ratios = jax.tree.map(lambda values: values[:, rows], of_all)
        return replace(
            self,
            population=population,
            log_likelihood=log_likelihood,
            log_ratios=log_ratios,
            impact_draws=np.searchsorted(rows, self.impact_draws[among]),
            u=self.u[:, among],
        )

    def record(self) -> dict[str, Any]:
        """How the chain ran, as it stands in ``run.json``."""
        before = int(self.end.segments) - self.segments
        moves = ", ".join(f"{name} {share:.0%}" for name, share in self.acceptance.items())
        return {
            "words": (
                "Sampled by one Markov chain over hyperparameters, effects and impacts, "
                f"{self.segments * self.segment} transitions of each chain after {before * self.segment} "
                f"{'of earlier runs' if self.end.continued else 'of warm-up'}; accepted: {moves}."
            ),
            "segments": self.segments,
            ("earlier_segments" if self.end.continued else "warm_up_segments"): before,
            "acceptance": self.acceptance,
        }


@by_row(DRAWS, constant=1, axes=2)
def constrained(model: Hierarchy, y: Float[Array, " hyperparameter"]) -> Hyperparameters:
    """Hyperparameters by name from their unconstrained coordinates, of draws [chain, draw, ...]."""
    return hyperparameters_at(model, y)[0]


def of_nothing(kind: Any) -> Any:
    """A structure whose arrays are of no account."""
    return kind(*[np.zeros(0)] * len(kind._fields))
