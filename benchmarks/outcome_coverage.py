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
from typing import Any

import numpy as np
import pandas as pd
from coverage import MEASURING_CHAIN, Fits, model_of
from evidence import recorded
from evidence.families.outcomes import reliability, shares
from evidence.references import TISSUES
from scipy.integrate import solve_ivp

from bayestissue.base import runtime
from bayestissue.inference.answers.law import Law
from bayestissue.inference.answers.predictions import predict
from bayestissue.inference.answers.questions import ranked
from bayestissue.inference.answers.study import Study
from bayestissue.inference.quantities.quantity_draws import quantities
from bayestissue.inference.results.labels import labelled
from bayestissue.inference.results.meanings import HEADFORM_COLUMNS
from bayestissue.inference.results.tree import dimensions
from bayestissue.inference.samplers.sampling import interval, quantiles
from bayestissue.mechanics.elements import element
from bayestissue.model.hierarchy.specification import ModelSpecification
from bayestissue.model.hierarchy.trace_data import Prepared
from bayestissue.studies.simulation import Simulation, simulate
from bayestissue.studies.simulation.campaign import Campaign

# A share of 90 % of the levels is known to about 1 % by so many studies of four of them, to 3 % by 20.
STUDIES = 200
G, REFERENCE_KG, PEOPLE = 9.80665, 0.7, 4
TYPICAL = {"K": 3000.0, "C": 25.0}
# Of the logs of typical values and of an element's further parameters; scales of half-normal spreads.
TYPICAL_SD, EXPONENT, PARAMETER_SD, PARAMETER_SPREAD = 0.3, (0.5, 0.3), 0.2, 0.05
SPREADS = {"sd_subject": 0.2, "sd_side": 0.1, "sd_impact": 0.1}
MASSES = {"a": (0.5, 1.5), "b": (1.2, 1.0)}
BEYOND = {"mass_kg": 0.8, "velocity_m_s": 2.25}
FORMULA = "log(mass_kg) + (1|subject) + (1|subject:side)"
SIDES = ("left", "right")
LONGEST = {"HIC15": 0.015, "HIC36": 0.036}
# At 2 kHz, to which all traces are filled up: what is compiled serves every study.
SAMPLES = 128
# Four chains of so many draws know an end of an interval to a hundredth of probability. Of a spread that is
# nearly 0 more effective ones take long.
SAMPLER = {"draws": 250, "effective": 200, "transitions": 4000}
Values = Mapping[str, float]


def typical(name: str) -> dict[str, float]:
    """About what K, C and the element's further parameters are drawn."""
    content = TISSUES[name]
    own = {"K": "K_N_per_m", "C": "C_N_s_per_m"}
    return {q: content.get(column, TYPICAL[q]) for q, column in own.items()} | content.get("parameters", {})


def specification_of(name: str) -> ModelSpecification:
    """The element's model file, with this design's formula and with priors of what `study` draws."""

    def normal(mean: float, sd: float) -> dict[str, Any]:
        return {"distribution": "normal", "mean": mean, "sd": sd}

    def spread(scale: float) -> dict[str, Any]:
        return {"distribution": "half-normal", "scale": scale}

    model, about = model_of(name).model_dump(mode="json"), {q: np.log(v) for q, v in typical(name).items()}
    model["formula"] |= dict.fromkeys("KC", FORMULA)
    model |= {"reference_mass_kg": REFERENCE_KG, "discrepancy": "none", "residual_correlation": False}
    model["sampler"] |= SAMPLER
    priors = model["priors"]
    priors["intercept"] = {q: normal(about[q], TYPICAL_SD) for q in "KC"}
    priors["mass_exponent"] = {q: normal(*EXPONENT) for q in "KC"}
    priors["sd_subject"], priors["sd_impact"] = (
        {q: spread(SPREADS[sd]) for q in "KC"} for sd in ("sd_subject", "sd_impact")
    )
    priors["sd_group"] = {"subject:side": {q: spread(SPREADS["sd_side"]) for q in "KC"}}
    priors["element"] = {
        one.name: {"log": normal(about[one.name], PARAMETER_SD), "spread": spread(PARAMETER_SPREAD)}
        for one in element(name).extra
    }
    return ModelSpecification.model_validate(model)


