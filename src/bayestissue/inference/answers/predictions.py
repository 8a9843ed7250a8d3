"""New impacts: K, C and the peaks of the motion at masses, velocities and covariates of a table, by person.

A prediction is of one new impact. Its log K and log C are the expected ones at its levels, with the scatter
from impact to impact added: N(0, S), S with the spreads sd_impact_K, sd_impact_C and their correlation; a
further parameter of the element likewise. People, conditions and other levels that were measured keep their
effects; any other level, and one that is not given, is a new one of its population. Each draw's K and C, with
the mass and velocity, are then simulated on the run's element, along the gravity of the run.
"""

from __future__ import annotations

import difflib
from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
import pandas as pd
from jaxtyping import Float

from bayestissue.elements import REFERENCE_DIAMETER_M, element
from bayestissue.elements.element import GRAVITY
from bayestissue.elements.peaks import Peaks, peaks_of
from bayestissue.errors import Coded
from bayestissue.hierarchy.effects import RESPONSES, intercept, parameter_of, sd_impact
from bayestissue.hierarchy.levels import NEW, Condition, Recorded, log_at_levels
from bayestissue.inference.answers.finished import Finished

# Units stand in the names of the columns; each has beside it the ends of the 90 % interval, _low and _high.
QUANTITIES = {
    "K": "K_N_per_m",
    "C": "C_N_s_per_m",
    "depth": "peak_displacement_m",
    "force": "peak_force_N",
    "time": "time_to_peak_s",
}
NO_LAW = Coded("no peaks: beside a discrepancy there is no law to simulate by", "not-simulated")
NO_VELOCITY = Coded("no peaks: no velocity_m_s, and the run has none", "not-simulated")
_QUANTILES = {"": 0.5, "_low": 0.05, "_high": 0.95}
# Simulated at once, by code that is compiled for this size alone.
_AT_ONCE = 4096
# Simulated in all, draws evenly left out, but never so that a condition has fewer than this: 5 % quantiles of
# so many draws have a standard error of a tenth of the standard deviation.
_MOST, _FEWEST = 20_000, 500
_LEVELS, _SCATTER = 1, 2
# Of a name that was not measured to one that was, as `difflib` has likeness.
_LIKE = 0.7


