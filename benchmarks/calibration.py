"""Simulation-based calibration (Talts et al. 2018) of the paths by which `bayestissue fit` samples.

    .venv/bin/python benchmarks/calibration.py arma
    .venv/bin/python benchmarks/calibration.py a2
    .venv/bin/python benchmarks/calibration.py impact
    .venv/bin/python benchmarks/calibration.py designs
    .venv/bin/python benchmarks/calibration.py designs --lane 1 --lanes 2    # a half, beside --lane 2

500 times (`designs`: 300) the standard deviations, the population, each impact's parameters and trace are
drawn from the model itself, top down, and the draw is fitted as `path = "automatic"` does it: through the
summary path, and through the exact one where the correction is not trusted. If that samples the posterior,
the rank of each drawn value among 99 thinned draws is uniform. The design is that of coverage_fit.py; a
trace has 110 samples. Its first two displacements are 0 and V dt whatever K and C are: the likelihood is
conditional on them, so they must tell nothing of what is drawn. Models: calibration-*.toml.

`designs` is a design with two sides a person, sessions, and people's own mass exponents: five people are hit
on two sides in four conditions, each impact in one of four sessions. Of the effects the first level's are
ranked, and the first person's own mass exponent.

Ranks are added to calibration_ranks_*.csv as they are made; the same command goes on where it stopped, and
puts the table of tests into calibration.csv. Ranks that an earlier program made are dropped.
"""

from __future__ import annotations

import argparse
import contextlib
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any

import jax
import numpy as np
import pandas as pd
from coverage_fit import SAMPLER, campaign, kept_with
from evidence import recorded
from numpyro.infer import Predictive
from scipy import stats

from bayestissue import runtime
from bayestissue.hierarchy.specification import Sampler, read_specification
from bayestissue.hierarchy.trace_data import Prepared, prepare
from bayestissue.hierarchy.traces import plain_model
from bayestissue.inference.posterior.constrained_draws import constrained_draws
from bayestissue.inference.posterior.exact import exact_draws
from bayestissue.inference.posterior.recipe import corrected_draws
from bayestissue.likelihood.arma.displacement import displacement_record
from bayestissue.likelihood.element.record import DecelerationRecord
from bayestissue.simulation import simulate

SAMPLES, RANKS, BINS = 110, 100, 20
DATA_SETS = {"arma": 500, "a2": 500, "impact": 500, "designs": 300}
SEEDS = {"arma": 2026, "a2": 2026, "impact": 2026, "designs": 2027}
FACTORS: dict[str, tuple[dict[str, Any], ...]] = {
    "designs": (
        {"name": "side", "levels": ["left", "right"]},
        {"name": "session", "levels": 4, "every": False},
    )
}
EXACT = Sampler(chains=2, warmup=400, draws=500, target_accept=0.9, path="exact")
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
        motion = {"x": x, "v": v, "deceleration": traces}
    else:
        made = displacement_record(traces, n_samples, first, dt, error_sd)
        motion = {"x": traces}
    noise = np.exp(np.asarray(prepared.data.log_peak) + prepared.model.priors.noise.mean)
    signal = replace(signal, **motion, n_samples=n_samples, first_sample_s=first, noise_sd=noise)
    return replace(prepared, data=replace(prepared.data, record=made), signal=signal)


def blank(kind: str, people: Mapping[str, Sequence[str]] = MappingProxyType({}), **design: Any) -> Prepared:
    """Model, design and measuring chain, with traces of which only the start is told.

    ``design`` replaces parts of the design of coverage_fit.py, and ``people`` has further columns of the
    impacts, whose values people take in turn.
    """
    specification = read_specification(HERE / f"calibration-{kind}.toml")
    made = campaign(0)
    changed = {**made.design.model_dump(), "factors": FACTORS.get(kind, ()), **design}
    dataset = simulate(made.model_copy(update={"design": type(made.design).model_validate(changed)})).dataset(
        "calibration"
    )
    person = pd.factorize(dataset.impacts["subject"])[0]
    columns = {name: np.resize(values, person.max() + 1)[person] for name, values in people.items()}
    dataset = replace(dataset, impacts=dataset.impacts.assign(**columns))
    prepared = prepare(dataset, specification, source="the model file")
    start = np.zeros((len(prepared.impacts), SAMPLES))
    start[:, 1] = prepared.signal.velocity * prepared.signal.dt
    return with_traces(prepared, start)