def study(name: str, number: int) -> Simulation:
    """The specification of one study; no two of any elements share random numbers."""
    seed = len(TISSUES) * number + list(TISSUES).index(name)
    random = np.random.default_rng([seed, 9])
    drawn = {
        q: value * np.exp((TYPICAL_SD if q in "KC" else PARAMETER_SD) * random.standard_normal())
        for q, value in typical(name).items()
    }
    spreads = {
        f"{sd}_{q}": abs(scale * random.standard_normal()) for sd, scale in SPREADS.items() for q in "KC"
    }
    tissue: dict[str, Any] = {
        "K_N_per_m": drawn.pop("K"),
        "C_N_s_per_m": drawn.pop("C"),
        "reference_mass_kg": REFERENCE_KG,
        "element": name,
        "sd_group": {"subject:side": {q: spreads.pop(f"sd_side_{q}") for q in "KC"}},
        **{f"mass_exponent_{q}": random.normal(*EXPONENT) for q in "KC"},
        **spreads,
    }
    if element(name).extra:
        parameters = {one.name: drawn[one.name] for one in element(name).extra}
        tissue |= {
            "parameters": parameters,
            "sd_impact_parameters": abs(PARAMETER_SPREAD * random.standard_normal()),
        }
    conditions = [{"trial": t, "mass_kg": m, "velocity_m_s": v} for t, (m, v) in MASSES.items()]
    content = {
        "name": name,
        "seed": seed,
        "gravity": "drop",
        "headform": True,
        "design": {
            **{"subjects": PEOPLE, "conditions": conditions},
            "factors": [{"name": "side", "levels": list(SIDES)}],
        },
        "tissue": tissue,
        "recording": {"sampling_rate_hz": 2000.0, "before_contact_s": 0.005, **MEASURING_CHAIN},
    }
    return Simulation.model_validate(content)


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


def finished(fits: Fits, prepared: Prepared, name: str, seed: int) -> tuple[Study, bool]:
    """The fit as questions take it, without the tables and checks of a run; and whether its chains passed."""
    draws, passed = fits.fit(prepared, seed)
    values = quantities(prepared, draws, np.random.default_rng(seed))
    names = {"impact": prepared.impacts["impact"].tolist(), **prepared.design.levels()}
    posterior = labelled(values, dimensions(prepared.design, prepared.data.record.errors), names)
    gravity, headform = float(prepared.signal.gravity[0]), prepared.model.headform
    return Study(posterior, prepared.design.recorded, Law(name, gravity, headform)), passed


def intervals(
    fit: Study, made: Campaign, simulation: Simulation
) -> Iterator[tuple[str, str, float, float, float]]:
    """What an interval is of, its outcome, its ends and what is true."""
    tissue, posterior = simulation.tissue, fit.draws
    names, extra = tuple(HEADFORM_COLUMNS), list(tissue.parameters)
    ends, motion = [0.05, 0.95], (BEYOND["mass_kg"], BEYOND["velocity_m_s"])
    recorded_ends = {name: quantiles(_flat(posterior[name].to_numpy()), ends) for name in names}
    for row, impact in enumerate(made.truth.to_dict("records")):
        p = {"K": impact["K_N_per_m"], "C": impact["C_N_s_per_m"], **{one: impact[one] for one in extra}}
        true = truths(tissue.element, p, impact["mass_kg"], impact["velocity_m_s"])
        for name in names:
            yield "recorded impact", name, *recorded_ends[name][:, row], true[name]
    levels = [{"subject": person, "side": SIDES[0]} for person in sorted(set(made.impacts["subject"]))]
    drawn = fit.at(names, [level | BEYOND for level in levels])
    at_levels = {name: interval(values) for name, values in drawn.items()}
    for row, level in enumerate(levels):
        true = truths(tissue.element, at_level(made, simulation, level), *motion)
        for name in names:
            low, high = (at_levels[name][end][row] for end in ("low", "high"))
            yield "level beyond", name, low, high, true[name]
    predicted, random = predict(fit, [BEYOND]).iloc[0], np.random.default_rng([simulation.seed, 10])
    for _ in range(PEOPLE):
        true = truths(tissue.element, new_impact(simulation, random), *motion)
        for name, column in HEADFORM_COLUMNS.items():
            yield "new person", name, predicted[f"{column}_low"], predicted[f"{column}_high"], true[name]


def _flat(draws: np.ndarray) -> np.ndarray:
    return draws.reshape(-1, draws.shape[-1]).T.astype(float)


