"""A study with as many impacts more, drawn from its own posterior.

Of a draw theta of the posterior p(theta | y), and data y' ~ p(y' | theta), theta is a draw of
p(theta | y, y') too. So what a fit of y and y' together says of theta can be held against theta itself:
posterior simulation-based calibration (Säilynoja, Schmitt, Bürkner and Vehtari 2025, arXiv:2502.03279).

theta is all that the chain draws: standard deviations and correlations, fixed and group effects b, and
each recorded impact's parameters u. y' repeats every impact once more: the same person, condition, mass
and velocity, parameters u' ~ N(X b, D^-1) of its own, and a trace p(y' | u') over the samples of the
recorded one.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float
from scipy.integrate import cumulative_trapezoid

from bayestissue.base.impact_arrays import evenly_spaced
from bayestissue.inference.chain.chain_settings import TOGETHER
from bayestissue.inference.chain.results import ChainDraws
from bayestissue.inference.execution.kept import some_of
from bayestissue.inference.quantities.quantity_draws import replicates
from bayestissue.model.hierarchy.gaussian.arrangement import expected
from bayestissue.model.hierarchy.population import Population
from bayestissue.model.hierarchy.trace_data import Prepared
from bayestissue.model.likelihood.record import DecelerationRecord
from bayestissue.recordings.signal import Displacements


class Truth(NamedTuple):
    """One draw of the posterior, [impact, parameter] of the recorded impacts or of all."""

    population: Population
    u: Float[np.ndarray, "impact parameter"]


def reason_against(prepared: Prepared) -> str:
    """Why a trace can't be drawn as the model has it, or such a study not be fitted in time; else nothing."""
    record = prepared.data.record
    if len(prepared.impacts) > TOGETHER:
        return f"there are more than {TOGETHER} impacts"
    if prepared.force is not None:
        return "a force was recorded beside the deceleration, which is not drawn"
    if isinstance(record, DecelerationRecord):
        if record.contact.reach:
            return "the recordings themselves have to tell when contact was"
        if record.clipped is not None:
            return "recordings are clipped at the sensor's limit"
    return ""


def truths(chains: ChainDraws, count: int) -> list[Truth]:
    """So many draws of the posterior, spread evenly over all chains."""
    number = chains.shape[0]
    rows = evenly_spaced(len(chains.impact_draws), -(-count // number))
    places = [(chain, int(row)) for row in rows for chain in range(number)][:count]
    return [
        Truth(
            jax.tree.map(lambda leaf, at=(chain, int(chains.impact_draws[row])): leaf[at], chains.population),
            np.asarray(chains.u[chain, row], float),
        )
        for chain, row in places
    ]


def new_impacts(
    prepared: Prepared, population: Population, rng: np.random.Generator
) -> Float[np.ndarray, "impact parameter"]:
    """Parameters u' ~ N(X b, D^-1) of every impact once more, K and C at the recorded mass."""
    covariances = prepared.model.covariances(population.hyperparameters)
    u = np.array(expected(prepared.data.design, jnp.asarray(population.b))).T
    standard = rng.standard_normal(u.shape)
    u[:, :2] += standard[:, :2] @ np.linalg.cholesky(np.asarray(covariances.pair_matrix)).T
    u[:, 2:] += standard[:, 2:] * np.array([float(sd) for sd in covariances.nuisance])
    return u


def augmented(
    prepared: Prepared, truth: Truth, key: Array, rng: np.random.Generator
) -> tuple[Prepared, Truth]:
    """The recorded impacts with as many drawn ones behind them, and the truth of all of them.

    Args:
        prepared: the fit; `reason_against` has nothing against it.
        truth: that the drawn impacts are of.
        key: of their traces.
        rng: of their parameters.
    """
    count = len(prepared.impacts)
    rows, u = np.tile(np.arange(count), 2), new_impacts(prepared, truth.population, rng)
    drawn = {
        name: np.nan_to_num(v[0])
        for name, v in replicates(prepared.model, prepared.data, u[None], key[None]).items()
    }
    twice, design = some_of(prepared, rows), prepared.design
    recorded = prepared.data.record.traces
    quantity = "deceleration" if isinstance(prepared.data.record, DecelerationRecord) else "displacement"
    traces = np.concatenate([np.asarray(recorded), drawn[quantity]])
    record = twice.data.record.with_traces(traces)
    groupings = {name: replace(one, code=one.code[rows]) for name, one in design.groupings.items()}
    study = replace(
        twice,
        data=replace(twice.data, record=record),
        design=replace(design, groupings=groupings),
        signal=_with_motion(prepared.signal, twice.signal, drawn),
    )
    return study, Truth(truth.population, np.concatenate([truth.u, u]))


def _with_motion(
    recorded: Displacements, twice: Displacements, drawn: dict[str, Float[np.ndarray, "impact sample"]]
) -> Displacements:
    """The signal of both, from which first guesses start: that of the drawn impacts by their motion."""
    dt = recorded.dt[:, None]
    deceleration = drawn["deceleration"]
    if "displacement" in drawn:
        x = drawn["displacement"]
        v = np.gradient(x, axis=1) / dt
    else:
        lost = dt * cumulative_trapezoid(deceleration - recorded.gravity[:, None], initial=0)
        v = recorded.velocity[:, None] - lost
        x = dt * cumulative_trapezoid(v, initial=0)
    joined: dict[str, Any] = {
        name: np.concatenate([getattr(recorded, name), np.where(recorded.inside, values, 0.0)])
        for name, values in {"x": x, "v": v, "value": deceleration}.items()
    }
    return replace(twice, **joined)
