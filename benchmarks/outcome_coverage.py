"""How often 90 % intervals of what impacts come to hold it, and what probabilities of being best are worth.

    .venv/bin/python benchmarks/outcome_coverage.py stiffening
    .venv/bin/python benchmarks/outcome_coverage.py stiffening 20

Simulated studies of one element, fitted: four people hit by a headform on both sides with two masses along
gravity, 16 impacts. K and C vary by person, by the person's side, with the mass, and by impact. A study's
typical values, exponents and spreads are drawn from the priors that its fit is given, so that 90 % of all
90 % intervals hold the truth, and a share p of what has the probability p is true, if the program is right.

Of each study the intervals of every outcome are noted of its impacts; of each person's left side hit half as
fast again as any impact that was recorded, and by another mass; and of a new impact like that on a new
person, of whom as many are drawn as there are people. Which person, and which side of the first, such an
impact hits with the lowest peak force has a probability of each. What is true comes of scipy's integration
of the equations written out here, without the program's elements.

A row a study has of each outcome the shares of intervals that lie below and above the truth, and of each
level the probability of being best and whether it is. A number behind the element's name is of the studies
to do in all, fewer than there are: studies that were done are not done again. Shares and the reliability of
probabilities so far are printed at the end.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping
from functools import cache, partial
from typing import Any

import numpy as np
import pandas as pd
from evidence.families.outcomes import reliability
from evidence.references import TISSUES
from evidence.simulations import by_response, merged, simulation, tables
from scipy.integrate import solve_ivp
from studies import CHAIN, SAMPLER, Fits, Interval, counted, model_of, of_draws, sides

from bayestissue.base.outcome_table import HEADFORM_COLUMNS
from bayestissue.inference.answers.law import Law
from bayestissue.inference.answers.predictions import predict
from bayestissue.inference.answers.questions import ranked
from bayestissue.inference.answers.study import Study
from bayestissue.inference.samplers.sampling import interval
from bayestissue.mechanics.elements import element
from bayestissue.model.hierarchy.specification import ModelSpecification
from bayestissue.studies.simulation import Simulation, simulate
from bayestissue.studies.simulation.campaign import Campaign

# A share of 90 % of the levels is known to about 1 % by so many studies of four of them, to 3 % by 20.
STUDIES = 200
G, PEOPLE = 9.80665, 4
TYPICAL = {"K": ("K_N_per_m", 3000.0), "C": ("C_N_s_per_m", 25.0)}
TABLES = tables(__file__)
DRAWN = TABLES["drawn"]
BEYOND = {"mass_kg": 0.8, "velocity_m_s": 2.25}
LONGEST = {"HIC15": 0.015, "HIC36": 0.036}
# At 2 kHz, to which all traces are filled up: what is compiled serves every study.
SAMPLES = 128
Values = Mapping[str, float]


def typical(name: str) -> dict[str, float]:
    """About what K, C and the element's further parameters are drawn."""
    content = TISSUES[name]
    own = {q: content.get(column, value) for q, (column, value) in TYPICAL.items()}
    return own | content.get("parameters", {})


def specification_of(name: str) -> ModelSpecification:
    """The element's model file, with this design's formula and with priors of what `study` draws."""

    def normal(mean: float, sd: float) -> dict[str, Any]:
        return {"distribution": "normal", "mean": mean, "sd": sd}

    def spread(scale: float) -> dict[str, Any]:
        return {"distribution": "half-normal", "scale": scale}

    about = {q: np.log(v) for q, v in typical(name).items()}
    spreads = {group: dict.fromkeys("KC", spread(scale)) for group, scale in DRAWN["spreads"].items()}
    own = model_of(name).model_dump(mode="json")
    own["priors"] |= {
        "intercept": {q: normal(about[q], DRAWN["intercept"]) for q in "KC"},
        "mass_exponent": dict.fromkeys("KC", normal(*DRAWN["mass_exponent"])),
        "sd_group": {"subject:side": spreads.pop("sd_side")},
        "element": {
            one.name: {
                "log": normal(about[one.name], DRAWN["element"]),
                "spread": spread(DRAWN["sd_impact_parameters"]),
            }
            for one in element(name).extra
        },
        **spreads,
    }
    return ModelSpecification.model_validate(merged(own, TABLES["model"] | {"sampler": SAMPLER}))