def ranks_file(kind: str) -> Path:
    """Where the ranks of one model are kept."""
    return HERE / f"calibration_ranks_{kind}.csv"


def made_before(file: Path) -> pd.DataFrame:
    """What earlier calls found: each drawn data set once."""
    if not file.is_file():
        return pd.DataFrame({"data_set": []})
    found = pd.read_csv(file).drop_duplicates("data_set")
    return found.sort_values("data_set", ignore_index=True)


def add(file: Path, row: Mapping[str, float]) -> None:
    """Add a line, after a header where there is none; in one write, so that two lanes may share the file."""
    frame = pd.DataFrame([row])
    with contextlib.suppress(FileExistsError), file.open("x", encoding="utf-8") as new:
        new.write(frame.head(0).to_csv(index=False, lineterminator="\n"))
    with file.open("a", encoding="utf-8") as old:
        old.write(frame.to_csv(index=False, header=False, float_format="%.4g", lineterminator="\n"))


def run(kind: str, data_sets: int, seconds: float, lane: int, lanes: int) -> None:
    """Fit the data sets of one lane that no earlier call has fitted."""
    base, begun = blank(kind), time.perf_counter()
    draw, before = drawing(base), set(made_before(ranks_file(kind))["data_set"])
    groups = [
        term.effect(q) for q in "KC" for term in base.design.responses[q].terms if term.grouping != "trial"
    ]
    for number in range(lane - 1, data_sets, lanes):
        if number in before:
            continue
        if time.perf_counter() - begun > seconds:
            break
        made = ranks_of_one(base, draw, number, SEEDS[kind], groups=groups if kind in FACTORS else ())
        add(ranks_file(kind), {"data_set": number} | made)
        print(f"{kind}: data set {number}, {time.perf_counter() - begun:.0f} s", flush=True)


def drawing(base: Prepared) -> Callable[..., Any]:
    """What draws everything from the model top down, compiled."""
    return jax.jit(partial(Predictive(partial(plain_model, base.model), num_samples=1), conditioned=False))


def ranks_of_one(
    base: Prepared, draw: Callable[..., Any], number: int, seed: int, *, groups: Sequence[str] = ()
) -> dict[str, float]:
    """The ranks of one drawn data set; of each part of b in ``groups`` that of its first effect."""
    model, key = base.model, jax.random.fold_in(jax.random.PRNGKey(seed), number)
    drawn = {name: np.asarray(value[0]) for name, value in draw(key, base.data).items()}
    prepared = with_traces(base, drawn["trace"])
    summarised, draws, correction = corrected_draws(prepared, SAMPLER, number)
    if not correction.trusted:
        draws = exact_draws(prepared, summarised, EXACT, number, processes=False)
    found = constrained_draws(prepared, summarised, draws, jax.random.PRNGKey(number))
    truth = {name: drawn[name] for name in model.hyperparameters}
    posterior = {name: found.sites[name] for name in model.hyperparameters}
    for name in ("intercept_K", "intercept_C", "mass_exponent_K", "mass_exponent_C", *groups):
        truth[name] = drawn["locations"][model.locations.parts[name]][0]
        posterior[name] = found.sites[name][..., 0] if name in groups else found.sites[name]
    for q in "KC":
        if f"subject_mass_exponent_deviation_{q}" in groups:
            name = f"subject_mass_exponent_{q}"
            for values in (truth, posterior):
                values[name] = (
                    values.pop(f"subject_mass_exponent_deviation_{q}") + values[f"mass_exponent_{q}"]
                )
    first = np.concatenate([drawn["log_K_and_C"][0], [drawn[name][0] for name in model.nuisance]])
    for i, name in enumerate(("K", "C", *model.nuisance)):
        truth[f"{name} of an impact"] = first[i]
        posterior[f"{name} of an impact"] = found.impacts["parameters"][..., 0, i]
    return {name: _rank(posterior[name], truth[name]) for name in truth} | {"pareto_k": correction.pareto_k}


def _rank(draws: np.ndarray, truth: np.ndarray) -> int:
    thin = draws.shape[0] * draws.shape[1] // RANKS
    return int((draws[:, ::thin].reshape(-1)[: RANKS - 1] < truth).sum())


def envelope(number: int, simulations: int = 4000) -> np.ndarray:
    """The least pointwise p-value along an ECDF of uniform ranks, simulated (Säilynoja et al. 2022)."""
    drawn = np.random.default_rng(0).integers(RANKS, size=(simulations, number))
    return np.array([_least(row) for row in drawn])


