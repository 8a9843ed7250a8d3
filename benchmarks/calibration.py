"""Simulation-based calibration (Talts et al. 2018) of the chain by which `bayestissue fit` samples.

    .venv/bin/python benchmarks/calibration.py arma
    .venv/bin/python benchmarks/calibration.py designs

So often the standard deviations, the population, each impact's parameters and trace are drawn from the model
itself, top down, and the draw is fitted. If that samples the posterior, the rank of each drawn value among 99
thinned draws is uniform. The design is that of coverage.py; a trace has 110 samples. Its
first two displacements are 0 and V dt whatever K and C are: the likelihood is conditional on them, so they
must tell nothing of what is drawn. Models: calibration-*.toml.

`designs` is a design with two sides a person, sessions, and people's own mass exponents: five people are hit
on two sides in four conditions, each impact in one of four sessions. Of the effects the first level's are
ranked, and the first person's own mass exponent. In `shared` all impacts of a person have one error of mass,
as where part of the person moves along.

A row a data set has the ranks, and whether the chains passed.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from types import MappingProxyType
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import numpyro
import pandas as pd
from coverage import campaign
from evidence import measure
from evidence.simulations import tables
from numpyro.infer import Predictive

from bayestissue.inference.fit import sample
from bayestissue.inference.quantities.quantity_draws import posterior_draws
from bayestissue.model.hierarchy.specification import Sampler, read_specification
from bayestissue.model.hierarchy.trace_data import Prepared, prepare
from bayestissue.model.hierarchy.trace_models import TraceData, impacts_model, trace_likelihood
from bayestissue.model.likelihood.displacements import displacement_record
from bayestissue.model.likelihood.record import DecelerationRecord
from bayestissue.studies.simulation import simulate

# A rank's standard deviation is known to 5 % of itself, that of all 40 quantities together to a percent.
SAMPLES, RANKS, DATA_SETS = 110, 100, 80
TABLES = tables(__file__)
# Of four chains, which agree sooner than two, twice as many effective draws as there are ranks.
SAMPLER = Sampler(chains=4, draws=150, effective=200)
HERE = Path(__file__).parent


def with_traces(prepared: Prepared, traces: np.ndarray) -> Prepared:
    """The same model and design with these traces in the place of the recorded ones."""
    record, signal = prepared.data.record, prepared.signal
    count = len(traces)
    n_samples, first, dt = np.full(count, SAMPLES), np.zeros(count), np.asarray(record.dt)
    error_sd = np.asarray(record.error_sd)
    if isinstance(record, DecelerationRecord):
        velocity = np.asarray(record.velocity)
        known = (record.mass, record.surroundings, record.contact)
        made = DecelerationRecord.from_arrays(traces, n_samples, first, dt, velocity, error_sd, *known)
        # First guesses, from which the summaries start, ask for the motion.
        v = velocity[:, None] - np.cumsum(traces, axis=1) * dt[:, None]
        x = np.cumsum(v, axis=1) * dt[:, None]
        motion = {"x": x, "v": v, "value": traces}
    else:
        made = displacement_record(traces, n_samples, first, dt, error_sd)
        motion = {"x": traces, "value": np.zeros_like(traces)}
    noise = np.exp(np.asarray(prepared.data.log_peak) + prepared.model.priors.noise.mean)
    contact, quiet = signal.contact._replace(since_s=first), signal.quiet._replace(noise_sd=noise)
    times = {"n_samples": n_samples, "sample_number": None, "clipped": np.zeros_like(traces)}
    signal = replace(signal, **motion, **times, contact=contact, quiet=quiet)
    return replace(prepared, data=replace(prepared.data, record=made), signal=signal)


def blank(kind: str, people: Mapping[str, Sequence[str]] = MappingProxyType({}), **design: Any) -> Prepared:
    """Model, design and measuring chain, with traces of which only the start is told.

    ``design`` replaces parts of the design of coverage.py, and ``people`` has further columns of the
    impacts, whose values people take in turn.
    """
    specification, own = read_specification(HERE / f"calibration-{kind}.toml"), TABLES.get(kind, {})
    made = campaign("impact", 0)
    changed = {**made.design.model_dump(), "factors": own.get("factors", ()), **design}
    made = made.model_copy(update={"design": type(made.design).model_validate(changed)})
    dataset = simulate(made).dataset("calibration")
    person = pd.factorize(dataset.impacts["subject"])[0]
    columns = {name: np.resize(values, person.max() + 1)[person] for name, values in people.items()}
    uncertainty = dataset.uncertainty.model_copy(update=own.get("uncertainty", {}))
    dataset = replace(dataset, impacts=dataset.impacts.assign(**columns)).with_settings(
        uncertainty=uncertainty
    )
    prepared = prepare(dataset, specification, source="the model file")
    start = np.zeros((len(prepared.impacts), SAMPLES))
    start[:, 1] = prepared.signal.velocity * prepared.signal.dt
    return with_traces(prepared, start)


def drawing(base: Prepared) -> Callable[..., Any]:
    """What draws everything from the model top down, compiled."""

    def drawn(data: TraceData) -> None:
        u = impacts_model(base.model, data)
        trace, *_ = trace_likelihood(base.model, data, u).replicate(numpyro.prng_key()).values()
        numpyro.deterministic("trace", jnp.nan_to_num(trace))

    return jax.jit(Predictive(drawn, num_samples=1))


@cache
def of_kind(kind: str) -> tuple[Prepared, Callable[..., Any], list[str]]:
    """The study without traces, what draws it, and the parts of b whose first effects are ranked."""
    base = blank(kind)
    groups = [
        term.effect(q)
        for q in "KC"
        for term in base.design.responses[q].terms
        if term.grouping != "trial" and "factors" in TABLES[kind]
    ]
    return base, drawing(base), groups


def ranks_of_one(kind: str, number: int) -> dict[str, float]:
    """The ranks of one drawn data set; of each part of b among the groups that of its first effect."""
    base, draw, groups = of_kind(kind)
    model, key = base.model, jax.random.fold_in(jax.random.PRNGKey(TABLES[kind]["seed"]), number)
    drawn = {name: np.asarray(value[0]) for name, value in draw(key, base.data).items()}
    prepared = with_traces(base, drawn["trace"])
    chains = sample(prepared, SAMPLER, number)
    found = posterior_draws(prepared, chains.thinned(SAMPLER.draws), number)
    truth = {name: drawn[name] for name in model.hyperparameters}
    posterior = {name: found.population[name] for name in model.hyperparameters}
    for name in ("intercept_K", "intercept_C", "mass_exponent_K", "mass_exponent_C", *groups):
        truth[name] = drawn["locations"][model.locations.parts[name]][0]
        posterior[name] = found.population[name][..., 0] if name in groups else found.population[name]
    for name in groups:
        if name.startswith(stem := "subject_mass_exponent_deviation"):
            for values in (truth, posterior):
                q = name.removeprefix(f"{stem}_")
                values[f"subject_mass_exponent_{q}"] = values.pop(name) + values[f"mass_exponent_{q}"]
    first = np.concatenate([drawn["log_K_and_C"][0], [drawn[name][0] for name in model.nuisance]])
    for i, name in enumerate(("K", "C", *model.nuisance)):
        truth[f"{name} of an impact"] = first[i]
        posterior[f"{name} of an impact"] = found.impacts["parameters"][..., 0, i]
    return {name: _rank(posterior[name], truth[name]) for name in truth} | {"passed": chains.verdict.passed}


def _rank(draws: np.ndarray, truth: np.ndarray) -> int:
    thin = draws.shape[0] * draws.shape[1] // RANKS
    return int((draws[:, ::thin].reshape(-1)[: RANKS - 1] < truth).sum())


def main() -> None:
    kind = sys.argv[1]
    measure(f"calibration-{kind}", range(DATA_SETS), partial(ranks_of_one, kind))


if __name__ == "__main__":
    main()
