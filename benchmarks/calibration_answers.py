"""Whether what a fit answers holds what it promises: reliability, comparisons, questions, predictions.

    .venv/bin/python benchmarks/calibration_answers.py
    .venv/bin/python benchmarks/calibration_answers.py clinic

So often a study is drawn from the model of calibration-answers.toml, top down: eight people, women and men
in turn, hit on both sides in three conditions, two of them at one mass, in one of three sessions. Of each
of the 48 impacts log K and log C are measured with normal errors of known standard deviations, which stand
in the place of what a trace says: Gaussian sites that are exact. The population is sampled and labelled as
a fit does it, and asked everything; traces are the business of calibration.py. Of each 90 % interval it is
noted whether the truth lies below, in or above it, and of each claim its probability and whether it is
true. With truths that are drawn from the model's own priors 90 % intervals must hold 90 % of them, and of
the claims of probability p a share p must be true.

What is true is worked out here from what was drawn, without the program's answers: values at levels by
solving for the drawn expectations of the impacts, variances from the drawn spreads, and new impacts by
drawing them, their peaks from the motion of a spring and damper written out.

`clinic` is a trial of ten people, treated and control in turn, before and after, on both sides, by two
masses: calibration-clinic.toml. Every comparison is asked of it, among them each person's before and after
and every interaction, and every level.

A row a study has all answers.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import xarray as xr
from calibration import SAMPLES, blank, drawing
from evidence import recorded
from evidence.simulations import tables
from jax import Array
from numpyro.diagnostics import split_gelman_rubin
from numpyro.distributions import biject_to
from numpyro.infer import HMC
from scipy.constants import g as standard_gravity
from studies import ends

from bayestissue.base import runtime
from bayestissue.inference.answers.contrasts import Contrasts, contrasts_table
from bayestissue.inference.answers.predictions import QUANTITIES, predict
from bayestissue.inference.answers.questions import ask, numbered
from bayestissue.inference.answers.reliability import (
    ICC,
    MDC,
    REPEATS,
    SEM,
    as_variables,
    coefficients,
    reliability,
)
from bayestissue.inference.answers.study import Study
from bayestissue.inference.execution.compiling import by_row
from bayestissue.inference.quantities.quantity_draws import drawn_from_prior
from bayestissue.inference.results.labels import design_variables, labelled
from bayestissue.model.hierarchy.derived import (
    effects_by_name,
    formula_quantities,
    level_quantities,
    new_impact,
)
from bayestissue.model.hierarchy.gaussian.arrangement import expected
from bayestissue.model.hierarchy.gaussian.effects import SitesByCell, effects_from_standard
from bayestissue.model.hierarchy.gaussian.factor import GaussianFactor
from bayestissue.model.hierarchy.responses import RESPONSES
from bayestissue.model.hierarchy.trace_data import Prepared
from bayestissue.model.hierarchy.trace_models import TraceModel, hyperparameters_at, sites_by_cell

SEED = 2028
TRIALS = tables(__file__)
REFERENCE_KG = 0.7
DETECTABLE, EQUIVALENCE = 1.96 * np.sqrt(2), 0.1
# Of the log of K and of C given one trace, and the correlation of the two errors.
MEASUREMENT_SD, CORRELATION = {"K": 0.05, "C": 0.08}, -0.5
WARMUP, DRAWS, LEAPFROGS, BLOCK = 400, 800, 8, 50
# A study whose chain has not converged is sampled again, so often.
MOST_RHAT, PASSES = 1.02, 5
# Parts of the variance of a measurement about the person's value: by agreement, by consistency, of a repeat,
# of what the person does.
PARTS = {
    "A": ("subject_side", "trial", "session", "impact", "chain"),
    "C": ("subject_side", "impact", "chain"),
    "R": ("impact", "chain"),
    "person": ("impact",),
}

Levels = Mapping[str, str | float]
# What is kept of an answer, as "kind of answer|which|what", and its number.
Lines = Iterator[tuple[str, float]]


@dataclass(frozen=True)
class World:
    """What was drawn of one study.

    Attributes:
        trial: what was simulated, a table of calibration_answers.toml.
        columns: of the formula's covariates, at levels all of which are given.
        fixed: of K and of C the coefficients of the columns.
        effects: of each group and response, by level.
        sd: the standard deviations and the correlation, by name.
        sessions: how many a person came to, the median.
        random: of new levels and impacts.
    """

    trial: Mapping[str, Any]
    columns: Callable[[Levels], np.ndarray]
    fixed: dict[str, np.ndarray]
    effects: dict[tuple[str, str], dict[str, float]]
    sd: dict[str, float]
    sessions: float
    random: np.random.Generator

    def complete(self, at: Levels) -> dict[str, Any]:
        """What belongs to a person follows the person; other numbers are at their mean."""
        known = dict(at)
        for name, values in self.trial["people"].items():
            if "subject" in at:
                known[name] = values[(int(str(at["subject"])[1:]) - 1) % len(values)]
            elif name not in self.trial["averaged"]:
                known.setdefault(name, np.mean(values))
        return known

    def log(self, q: str, new: bool = False, **at: Any) -> float:
        """Expected log at some levels, averaged over categories that are not given.

        Groups that are not given are typical, or ``new``; of a person's sides the average.
        """
        at = self.complete(at)
        free = {name: levels for name, levels in self.trial["averaged"].items() if name not in at}
        every = [at | dict(zip(free, levels, strict=True)) for levels in product(*free.values())]
        found = float(np.mean([self.columns(each) @ self.fixed[q] for each in every]))
        for group in self.trial["groups"]:
            effects = self.effects[group, q]
            levels = {":".join(str(each.get(name, "")) for name in group.split(":")) for each in every}
            if known := [effects[level] for level in sorted(levels) if level in effects]:
                found += float(np.mean(known))
            elif new:
                found += self.sd[f"sd_{group.replace(':', '_')}_{q}"] * self.random.standard_normal()
        return found

    def value(self, q: str, **at: Any) -> float:
        """K, C, or an outcome of the reference impact, at some levels."""
        if q in RESPONSES:
            return float(np.exp(self.log(q, **at)))
        velocity = np.mean([one["velocity_m_s"] for one in self.trial["design"]["conditions"]])
        return outcomes_of(self.value("K", **at), self.value("C", **at), REFERENCE_KG, float(velocity))[q]

    def over(self, q: str, upper: Levels, lower: Levels) -> float:
        """Ratio of K, of C or of an outcome at some levels to that at others."""
        return self.value(q, **upper) / self.value(q, **lower)

    def people(self, q: str, **at: Any) -> list[float]:
        """K or C of each person."""
        return [self.value(q, subject=level, **at) for level in self.effects["subject", q]]

    def variance(self, part: str, q: str) -> float:
        """Of log K or log C by a group, by impact, or by the measuring chain of one trace."""
        return (MEASUREMENT_SD[q] if part == "chain" else self.sd[f"sd_{part}_{q}"]) ** 2

    def error(self, q: str, form: str, *, averaged: bool = False) -> float:
        """Variance of one measurement, or of all six of a person: both sides in three conditions."""
        times = {"subject_side": 2, "trial": 3, "session": self.sessions, "impact": 6, "chain": 6}
        return sum(self.variance(part, q) / (times[part] if averaged else 1) for part in PARTS[form])

    def icc(self, q: str, form: str, *, averaged: bool = False) -> float:
        """Intraclass correlation of one measurement, or of all six of a person."""
        people = self.variance("subject", q)
        return people / (people + self.error(q, form, averaged=averaged))

    def new_impact(self, at: Levels) -> dict[str, float]:
        """K, C and the peaks of one new impact."""
        scatter = self.random.standard_normal(2)
        r = self.sd["residual_correlation"]
        scatter[1] = r * scatter[0] + np.sqrt(1 - r**2) * scatter[1]
        K, C = (
            np.exp(self.log(q, new=True, **at) + self.sd[f"sd_impact_{q}"] * z)
            for q, z in zip("KC", scatter, strict=True)
        )
        return {"K": K, "C": C} | outcomes_of(K, C, float(at["mass_kg"]), float(at["velocity_m_s"]))


def _log_mass(at: Levels) -> float:
    return float(np.log(float(at.get("mass_kg", REFERENCE_KG)) / REFERENCE_KG))


def _columns(at: Levels) -> np.ndarray:
    return np.array([1.0, _log_mass(at), at["side"] == "right", at["sex"] == "m"], float)


def _clinic_columns(at: Levels) -> np.ndarray:
    treated, after, right = at["group"] == "treated", at["session"] == "after", at["side"] == "right"
    age = float(at["age"]) - np.mean(TRIALS["clinic"]["people"]["age"])
    return np.array([1.0, _log_mass(at), treated, after, treated * after, right, right * after, age], float)


def outcomes_of(K: float, C: float, M: float, V: float) -> dict[str, float]:
    """What an impact without gravity comes to, by the names of `QUANTITIES`.

    M x'' + C x' + K x = 0 starts at 0 with V. x is greatest at t, where s_0 exp(s_0 t) = s_1 exp(s_1 t), and
    x'' is 0 at 2 t, where the impactor leaves.
    """
    s = np.roots([M, C, K]).astype(complex)

    def derivative(order: int, t: Any) -> Any:
        """Of x by time."""
        return (
            V * (s[0] ** order * np.exp(s[0] * t) - s[1] ** order * np.exp(s[1] * t)) / (s[0] - s[1])
        ).real

    time = float((np.log(s[1] / s[0]) / (s[0] - s[1])).real)
    end = -float(derivative(1, 2 * time))
    force = -M * float(derivative(2, np.linspace(0.0, time, 2001)).min())
    return {
        "peak_depth": float(derivative(0, time)),
        "peak_force": force,
        "time_to_peak": time,
        "peak_deceleration": force / (M * standard_gravity),
        "contact_duration": 2 * time,
        "rebound_velocity": end,
        "restitution": end / V,
        "energy_absorbed": M * (V**2 - end**2) / 2,
    }


def world_of(
    kind: str, base: Prepared, drawn: Mapping[str, np.ndarray], random: np.random.Generator
) -> World:
    """Of what was drawn of a study, see `World`."""
    trial, columns = TRIALS[kind], COLUMNS[kind]
    rows, model, b = base.impacts, base.model, drawn["locations"]
    about = np.asarray(expected(base.data.design, b))[:2, : len(rows)]
    fixed, effects = {}, {}
    table = np.stack([columns(row) for row in rows.to_dict("records")])
    for left, q in zip(about.copy(), "KC", strict=True):
        for group in trial["groups"]:
            grouping = base.design.groupings[group]
            own = b[model.locations.parts[f"{group.replace(':', '_')}_effect_{q}"]]
            left -= own[grouping.code]
            effects[group, q] = dict(zip(grouping.levels, own.tolist(), strict=False))
        fixed[q], miss, *_ = np.linalg.lstsq(table, left)
        assert miss.sum() < 1e-12
    sd = {name: float(drawn[name]) for name in model.hyperparameters}
    sessions = float(rows.groupby("subject")["session"].nunique().median())
    return World(trial, columns, fixed, effects, sd, sessions, random)


QUESTIONS: dict[str, Callable[[World], bool | float]] = {
    "K[side=left] / K[side=right] > 1.1": lambda w: w.over("K", {"side": "left"}, {"side": "right"}) > 1.1,
    "C[sex=f] < C[sex=m]": lambda w: w.over("C", {"sex": "f"}, {"sex": "m"}) < 1,
    "K[subject=s01] > K[subject=s02]": lambda w: w.over("K", {"subject": "s01"}, {"subject": "s02"}) > 1,
    "abs(log(K[subject=s04, side=left] / K[subject=s04, side=right])) < 0.1": lambda w: (
        abs(np.log(w.over("K", *({"subject": "s04", "side": side} for side in ("left", "right"))))) < 0.1
    ),
    "max(C[subject]) > 1.5 * min(C[subject])": lambda w: max(w.people("C")) > 1.5 * min(w.people("C")),
    "K[trial=t1] > K[trial=t2] and C[trial=t1] > C[trial=t2]": lambda w: all(
        w.over(q, {"trial": "t1"}, {"trial": "t2"}) > 1 for q in "KC"
    ),
    "not K[session=d1] between 2900 and 3100": lambda w: not 2900 <= w.value("K", session="d1") <= 3100,
    "mass_exponent_K > 0.5": lambda w: w.fixed["K"][1] > 0.5,
    "ICC_A1_K > 0.75": lambda w: w.icc("K", "A") > 0.75,
    "ICC_C1_C > 0.5 or ICC_C1_K > 0.5": lambda w: max(w.icc("C", "C"), w.icc("K", "C")) > 0.5,
    "relative_MDC95_A_K < 60": lambda w: np.expm1(DETECTABLE * np.sqrt(w.error("K", "A"))) < 0.6,
    "K_new > 3000": lambda w: w.new_impact({"mass_kg": REFERENCE_KG, "velocity_m_s": 1.0})["K"] > 3000,
    "K[mass_kg=1.2]": lambda w: w.value("K", mass_kg=1.2),
    "log(C[subject=s08] / C[subject=s07]) / mass_exponent_C ^ 2": lambda w: (
        np.log(w.over("C", {"subject": "s08"}, {"subject": "s07"})) / w.fixed["C"][1] ** 2
    ),
    "mean(K[subject, side=right]) - mean(K[subject, side=left])": lambda w: (
        np.mean(w.people("K", side="right")) - np.mean(w.people("K", side="left"))
    ),
}


def lines_of(finished: Study, reliable: pd.DataFrame, world: World) -> Lines:
    """Of every answer what is to be kept."""
    yield from _of_reliability(reliable, world)
    for row in contrasts_table(Contrasts(finished), EQUIVALENCE).to_dict("records"):
        upper, lower = _sides(row)
        if upper.get("subject", "s01") == "s01":
            yield from _of_ratio("comparison", row, world.over(row["quantity"], upper, lower))
    for row in ask(finished, numbered(QUESTIONS)).to_dict("records"):
        truth = float(QUESTIONS[row["question"]](world))
        name = f"question|{row['question']}"
        if np.isfinite(row["median"]):
            yield f"{name}|interval", _side(row, truth)
        else:
            yield from {
                f"{name}|p": row["posterior"],
                f"{name}|prior": row["prior"],
                f"{name}|true": truth,
            }.items()
    yield from _of_levels(finished.draws, world)
    predicted = world.trial["predicted"]
    made = predict(finished, list(predicted.values())).to_dict("records")
    for (which, at), row in zip(predicted.items(), made, strict=True):
        for q, truth in world.new_impact(at).items():
            low_high = {end: row[f"{QUANTITIES[q]}_{end}"] for end in ("low", "high")}
            yield f"prediction|{q} {which}|interval", _side(low_high, truth)


def clinic_lines(finished: Study, _: pd.DataFrame, world: World) -> Lines:
    """The same of a trial: every comparison, its interactions by the differences of what was drawn."""
    for row in contrasts_table(Contrasts(finished), EQUIVALENCE).to_dict("records"):
        q = row["quantity"]
        if row["kind"] == "interaction":
            upper, lower = _sides(row)
            outer, inner = upper
            levels = upper[inner].split("/")
            ratios = [
                world.over(q, *({outer: side[outer], inner: level} for level in levels))
                for side in (upper, lower)
            ]
            yield from _of_ratio("interaction", row, ratios[0] / ratios[1])
        else:
            yield from _of_ratio(f"comparison of {row['kind']}", row, world.over(q, *_sides(row)))
    yield from _of_levels(finished.draws, world)


def _sides(row: Mapping[str, Any]) -> list[dict[str, str]]:
    """The levels that a comparison compares, by factor."""
    names = row["factor"].split(":")
    return [dict(zip(names, row[side].split(":"), strict=True)) for side in ("level", "against")]


def _of_levels(posterior: xr.Dataset, world: World) -> Lines:
    """K and C in their units of a typical person, and of levels such as sides, people, people's sides."""
    for q, stem in product(RESPONSES, world.trial["levels"]):
        array = posterior[f"{q}_{stem}"]
        (factor,) = {str(name) for name in array.dims} - {"chain", "draw"} or {""}
        labels = array[factor].to_numpy().astype(str) if factor else [""]
        for label, low, high in zip(labels, *np.atleast_2d(ends(array).T).T, strict=True):
            at = dict(zip(factor.split(":"), label.split(":"), strict=True)) if factor else {}
            side = _side({"low": low, "high": high}, world.value(q, **at))
            yield f"level|{f'{q} of {stem} {label}'.rstrip()}|interval", side