def _least(found: np.ndarray) -> float:
    below = np.cumsum(np.bincount(found, minlength=RANKS))[:-1]
    share = np.arange(1, RANKS) / RANKS
    tails = stats.binom.cdf(below, len(found), share), stats.binom.sf(below - 1, len(found), share)
    return float(2 * np.minimum(*tails).min())


def table(kind: str, found: pd.DataFrame, command: str) -> pd.DataFrame:
    """One line per quantity: chi-square over 20 bins, and the ECDF's simultaneous test."""
    reference, lines = envelope(len(found)), []
    for name in found.columns.drop("pareto_k"):
        rank = found[name].to_numpy()
        counts = np.bincount(rank * BINS // RANKS, minlength=BINS)
        lines.append(
            {
                "likelihood": kind,
                "quantity": name,
                "data_sets": len(rank),
                "chi_square_p": round(float(stats.chisquare(counts).pvalue), 4),
                "ecdf_p": round(float((reference <= _least(rank)).mean()), 4),
                "mean_rank": round(float(rank.mean() / (RANKS - 1)), 4),
                "sd_rank_over_uniform": round(float(rank.std() / np.sqrt((RANKS**2 - 1) / 12)), 4),
                "pareto_k_above_0.7": int((found["pareto_k"] >= 0.7).sum()),
                "command": command,
            }
        )
    return pd.DataFrame(lines)


def figure(found: dict[str, pd.DataFrame]) -> None:
    """ECDF of each quantity's ranks less the uniform one, in the envelope that holds 95 % of whole curves."""
    from matplotlib.figure import Figure

    names = list(
        dict.fromkeys(name for ranks in found.values() for name in ranks.columns if name != "pareto_k")
    )
    page = Figure(figsize=(11, 2 * -(-len(names) // 4)), layout="constrained")
    axes = page.subplots(-(-len(names) // 4), 4, sharex=True, sharey=True).reshape(-1)
    share = np.arange(1, RANKS) / RANKS
    number = min(len(ranks) for ranks in found.values())
    level = np.quantile(envelope(number), 0.05)
    low, high = (stats.binom.ppf(p, number, share) / number - share for p in (level / 2, 1 - level / 2))
    for axis, name in zip(axes, names, strict=False):
        axis.fill_between(share, low, high, color="0.9")
        for kind, ranks in found.items():
            if name in ranks:
                below = np.cumsum(np.bincount(ranks[name], minlength=RANKS))[:-1]
                axis.plot(share, below / len(ranks) - share, lw=1, label=kind)
        axis.set_title(name, fontsize=8)
    for axis in axes[len(names) :]:
        axis.set_visible(False)
    axes[0].legend(fontsize=7)
    page.supxlabel("rank / 100")
    page.supylabel("share of ranks below, less the uniform share")
    page.savefig(HERE / "calibration.svg", metadata={"Date": None})


def main() -> None:
    parser = argparse.ArgumentParser(description="Simulation-based calibration of fits.")
    parser.add_argument("model", choices=list(DATA_SETS))
    parser.add_argument("--data-sets", type=int, help="in all, those of earlier calls too")
    parser.add_argument("--seconds", type=float, default=np.inf, help="begin no data set after these")
    parser.add_argument("--lane", type=int, default=1, help="which share of the data sets, from 1")
    parser.add_argument("--lanes", type=int, default=1, help="how many shares there are")
    asked = parser.parse_args()
    runtime.configure()
    with recorded(f"calibration-{asked.model}") as record:
        run(asked.model, asked.data_sets or DATA_SETS[asked.model], asked.seconds, asked.lane, asked.lanes)
        if left := DATA_SETS[asked.model] - len(made_before(ranks_file(asked.model))):
            record.left = f"{left} of {DATA_SETS[asked.model]} data sets"
        write(asked.model)


def write(model: str) -> None:
    """Put the tests of one model into the table, and draw the figure of all."""
    found = {kind: made_before(ranks_file(kind)).drop(columns="data_set") for kind in DATA_SETS}
    figure({kind: ranks for kind, ranks in found.items() if len(ranks)})
    count = len(found[model])
    command = f"benchmarks/calibration.py {model}"
    command += f" --data-sets {count}" if count != DATA_SETS[model] else ""
    kept_with(HERE / "calibration.csv", table(model, found[model], command), "likelihood")


if __name__ == "__main__":
    main()