def study(name: str, number: int) -> Simulation:
    """The specification of one study; no two of any elements share random numbers."""
    seed = len(TISSUES) * number + list(TISSUES).index(name)
    random = np.random.default_rng([seed, 9])
    drawn = {
        q: value * np.exp(DRAWN["intercept" if q in "KC" else "element"] * random.standard_normal())
        for q, value in typical(name).items()
    }
    spreads = {
        sd: [abs(scale * random.standard_normal()) for _ in "KC"] for sd, scale in DRAWN["spreads"].items()
    }
    of_side = dict(zip("KC", spreads.pop("sd_side"), strict=True))
    exponents = [random.normal(*DRAWN["mass_exponent"]) for _ in "KC"]
    tissue: dict[str, Any] = {column: drawn.pop(q) for q, (column, _) in TYPICAL.items()}
    tissue |= {"element": name, "sd_group": {"subject:side": of_side}}
    if drawn:
        sd = abs(DRAWN["sd_impact_parameters"] * random.standard_normal())
        tissue |= {"parameters": drawn, "sd_impact_parameters": sd}
    own = {"tissue": tissue | by_response(mass_exponent=exponents, **spreads), "recording": CHAIN}
    return simulation(TABLES["campaign"], own, name=name, seed=seed)


def law_of(name: str, p: Values) -> Callable[[float, float, float], float]:
    """F of depth, velocity and the force in a Maxwell arm."""
    K, C = p["K"], p["C"]
    return {
        "kelvin_voigt": lambda x, v, f: K * x + C * v,
        "maxwell": lambda x, v, f: f,
        "standard_linear": lambda x, v, f: K * x + f,
        "stiffening": lambda x, v, f: K * x * (1 + (x / p["stiffening_depth_m"]) ** 2) + C * v,
        "hunt_crossley": lambda x, v, f: (max(x, 0.0) / 0.01) ** 1.5 * (K * 0.01 + C * v),
        "wall": lambda x, v, f: K * x / (1 - x / p["thickness_m"]) + C * v,
    }[name]


def truths(name: str, p: Values, M: float, V: float) -> dict[str, float]:
    """Every outcome of one impact, by integration."""
    force, C = law_of(name, p), p["C"]
    arm = {"maxwell": p["K"], "standard_linear": p.get("arm_ratio", 0.0) * p["K"]}.get(name, 0.0)

    def field(t: float, y: np.ndarray) -> list[float]:
        x, v, f = y
        return [v, G - force(x, v, f) / M, arm * (v - f / C)]

    def pushes(t: float, y: np.ndarray) -> float:
        # A Hertz force has no slope where the impactor leaves the surface.
        return min(y[0], p["K"] * 0.01 + C * y[1]) if name == "hunt_crossley" else force(*y)

    def sinks(t: float, y: np.ndarray) -> float:
        return float(y[1])

    for event in (pushes, sinks):
        event.direction = -1  # type: ignore[attr-defined]
    pushes.terminal = True  # type: ignore[attr-defined]
    most = 8 * np.pi * np.sqrt(M / p["K"])
    arguments = {"method": "DOP853", "events": (pushes, sinks), "rtol": 1e-10, "atol": 1e-12}
    solved = solve_ivp(field, (0, most), [0.0, V, 0.0], dense_output=True, **arguments)
    left, deepest = (times.min(initial=np.inf) for times in solved.t_events)
    time = np.linspace(0, solved.t[-1], 4001)
    x, v, f = solved.sol(time)
    a = np.array([force(*each) for each in zip(x, v, f, strict=True)]) / M
    jerk = np.abs(np.gradient(a, time, edge_order=2))
    # What is never left gives nothing back. A Maxwell tissue then yields for ever: the greatest depth is that
    # of the first standstill.
    last = float(v[-1]) if np.isfinite(left) else 0.0
    work = M * (V**2 - last**2) / 2 + M * G * x[-1]
    peak, depth = float(_greatest(a)), float(solved.sol(min(deepest, solved.t[-1]))[0])
    return {
        "peak_force": M * peak,
        "peak_deceleration": peak / G,
        "peak_depth": depth,
        "time_to_peak": deepest,
        "contact_duration": left,
        "rebound_velocity": -last,
        "restitution": -last / V,
        "impulse": M * (V - last + G * left),
        "peak_jerk": float(_greatest(jerk)),
        "energy_absorbed": work,
        "energy_share": work / (M * V**2 / 2),
        "energy_share_with_gravity": work / (M * V**2 / 2 + M * G * x[-1]),
        **{criterion: head_injury(time, v - G * time, most) for criterion, most in LONGEST.items()},
    }