def _of_reliability(reliable: pd.DataFrame, world: World) -> Lines:
    for row in reliable.to_dict("records"):
        q, measure, form = (str(row[name]) for name in ("quantity", "measure", "form"))
        if form == "measuring chain":
            continue
        word, _, averaged = form.partition(", means of ")
        letter = {"agreement": "A", "consistency": "C", "repeat": "R"}.get(
            word, form[4:5] if "ICC" in form else form
        )
        if measure == ICC:
            truth = world.icc(q, letter, averaged=",k)" in form)
        elif measure in (SEM, MDC):
            factor = 1.0 if measure == SEM else DETECTABLE
            relative = float(np.expm1(factor * np.sqrt(world.error(q, letter, averaged=bool(averaged)))))
            truth = 100 * relative if row["unit"] == "%" else relative * world.value(q)
        else:
            assert measure == REPEATS
            target, one = float(form.split()[-1]), world.icc(q, letter)
            truth = max(1.0, np.ceil(target / (1 - target) * (1 - one) / one))
        yield f"reliability|{q}, {measure}, {form}, {row['unit']}|interval", _side(row, truth)


def _of_ratio(kind: str, row: Mapping[str, Any], truth: float) -> Lines:
    which = f"{kind}|{row['factor']} {row['level']} over {row['against']}, {row['quantity']}"
    yield f"{which}|interval", _side(row, truth)
    yield f"{which}, direction|p", row["p_direction"]
    yield f"{which}, direction|true", float((truth > 1) == (row["ratio"] > 1))
    if "p_equivalent" in row:
        yield f"{which}, equivalent|p", row["p_equivalent"]
        yield f"{which}, equivalent|true", float(abs(np.log(truth)) < np.log1p(EQUIVALENCE))