def predict(finished: Finished, conditions: Sequence[Condition]) -> pd.DataFrame:
    """Predictions of one new impact in each condition; float64 must be set.

    Args:
        finished: the fit.
        conditions: what is given in each, by column; see `bayestissue.hierarchy.levels`.

    Returns:
        A row a condition: what it was given, which levels are ``new``, `QUANTITIES` with median and 90 %
        interval, the number of ``draws``, of which ``simulated`` were simulated, and a ``note`` where
        something lacks or lies beyond what was measured.
    """
    recorded, which = finished.recorded, element(finished.element)
    names = [*RESPONSES, *(each.name for each in which.extra)]
    logs = _parameters(finished, names, conditions)
    parameters = {
        name: np.exp(each.reshape(-1, len(conditions))) for name, each in zip(names, logs, strict=True)
    }
    count = len(parameters["K"])
    step = max(1, min(-(-count * len(conditions) // _MOST), count // _FEWEST))
    some = {name: each[::step] for name, each in parameters.items()}
    values = {"K": parameters["K"], "C": parameters["C"]}
    mass, velocity, diameter = (_numbers(recorded, conditions, name) for name in _GIVEN)
    notes = [
        [*recorded.beyond(each), *_unknown(recorded, each), *recorded.average_notes(RESPONSES, each)]
        for each in conditions
    ]
    if finished.discrepancy:
        notes = [[*each, NO_LAW] for each in notes]
    else:
        beside = {"diameter_m": diameter}
        if finished.gravity:
            beside[GRAVITY] = np.full(len(conditions), finished.gravity)
        values |= _peaks(finished.element, some, mass, velocity, beside)
        notes = [[*n, *([] if v > 0 else [NO_VELOCITY])] for n, v in zip(notes, velocity, strict=True)]
    return pd.DataFrame(
        [
            dict(condition)
            | {"mass_kg": mass[place], "velocity_m_s": velocity[place]}
            | {"new": ", ".join(_new(recorded, condition))}
            | _summary({name: each[:, place] for name, each in values.items()})
            | {"draws": count, "simulated": 0 if finished.discrepancy else len(some["K"])}
            | {"note": "; ".join(notes[place])}
            for place, condition in enumerate(conditions)
        ]
    )


_GIVEN = ("mass_kg", "velocity_m_s", "diameter_m")


def _parameters(
    finished: Finished, names: Sequence[str], conditions: Sequence[Condition]
) -> list[Float[np.ndarray, "chain draw condition"]]:
    """Draws of the log of each parameter of a new impact in each condition."""
    draws = finished.posterior
    shape = (draws.sizes["chain"], draws.sizes["draw"], len(conditions))
    scatter = np.random.default_rng(_SCATTER).standard_normal((len(names), *shape))
    if "residual_correlation" in draws:
        r = draws["residual_correlation"].to_numpy()[..., None]
        scatter[1] = r * scatter[0] + np.sqrt(1 - r**2) * scatter[1]
    found = []
    for name, noise in zip(names, scatter, strict=True):
        parameter = parameter_of(name)
        if name in finished.recorded.formulas:
            log = log_at_levels(draws, finished.recorded, name, conditions, new_levels=_LEVELS)
        else:
            log = draws[intercept(parameter)].to_numpy()[..., None] + np.zeros(shape)
        found.append(log + draws[sd_impact(parameter)].to_numpy()[..., None] * noise)
    return found


def _numbers(
    recorded: Recorded, conditions: Sequence[Condition], name: str
) -> Float[np.ndarray, " condition"]:
    """A number of each condition, else that of the reference row, else NaN; of diameters the usual one."""
    otherwise = recorded.reference.get(name, np.nan)
    if name == "diameter_m" and not np.isfinite(otherwise):
        otherwise = REFERENCE_DIAMETER_M
    return np.array([float(each.get(name, otherwise)) for each in conditions])


def _peaks(
    which: str,
    parameters: dict[str, Float[np.ndarray, "draw condition"]],
    mass: Float[np.ndarray, " condition"],
    velocity: Float[np.ndarray, " condition"],
    beside: dict[str, Float[np.ndarray, " condition"]],
) -> dict[str, Float[np.ndarray, "draw condition"]]:
    """Each of the peaks in every draw and condition; NaN where there is no velocity.

    ``beside`` is what the element's functions take beside its parameters.
    """
    shape = parameters["K"].shape
    p = parameters | {name: np.broadcast_to(each, shape) for name, each in beside.items()}
    known = np.where(velocity > 0, velocity, 1.0)
    each = [np.broadcast_to(v, shape).ravel() for v in (*p.values(), mass, known)]
    parts = []
    for begin in range(0, each[0].size, _AT_ONCE):
        # The last part is filled up with what stands in it already.
        *values, M, V = (jnp.asarray(np.resize(v[begin : begin + _AT_ONCE], _AT_ONCE)) for v in each)
        parts.append(peaks_of(element(which), dict(zip(p, values, strict=True)), M, V))
    columns = dict(zip(Peaks._fields, zip(*parts, strict=True), strict=True))
    whole = {name: np.concatenate(column)[: each[0].size].reshape(shape) for name, column in columns.items()}
    return {name: np.where(velocity > 0, found, np.nan) for name, found in whole.items()}


def _summary(values: dict[str, Float[np.ndarray, " draw"]]) -> dict[str, float]:
    """Median and 90 % interval of each quantity that there is."""
    found = {f"{column}{end}": np.nan for column in QUANTITIES.values() for end in _QUANTILES}
    for name, draws in values.items():
        # Some draws of a strongly damped impact may have no peak: their time is infinite.
        of = np.asarray(list(_QUANTILES.values()))
        finite = np.isfinite(draws).all()
        ends = np.quantile(draws, of) if finite else np.quantile(draws, of, method="inverted_cdf")
        found |= {f"{QUANTITIES[name]}{end}": float(v) for end, v in zip(_QUANTILES, ends, strict=True)}
    return found


def _new(recorded: Recorded, condition: Condition) -> list[str]:
    """The groups of which a condition has a new level."""
    complete = recorded.completed(condition)
    found = []
    for term in recorded.terms:
        given = {factor: complete[factor] for factor in term.factors if factor in complete}
        if len(given) < len(term.factors) or not len(recorded.matching(given)):
            found.append(term.grouping)
    return list(dict.fromkeys(found))


def _unknown(recorded: Recorded, condition: Condition) -> list[Coded]:
    """Names of levels that were not measured and look like slips."""
    found = []
    for name, value in condition.items():
        if name not in recorded.factors or value == NEW or value in (levels := recorded.levels(name)):
            continue
        near = difflib.get_close_matches(str(value), levels, n=1, cutoff=_LIKE)
        asked = f"; did you mean {near[0]}?" if near else ""
        words = f'{name} "{value}" was not measured: a new one of the population{asked}'
        found.append(Coded(words, "new-level"))
    return found