def _greatest(values: np.ndarray) -> float:
    """Of the parabola through the greatest value and its neighbours."""
    k = int(values.argmax())
    if k in (0, len(values) - 1):
        return float(values[k])
    before, here, after = values[k - 1 : k + 2]
    return float(here + (after - before) ** 2 / (8 * (2 * here - before - after)))


def head_injury(time: np.ndarray, left: np.ndarray, longest: float) -> float:
    """The criterion by all windows between some times, and all of full length."""
    some = slice(None, None, 8)
    length = np.subtract.outer(time[some], time[some]).T
    taken = np.subtract.outer(left[some], left[some])
    fits = (length > 0) & (length <= longest)
    stop = np.minimum(time + longest, time[-1])[:-1]
    lengths = np.append(length[fits], stop - time[:-1])
    takes = np.append(taken[fits], left[:-1] - np.interp(stop, time, left))
    return float((np.maximum(takes / G, 0) ** 2.5 / lengths**1.5).max())


@cache
def fits_of(name: str) -> Fits:
    """The fits of an element's studies, compiled once."""
    return Fits(specification_of(name), simulate(study(name, 0)).dataset(name), SAMPLES)


def intervals(fit: Study, made: Campaign, content: Simulation) -> Iterator[Interval]:
    """Of what is recorded, of levels beyond and of new people the ends of every outcome, and what is true."""
    names, tissue = tuple(HEADFORM_COLUMNS), content.tissue
    random = np.random.default_rng([content.seed, 10])
    columns = {q: column for q, (column, _) in TYPICAL.items()} | {q: q for q in tissue.parameters}
    recorded = [
        ({q: impact[column] for q, column in columns.items()}, impact["mass_kg"], impact["velocity_m_s"])
        for impact in made.truth.to_dict("records")
    ]
    levels = [{"subject": person, "side": "left"} for person in sorted(set(made.impacts["subject"]))]
    beyond = [(at_level(made, content, level), *BEYOND.values()) for level in levels]
    new = [(new_impact(content, random), *BEYOND.values()) for _ in range(PEOPLE)]
    drawn = fit.at(names, [level | BEYOND for level in levels])
    predicted = predict(fit, [BEYOND]).iloc[0]
    kinds = {
        "recorded impact": ({name: interval(fit.draws[name].astype(float)) for name in names}, recorded),
        "level beyond": ({name: interval(drawn[name]) for name in names}, beyond),
        "new person": (
            {
                name: {end: predicted[f"{column}_{end}"] for end in ("low", "high")}
                for name, column in HEADFORM_COLUMNS.items()
            },
            new,
        ),
    }
    for of, (found, impacts) in kinds.items():
        true = pd.DataFrame([truths(tissue.element, *impact) for impact in impacts])  # type: ignore[attr-defined]
        for name in names:
            yield Interval(of, name, (found[name]["low"], found[name]["high"]), true[name].to_numpy())


