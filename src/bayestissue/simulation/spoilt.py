"""What is said of sound and of spoilt recordings, and how far spoiling moves K and C."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from bayestissue.dataset.checks import check_recordings
from bayestissue.dataset.model import Dataset, Quantity, Trace
from bayestissue.dataset.recordings import Recordings
from bayestissue.dataset.samples import Samples
from bayestissue.inference.points.notes import FAILED, NO_ANSWER
from bayestissue.inference.single.estimates import estimate
from bayestissue.signal.quality.kinds import EARLIER
from bayestissue.simulation.sound import Chain, Impact, chain, dataset
from bayestissue.simulation.spoiling import DISPLACEMENT, KINDS, record


@dataclass(frozen=True)
class Recorded:
    """Recordings and the chains that made them, of one quantity, side by side."""

    impacts: list[Impact]
    chains: list[Chain]
    traces: list[Trace]
    quantity: Quantity = "deceleration"

    def __add__(self, other: Recorded) -> Recorded:
        return Recorded(
            self.impacts + other.impacts,
            self.chains + other.chains,
            self.traces + other.traces,
            self.quantity,
        )


def sound_ones(
    impacts: list[Impact],
    count: int,
    quantity: Quantity = "deceleration",
    seed: int = 0,
    *,
    cropped: bool = False,
) -> Recorded:
    """``count`` of the impacts in sound recordings, all ``cropped`` at contact or not."""
    rng = np.random.default_rng([seed, len(KINDS) + (quantity == "displacement")])
    chosen, chains = _drawn(impacts, count, rng, quantity)
    if cropped:
        chains = [replace(each, before=0.0) for each in chains]
    return Recorded(chosen, chains, _sound(chosen, chains, quantity), quantity)


def spoilt_ones(kind: str, impacts: list[Impact], count: int, seed: int = 0) -> Recorded:
    """``count`` of the impacts, spoilt in one of the ways of `bayestissue.simulation.spoiling.KINDS`."""
    rng = np.random.default_rng([seed, list(KINDS).index(kind)])
    quantity: Quantity = "displacement" if kind in DISPLACEMENT else "deceleration"
    chosen, chains = _drawn(impacts, count, rng, quantity)
    traces = [KINDS[kind](impact, each, rng) for impact, each in zip(chosen, chains, strict=True)]
    return Recorded(chosen, chains, traces, quantity)


def judged(recorded: Recorded) -> pd.DataFrame:
    """What is said of recordings, and how far their K and C are off.

    Returns:
        One row per impact: ``flags``, what `check` refuses or warns of or `estimate` flags, joined by "; ";
        ``K_off`` and ``C_off``, how far the point estimates are from those of the same impact recorded with
        the same chain and noise and not spoilt, as fractions (infinite where there is none); ``off``, the
        greater; ``no_answer``, whether the point fit came to none; ``noted``, whether a note says that
        contact may have come earlier.
    """
    data = dataset(recorded.impacts, recorded.traces, recorded.quantity)
    whole = _sound(recorded.impacts, recorded.chains, recorded.quantity)
    reference = estimate(dataset(recorded.impacts, whole, recorded.quantity), method="exact")
    table = estimate(data, method="exact")
    off = {
        name: np.abs(table[column] / reference[column] - 1).fillna(np.inf)
        for name, column in (("K_off", "K_N_per_m"), ("C_off", "C_N_s_per_m"))
    }
    said = table["flags"] + "; " + table["notes"]
    no_answer = [bool({*FAILED, NO_ANSWER} & set(text.split("; "))) for text in said]
    greater = np.maximum(off["K_off"], off["C_off"])
    noted = table["notes"].str.contains(EARLIER.flag, regex=False)
    flags = _said(data, table)
    return pd.DataFrame({"flags": flags, **off, "off": greater, "no_answer": no_answer, "noted": noted})


def _drawn(
    impacts: list[Impact], count: int, rng: np.random.Generator, quantity: Quantity
) -> tuple[list[Impact], list[Chain]]:
    chosen = [impacts[place] for place in rng.choice(len(impacts), count, replace=count > len(impacts))]
    chains = [chain(impact, rng) for impact in chosen]
    if quantity == "displacement":
        # A point estimate from a displacement with more noise than that is of no use.
        chains = [replace(each, noise=each.noise / 40) for each in chains]
    return chosen, chains


def _sound(impacts: list[Impact], chains: list[Chain], quantity: Quantity) -> list[Trace]:
    return [record(impact, each, quantity=quantity) for impact, each in zip(impacts, chains, strict=True)]


def _said(data: Dataset, table: pd.DataFrame) -> pd.Series:
    values = [trace.value for trace in data.traces]
    start = np.concatenate([[0], np.cumsum([value.size for value in values])])
    samples = Samples(
        np.concatenate([trace.time_s for trace in data.traces]),
        np.concatenate(values),
        start,
        np.arange(len(values)),
        ["traces.csv"] * len(values),
        np.arange(start[-1]) + 2,
    )
    found = check_recordings(Recordings.of(samples, data.impacts, data.quantity, data.uncertainty))
    refused = pd.Series("", index=data.impacts["impact"])
    for problem in (*found.warnings, *found.problems):
        refused[problem.impact or ""] = f"refused or warned of: not {problem.expected.split(':')[0]}"
    return refused.reset_index(drop=True).where(lambda said: said != "", table["flags"])