def typical_beyond(simulation: Simulation) -> dict[str, float]:
    """A typical person's K and C at the mass of `BEYOND`."""
    tissue, size = simulation.tissue, np.log(BEYOND["mass_kg"] / REFERENCE_KG)
    columns = {"K": "K_N_per_m", "C": "C_N_s_per_m"}
    return {
        q: getattr(tissue, column) * np.exp(getattr(tissue, f"mass_exponent_{q}") * size)
        for q, column in columns.items()
    }


def at_level(made: Campaign, simulation: Simulation, level: Mapping[str, str]) -> dict[str, float]:
    """The parameters at a person's side, or at the average of the person's sides on the log scale."""
    impacts = made.impacts
    rows = made.truth[np.logical_and.reduce([impacts[name] == value for name, value in level.items()])]
    effect = {q: (rows[f"subject_effect_{q}"] + rows[f"subject_side_effect_{q}"]).mean() for q in "KC"}
    own = {q: value * np.exp(effect[q]) for q, value in typical_beyond(simulation).items()}
    return own | simulation.tissue.parameters


def new_impact(simulation: Simulation, random: np.random.Generator) -> dict[str, float]:
    """The parameters of one impact on a new person."""
    tissue = simulation.tissue
    of_side = tissue.sd_group["subject:side"]
    new = {}
    for q, value in typical_beyond(simulation).items():
        variances = [getattr(tissue, f"sd_{group}_{q}") ** 2 for group in ("subject", "impact")]
        sd = np.sqrt(sum(variances) + getattr(of_side, q) ** 2)
        new[q] = value * np.exp(sd * random.standard_normal())
    return new | {
        q: value * np.exp(tissue.sd_impact_parameters * random.standard_normal())
        for q, value in tissue.parameters.items()
    }


def choices(fit: Study, made: Campaign, simulation: Simulation) -> Iterator[tuple[str, str, float, bool]]:
    """Factor, level, probability that an impact beyond has the lowest peak force there, and whether it has.

    As `bayestissue ask` has it of "best(subject, lowest peak_force[...])" and of "best(side, lowest
    peak_force[subject=s01, ...])", with all levels' motions in one go.
    """
    people = sorted(set(made.impacts["subject"]))
    factors = {
        "subject": [{"subject": person} for person in people],
        "side": [{"subject": people[0], "side": side} for side in SIDES],
    }
    levels = [level for those in factors.values() for level in those]
    drawn = fit.at(["peak_force"], [level | BEYOND for level in levels])["peak_force"]
    forces = drawn.rename(condition="level").transpose("level", ...)
    true = [
        truths(simulation.tissue.element, at_level(made, simulation, level), *BEYOND.values())["peak_force"]
        for level in levels
    ]
    begin = 0
    for factor, those in factors.items():
        part = slice(begin, begin := begin + len(those))
        best = ranked(forces[part], lowest=True)[0].mean(("chain", "draw"))
        for level, p, force in zip(those, best.to_numpy(), true[part], strict=True):
            yield factor, level[factor], float(p), force == min(true[part])


def row_of(rows: pd.DataFrame, chosen: list[tuple[str, str, float, bool]]) -> dict[str, float]:
    """What is kept of a study."""
    sides = rows.assign(below=rows["high"] < rows["truth"], above=rows["low"] > rows["truth"])
    shares = sides.groupby(["of", "outcome"], sort=False)[["below", "above"]].mean()
    row = {f"{of}|{outcome}|{side}": v for (of, outcome), s in shares.iterrows() for side, v in s.items()}
    for factor, level, p, true in chosen:
        row |= {f"best {factor}|{level}|p": p, f"best {factor}|{level}|true": float(true)}
    return row


def main() -> None:
    name, studies = sys.argv[1], int(sys.argv[2]) if len(sys.argv) > 2 else STUDIES
    runtime.configure()
    specification = specification_of(name)
    with recorded(f"outcome_coverage-{name}") as record:
        fits = Fits(specification, simulate(study(name, 0)).dataset(name), SAMPLES)
        for number in record.missing(range(studies)):
            simulation = study(name, number)
            made = simulate(simulation)
            fit, passed = finished(fits, fits.prepared(made.dataset(name)), name, number)
            columns = ["of", "outcome", "low", "high", "truth"]
            rows = pd.DataFrame(intervals(fit, made, simulation), columns=columns)
            record.add(number, [row_of(rows, list(choices(fit, made, simulation))) | {"passed": passed}])
        found = record.piece.rows()
    print(shares(found).to_string(float_format="{:.3f}".format))
    print(reliability(found).to_string(float_format="{:.3f}".format))


if __name__ == "__main__":
    main()