def typical_beyond(content: Simulation) -> dict[str, float]:
    """A typical person's K and C at the mass of `BEYOND`."""
    tissue = content.tissue
    size = np.log(BEYOND["mass_kg"] / tissue.reference_mass_kg)
    return {
        q: getattr(tissue, column) * np.exp(getattr(tissue, f"mass_exponent_{q}") * size)
        for q, (column, _) in TYPICAL.items()
    }


def at_level(made: Campaign, content: Simulation, level: Mapping[str, str]) -> dict[str, float]:
    """The parameters at a person's side, or at the average of the person's sides on the log scale."""
    impacts = made.impacts
    rows = made.truth[np.logical_and.reduce([impacts[name] == value for name, value in level.items()])]
    effect = {q: (rows[f"subject_effect_{q}"] + rows[f"subject_side_effect_{q}"]).mean() for q in "KC"}
    own = {q: value * np.exp(effect[q]) for q, value in typical_beyond(content).items()}
    return own | content.tissue.parameters


def new_impact(content: Simulation, random: np.random.Generator) -> dict[str, float]:
    """The parameters of one impact on a new person."""
    tissue = content.tissue
    of_side = tissue.sd_group["subject:side"]
    new = {}
    for q, value in typical_beyond(content).items():
        variances = [getattr(tissue, f"sd_{group}_{q}") ** 2 for group in ("subject", "impact")]
        sd = np.sqrt(sum(variances) + getattr(of_side, q) ** 2)
        new[q] = value * np.exp(sd * random.standard_normal())
    return new | {
        q: value * np.exp(tissue.sd_impact_parameters * random.standard_normal())
        for q, value in tissue.parameters.items()
    }


def choices(fit: Study, made: Campaign, content: Simulation) -> Iterator[tuple[str, float]]:
    """The probability that an impact beyond has the lowest peak force at a level, and whether it has.

    As `bayestissue ask` has it of "best(subject, lowest peak_force[...])" and of "best(side, lowest
    peak_force[subject=s01, ...])".
    """
    people = sorted(set(made.impacts["subject"]))
    factors = {
        "subject": [{"subject": person} for person in people],
        "side": [{"subject": people[0], "side": side} for side in ("left", "right")],
    }
    for factor, levels in factors.items():
        drawn = fit.at(["peak_force"], [level | BEYOND for level in levels])["peak_force"]
        best = ranked(drawn.rename(condition="level").transpose("level", ...), lowest=True)[0]
        own = [at_level(made, content, level) for level in levels]
        forces = [truths(content.tissue.element, p, *BEYOND.values())["peak_force"] for p in own]
        for level, p, force in zip(levels, best.mean(("chain", "draw")).to_numpy(), forces, strict=True):
            yield f"best {factor}|{level[factor]}|p", float(p)
            yield f"best {factor}|{level[factor]}|true", float(force == min(forces))


def row_of(name: str, number: int) -> dict[str, Any]:
    """What is kept of a study, asked without the tables and checks of a run."""
    made, fits = simulate(content := study(name, number)), fits_of(name)
    prepared = fits.prepared(made.dataset(name))
    draws, passed = fits.fit(prepared, number)
    law = Law(name, float(prepared.signal.gravity[0]), prepared.model.headform)
    fit = Study(of_draws(prepared, draws, number), prepared.design.recorded, law)
    return sides(intervals(fit, made, content)) | dict(choices(fit, made, content)) | {"passed": passed}


def main() -> None:
    name = sys.argv[1]
    rows = counted(f"outcome_coverage-{name}", partial(row_of, name), STUDIES)
    print(reliability(rows).to_string(float_format="{:.3f}".format))


if __name__ == "__main__":
    main()
