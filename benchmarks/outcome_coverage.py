"""How often 90 % intervals of what impacts do hold what they did: simulated studies, fitted.

    .venv/bin/python benchmarks/outcome_coverage.py stiffening 200

So many studies of one element: six people hit by a headform on both sides with three masses along gravity.
K and C vary by person, by the person's side, with the mass by an exponent of the study, and by impact. Of
each study the intervals of every outcome are noted of its recorded impacts; of the first person's left side
hit half as fast again as any impact that was recorded; and of a new impact of that velocity on a new person.
What is true comes of scipy's integration of the equations written out here, without the program's elements.

Rows are added to results/outcome_coverage-NAME.csv, one an interval, study by study: a script that is
stopped goes on where it was. The shares that held are printed, and written to
outcome_coverage-NAME-shares.csv beside it. Their standard error is that of the studies' own shares, which of
one interval a study is the binomial one.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np
import pandas as pd
from coverage import MEASURING_CHAIN, model_of
from evidence.references import TISSUES
from scipy.integrate import solve_ivp
from studies import RESULTS, studied

from bayestissue.elements import element
from bayestissue.hierarchy.specification import ModelSpecification
from bayestissue.hierarchy.trace_data import prepare
from bayestissue.inference.answers.finished import Finished
from bayestissue.inference.answers.predictions import predict
from bayestissue.inference.fit import fit_traces
from bayestissue.inference.results.meanings import HEADFORM_COLUMNS
from bayestissue.inference.samplers.sampling import quantiles
from bayestissue.simulation import Simulation, simulate
from bayestissue.simulation.campaign import Campaign

G, REFERENCE_KG = 9.80665, 0.7
SPREADS = {"sd_subject": 0.2, "sd_side": 0.1, "sd_impact": 0.05}
MASSES = {"a": (0.5, 1.5), "b": (0.8, 1.2), "c": (1.2, 1.0)}
BEYOND = {"mass_kg": 0.8, "velocity_m_s": 2.25}
FORMULA = "log(mass_kg) + (1|subject) + (1|subject:side)"
LONGEST = {"HIC15": 0.015, "HIC36": 0.036}
Values = Mapping[str, float]


def study(name: str, seed: int) -> Simulation:
    """The specification of one study."""
    exponents = np.random.default_rng([seed, 9]).normal(0.5, 0.3, 2)
    conditions = [{"trial": t, "mass_kg": m, "velocity_m_s": v} for t, (m, v) in MASSES.items()]
    side = {"sd_group": {"subject:side": dict.fromkeys("KC", SPREADS["sd_side"])}}
    tissue: dict[str, Any] = {
        "K_N_per_m": 3000.0,
        "C_N_s_per_m": 25.0,
        "element": name,
        **TISSUES[name],
        **side,
    }
    tissue |= {f"{sd}_{q}": SPREADS[sd] for sd in ("sd_subject", "sd_impact") for q in "KC"}
    tissue |= {f"mass_exponent_{q}": float(value) for q, value in zip("KC", exponents, strict=True)}
    if element(name).extra:
        tissue["sd_impact_parameters"] = SPREADS["sd_impact"]
    content = {
        "name": name,
        "seed": seed,
        "gravity": "drop",
        "headform": True,
        "design": {
            **{"subjects": 6, "conditions": conditions},
            "factors": [{"name": "side", "levels": ["left", "right"]}],
        },
        "tissue": tissue,
        "recording": {"sampling_rate_hz": 5000.0, "before_contact_s": 0.005, **MEASURING_CHAIN},
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
    work = M * (V**2 - v[-1] ** 2) / 2 + M * G * x[-1]
    peak = float(_greatest(a))
    return {
        "peak_force": M * peak,
        "peak_deceleration": peak / G,
        "peak_depth": float(_greatest(x)),
        "time_to_peak": deepest,
        "contact_duration": left,
        "rebound_velocity": -v[-1],
        "restitution": -v[-1] / V,
        "impulse": M * (V - v[-1] + G * left),
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


def intervals(
    made: Campaign, simulation: Simulation, specification: ModelSpecification, seed: int
) -> Iterator[tuple[str, str, float, float, float]]:
    """What an interval is of, its outcome, its ends and what is true."""
    dataset, tissue = made.dataset(simulation.name), simulation.tissue
    prepared = prepare(dataset, specification, source="the model file")
    tree = fit_traces(prepared, specification, seed, lambda *_: None).tree
    finished = Finished.from_tree(tree, specification.model_dump(mode="json") | prepared.design.resolved())
    law, posterior = finished.law, finished.posterior
    assert law is not None
    names, extra = tuple(HEADFORM_COLUMNS), list(tissue.parameters)
    ends = [0.05, 0.95]
    recorded = {name: quantiles(_flat(posterior[name].to_numpy()), ends) for name in names}
    for row, impact in enumerate(made.truth.to_dict("records")):
        p = {"K": impact["K_N_per_m"], "C": impact["C_N_s_per_m"], **{one: impact[one] for one in extra}}
        true = truths(tissue.element, p, impact["mass_kg"], impact["velocity_m_s"])
        for name in names:
            yield "recorded impact", name, *recorded[name][:, row], true[name]
    motion = (BEYOND["mass_kg"], BEYOND["velocity_m_s"])
    level = {"subject": "s01", "side": "left", **BEYOND}
    at = {
        q: values.reshape(-1, 1)
        for q, values in law.parameters(posterior, finished.recorded, [level]).items()
    }
    drawn = law.outcomes(at, *(np.array([value]) for value in (*motion, 0.0318)))
    of_level = made.truth[(made.impacts["subject"] == "s01") & (made.impacts["side"] == "left")].iloc[0]
    random = np.random.default_rng([seed, 10])
    size = np.log(motion[0] / REFERENCE_KG)
    typical = {q: getattr(tissue, column) for q, column in (("K", "K_N_per_m"), ("C", "C_N_s_per_m"))}
    typical = {q: K * np.exp(getattr(tissue, f"mass_exponent_{q}") * size) for q, K in typical.items()}
    own = {
        q: K * np.exp(of_level[f"subject_effect_{q}"] + of_level[f"subject_side_effect_{q}"])
        for q, K in typical.items()
    }
    true = truths(tissue.element, own | tissue.parameters, *motion)
    for name in names:
        yield "level beyond", name, *quantiles(drawn[name].reshape(1, -1), ends)[:, 0], true[name]
    scatter = np.sqrt(sum(sd**2 for sd in SPREADS.values()))
    new = {q: K * np.exp(scatter * random.standard_normal()) for q, K in typical.items()}
    new |= {
        q: v * np.exp(tissue.sd_impact_parameters * random.standard_normal())
        for q, v in tissue.parameters.items()
    }
    true = truths(tissue.element, new, *motion)
    predicted = predict(finished, [BEYOND]).iloc[0]
    for name, column in HEADFORM_COLUMNS.items():
        yield "new person", name, predicted[f"{column}_low"], predicted[f"{column}_high"], true[name]


def _flat(draws: np.ndarray) -> np.ndarray:
    return draws.reshape(-1, draws.shape[-1]).T.astype(float)


def shares(rows: pd.DataFrame) -> pd.DataFrame:
    """The share of intervals that hold the truth, with its standard error over studies."""
    of_study = rows.groupby(["of", "outcome", "unit"], sort=False)["held"].mean()
    grouped = of_study.groupby(["of", "outcome"], sort=False)
    table = pd.DataFrame({"share": grouped.mean(), "studies": grouped.size()})
    # Of all intervals or none the studies tell no error: that of a share half an interval from it.
    share = np.clip(table["share"], 0.5 / table["studies"], 1 - 0.5 / table["studies"])
    binomial = np.sqrt(share * (1 - share) / table["studies"])
    return table.assign(
        error=(grouped.std() / np.sqrt(table["studies"])).replace(0.0, np.nan).fillna(binomial)
    )


def main() -> None:
    name, count = sys.argv[1], int(sys.argv[2])
    path = RESULTS / f"outcome_coverage-{name}.csv"
    formula = dict.fromkeys("KC", FORMULA)
    found = model_of(name)
    specification = found.model_copy(update={"formula": found.formula.model_copy(update=formula)})

    def rows_of(number: int) -> pd.DataFrame:
        simulation = study(name, number)
        return pd.DataFrame(
            intervals(simulate(simulation), simulation, specification, number),
            columns=["of", "outcome", "low", "high", "truth"],
        )

    table = shares(studied(path.stem, count, rows_of))
    table.to_csv(path.with_name(f"{path.stem}-shares.csv"), float_format="%.4g")
    print(table.to_string(float_format="{:.3f}".format))


if __name__ == "__main__":
    main()