def _side(row: Mapping[str, Any], truth: float) -> float:
    """-1 where the truth lies below an interval, 0 within it, 1 above."""
    return float(truth > row["high"]) - float(truth < row["low"])


COLUMNS = {"answers": _columns, "clinic": _clinic_columns}
ASKED = {"answers": lines_of, "clinic": clinic_lines}


@by_row(64, constant=2)
def effects_of_sites(
    model: TraceModel, data: SitesByCell, y: Array, standard: Array
) -> tuple[dict[str, Array], Array]:
    """Hyperparameters by name and a draw of b, the sites standing for the traces."""
    hyperparameters = hyperparameters_at(model, y)[0]
    effects, _ = data.integrated(model.covariances(hyperparameters))
    return hyperparameters, effects_from_standard(data.design, effects, data.mean, standard)


class Studies:
    """Studies of one design: drawn, sampled and asked."""

    def __init__(self, kind: str) -> None:
        self._kind, trial = kind, TRIALS[kind]
        self._base = base = blank(kind, trial["people"], **trial["design"])
        self._draw, self._sample = drawing(base), jax.jit(jax.vmap(self._chain))
        (drawn, b), _ = drawn_from_prior(base.model, base.data, jax.random.PRNGKey(SEED))
        self._prior = self._labelled(drawn, b, np.random.default_rng(SEED))
        zeros = np.zeros((len(base.impacts), 3))
        sites = GaussianFactor(zeros, zeros, np.broadcast_to(np.eye(3), (len(zeros), 3, 3)), zeros[:, 0])
        self._cells = sites_by_cell(base.data, sites)

    def converged(self, numbers: Sequence[int]) -> list[dict[str, float]]:
        """`rows` of these studies; those whose chain has not converged are sampled again from elsewhere."""
        rows: dict[float, dict[str, float]] = {}
        for attempt in range(PASSES):
            if len(rows) < len(numbers):
                found = {
                    row["data_set"]: row for row in self.rows(numbers, attempt) if row["rhat"] < MOST_RHAT
                }
                rows |= {number: row for number, row in found.items() if number not in rows}
        return list(rows.values())

    def rows(self, numbers: Sequence[int], attempt: int = 0) -> Iterator[dict[str, float]]:
        """What is kept of each answer to these studies, by "kind|which|what"; they are sampled together."""
        randoms = [np.random.default_rng([SEED, number]) for number in numbers]
        keys = [jax.random.fold_in(jax.random.PRNGKey(SEED), number) for number in numbers]
        worlds = [
            {name: np.asarray(v[0]) for name, v in self._draw(key, self._base.data).items()} for key in keys
        ]
        every = [
            sites_by_cell(self._base.data, sites_of(drawn, random))
            for drawn, random in zip(worlds, randoms, strict=True)
        ]
        laid = jax.tree.map(lambda *each: jnp.stack(each), *(data.sites for data in every))
        # Chains begin at draws of the prior, those of another study.
        begin = np.roll([self._raw(drawn) for drawn in worlds], 1 + attempt, axis=0)
        raw = np.asarray(self._sample(begin, laid, jnp.stack(keys)))
        for number, chain, data, drawn, random in zip(numbers, raw, every, worlds, randoms, strict=True):
            posterior = self._posterior(chain, data, random)
            asked = self._asked(posterior, world_of(self._kind, self._base, drawn, random))
            yield {"data_set": number, "rhat": float(split_gelman_rubin(chain[None]).max())} | asked

    def _chain(self, begin: Array, laid: GaussianFactor, key: Array) -> Array:
        """Hamiltonian Monte Carlo on the marginal density of a fit, [draw, hyperparameter], unconstrained."""
        data, model = replace(self._cells, sites=laid), self._base.model

        def potential(y: Array) -> Array:
            hyperparameters, log_prior = hyperparameters_at(model, y)
            return -log_prior - data.integrated(model.covariances(hyperparameters))[1]

        kernel = HMC(potential_fn=potential, num_steps=LEAPFROGS, trajectory_length=None)
        state = kernel.init(key, WARMUP, begin, (), {})
        step = lambda state, _: ((moved := kernel.sample(state, (), {})), moved.z)  # noqa: E731
        return jax.lax.scan(step, state, None, WARMUP + DRAWS)[1][WARMUP:]

    def _raw(self, drawn: Mapping[str, np.ndarray]) -> list[float]:
        model = self._base.model
        return [
            float(biject_to(model.prior_of(name).support).inv(drawn[name])) for name in model.hyperparameters
        ]

    def _posterior(self, raw: np.ndarray, data: SitesByCell, random: np.random.Generator) -> xr.Dataset:
        model = self._base.model
        standard = random.standard_normal((len(raw), model.locations.size))
        hyperparameters, b = effects_of_sites(model, data, raw, standard)
        # Halves of the chain as two.
        two = {name: values.reshape(2, -1) for name, values in hyperparameters.items()}
        return self._labelled(two, b.reshape(2, -1, b.shape[-1]), random)

    def _labelled(
        self, hyperparameters: dict[str, np.ndarray], b: np.ndarray, random: np.random.Generator
    ) -> xr.Dataset:
        """As `posterior_tree` has the population's quantities."""
        design = self._base.design
        population = hyperparameters | effects_by_name(self._base.model.locations, design, b)
        arrays = formula_quantities(design, population)
        levels = level_quantities(design, arrays)
        arrays |= levels | new_impact(design, population, levels, random)
        return labelled(arrays, design.levels(), design_variables(design))

    def _asked(self, posterior: xr.Dataset, world: World) -> dict[str, float]:
        every, groups, recorded = [], [], self._base.design.recorded
        for draws in (posterior, self._prior):
            every.append(coefficients(draws, recorded, MEASUREMENT_SD))
            groups.append(draws.merge(as_variables(every[-1])))
        finished = Study(groups[0], recorded, prior=groups[1])
        return dict(ASKED[self._kind](finished, reliability(*every), world))


def sites_of(drawn: Mapping[str, np.ndarray], random: np.random.Generator) -> GaussianFactor:
    """What measurements of all impacts say: each a normal about the truth and its own error."""
    truth = np.column_stack([drawn["log_K_and_C"], drawn["noise"]])
    covariance = np.diag([*MEASUREMENT_SD.values(), 1 / np.sqrt(2 * SAMPLES)]) ** 2
    covariance[0, 1] = covariance[1, 0] = CORRELATION * np.prod([*MEASUREMENT_SD.values()])
    seen = truth + random.multivariate_normal(np.zeros(3), covariance, len(truth))
    precision = np.broadcast_to(np.linalg.inv(covariance), (len(truth), 3, 3)).copy()
    return GaussianFactor(seen, np.zeros_like(seen), precision, np.zeros(len(seen)))


def main() -> None:
    kind = sys.argv[1] if len(sys.argv) > 1 else "answers"
    runtime.configure()
    with recorded(f"calibration_{kind}") as record:
        studies = Studies(kind)
        for first in record.missing(range(0, TRIALS[kind]["studies"], BLOCK)):
            record.add(first, studies.converged(range(first, first + BLOCK)))


if __name__ == "__main__":
    main()
