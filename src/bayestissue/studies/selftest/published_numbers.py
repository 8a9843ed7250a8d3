"""Numbers that others published, and the same numbers by this program: what its own oracles can't say.

Each is computed from data that come with the program or with a library that it needs. Among them are
objectives of mixed-model programs, by the hierarchy's own algebra. Their tables are those of lme4 (Bates,
Mächler, Bolker and Walker 2015, doi:10.18637/jss.v067.i01), which has them from Davies, The Design and
Analysis of Industrial Experiments (1949), Davies and Goldsmith, Statistical Methods in Research and
Production (1972), and Belenky and others, Journal of Sleep Research (2003). They stand in
``published_numbers.toml``, one row a level of the first factor.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from jax import Array
from jaxtyping import Float

from bayestissue.base.declarations import declared
from bayestissue.inference.results.uncertainty_budget import NOISE, by_source
from bayestissue.mechanics.elements import element
from bayestissue.mechanics.elements.element import Collision
from bayestissue.mechanics.elements.linear import transition
from bayestissue.model.hierarchy.design import build_design
from bayestissue.model.hierarchy.gaussian.arrangement import PopulationDesign, expected, expected_by_cell
from bayestissue.model.hierarchy.gaussian.effects import Covariances, integrate_effects
from bayestissue.model.hierarchy.gaussian.factor import GaussianFactor
from bayestissue.model.hierarchy.population import EffectParts, covariances_of, population_design
from bayestissue.model.hierarchy.priors import Normal, Priors
from bayestissue.model.hierarchy.specification import Formulas
from bayestissue.model.likelihood.arma21 import arma21_log_likelihood
from bayestissue.model.likelihood.small import LOG_2PI

# Of what plays the part of the mass; log(mass_kg) is the covariate of a slope.
REFERENCE = 0.8
# Of fixed effects, which the program integrates out: what they leave open is far below 1e-6 of an objective.
_KNOWN = 1e-5
_FURTHER = ("sd_impact_C", "sd_noise")
_ANY = 0.3


def data(name: str) -> Float[np.ndarray, "level value"]:
    """One of the tables of ``published_numbers.toml``."""
    rows = declared(__package__, "published_numbers.toml")["data"][name].strip().splitlines()
    return np.array([row.split() for row in rows], float)


# NIST, Statistical Reference Datasets, nonlinear regression, Lanczos3 (generated to five digits).
TIME = np.arange(24) * 0.05
LANCZOS3 = np.ravel(data("lanczos3"))
# The second of the two starts that come with it.
_RATES = (0.7, 4.2, 6.3)
# Of Gauss and Newton, each of which leaves a thirtieth of what is left.
_STEPS = 6


@dataclass(frozen=True)
class Published:
    """Numbers of one source.

    Attributes:
        title: what they are of.
        source: who published them, and where.
        numbers: by name, as printed.
        tolerance: how far off a number may be, by name or of all: half a unit of the last digit printed, or
            rounding errors where those are greater.
        why: what the tolerance is.
        computed: the same numbers by this program, by name.
        takes_long: whether it takes more than a few seconds.
    """

    title: str
    source: str
    numbers: Mapping[str, float]
    tolerance: Mapping[str, float] | float
    why: str
    computed: Callable[[], Mapping[str, float]]
    takes_long: bool = False

    def differences(self, computed: Mapping[str, float]) -> dict[str, float]:
        """What is farther off than it may be: the number computed less the published one, by name."""
        differences = {name: computed[name] - value for name, value in self.numbers.items()}
        return {name: off for name, off in differences.items() if not abs(off) <= self.tolerance_of(name)}

    def tolerance_of(self, name: str) -> float:
        """How far off one number may be."""
        return self.tolerance[name] if isinstance(self.tolerance, Mapping) else self.tolerance


def _stata() -> dict[str, float]:
    from statsmodels.datasets import macrodata

    # Stata holds data in single precision: of the data as they are, the result is 0.0002 greater, by
    # statsmodels and by the dense covariance too. Its theta has the other sign.
    index = macrodata.load_pandas().data["cpi"].to_numpy().astype(np.float32).astype(float)
    x = np.diff(index) - 0.86132870569126
    at = (1.1429974468925, -0.16912378249242, 0.87400688606796, 0.79249918716869)
    log_likelihood = arma21_log_likelihood(x, *at, start="stationary")
    return {"values": float(len(x)), "log likelihood": float(log_likelihood)}


def _budget(standard_uncertainties: Mapping[str, float]) -> dict[str, float]:
    """Contributions of independent inputs, and their combined standard uncertainty, by the interval's budget.

    Of one measurement of the measurand, beside whose inputs there is next to no noise.
    """
    sd = np.array(list(standard_uncertainties.values()))
    noise = 1e-4 * sd.max()
    budget = by_source(np.full((1, 1, 1), 1 / noise), sd[None, :, None] / noise, list(standard_uncertainties))
    parts = {name: np.sqrt(part[0, 0, 0]) for name, part in budget.items() if name != NOISE}
    return {**parts, "combined": np.sqrt(np.sum([*budget.values()]))}


# By input: sensitivity coefficient times standard uncertainty [nm], as measured in the example.
_END_GAUGE = {
    "standard's length": 25.0,
    "difference of the two": 9.7,
    "difference of expansion coefficients": 50.000623e6 * 0.1 * 0.58e-6,
    "difference of temperatures": 50.000623e6 * 11.5e-6 * 0.029,
}


def columns(values: Float[np.ndarray, "level value"], repeats: int = 1) -> np.ndarray:
    """A name for each so many columns of a table, of every value."""
    return np.tile([f"c{n // repeats}" for n in range(values.shape[1])], len(values))


def exactly_estimated(
    population: tuple[EffectParts, PopulationDesign], y: Float[Any, " impact"], sd: Mapping[str, Any]
) -> tuple[PopulationDesign, Covariances, GaussianFactor]:
    """What exact estimates y of log K say of all effects b; of log C and the noise nothing is known.

    Args:
        population: parts of b and their design, as `population_design` has them.
        y: log K of each impact.
        sd: standard deviations of log K, by the names of their sites.

    Returns:
        What `integrate_effects` takes.
    """
    effects, design = population
    sites = {name: jnp.asarray(value) for name, value in (dict.fromkeys(_FURTHER, _ANY) | dict(sd)).items()}
    residual = jnp.asarray(y) - expected(design, jnp.asarray(effects.mean))[0]
    precision, first = sites["sd_impact_K"] ** -2.0, jnp.array([1.0, 0.0, 0.0])[:, None]
    sums = (
        precision * first * residual,
        precision * first[:, None] * first * jnp.ones_like(residual),
        (jnp.log(precision) - precision * residual**2) / 2,
    )
    of_cells = expected_by_cell(design, effects.mean)
    factor = GaussianFactor(of_cells, *(design.to_cells(part) for part in sums))
    return design, covariances_of(effects, sites, 0.0, ("noise",)), factor


def least_objective(
    formula: str, values: Float[np.ndarray, "level value"], table: Mapping[str, np.ndarray], first_sd: float
) -> float:
    """Minus twice the greatest log likelihood, over standard deviations and fixed effects.

    The program integrates fixed effects out. Here they are known, to `_KNOWN`, to be 0 of what is left of the
    values: so their own greatest is found like that of the others.

    Args:
        formula: of log K.
        values: a table, of which the rows are the levels of `subject`.
        table: further columns, one entry a value, and mass_kg where the formula has it.
        first_sd: of every standard deviation, where the search begins.
    """
    from scipy.optimize import minimize

    y, count = values.ravel(), values.size
    subject = np.repeat([f"s{n}" for n in range(len(values))], values.shape[1])
    rows = pd.DataFrame({"impact": np.arange(count), "trial": "t", "mass_kg": REFERENCE, "subject": subject})
    rows = rows.assign(**table)
    known, free = (Normal(distribution="normal", mean=0.0, sd=sd) for sd in (_KNOWN, 1.0))
    fixed_effects = {"K": known, "C": free}
    priors = Priors.model_validate({"intercept": fixed_effects, "mass_exponent": fixed_effects})
    design = build_design(Formulas(K=formula, C="1"), rows, reference_mass_kg=REFERENCE, source="selftest")
    population = population_design(design, priors, ("noise",))
    x = np.log(rows["mass_kg"].to_numpy() / REFERENCE)
    X = np.stack([np.ones(count), x], axis=1)[:, : 1 + ("log" in formula)]
    names = ["sd_impact_K", *(term.sd("K") for term in design.responses["K"].terms)]

    @jax.jit
    @jax.value_and_grad
    def objective(at: Array) -> Array:
        sd = dict(zip(names, jnp.exp(at[: len(names)]), strict=True))
        left = jnp.asarray(y) - X @ at[len(names) :]
        return -2 * integrate_effects(*exactly_estimated(population, left, sd))[1] + count * LOG_2PI

    def value_and_slope(at: Float[np.ndarray, " parameter"]) -> tuple[float, Float[np.ndarray, " parameter"]]:
        value, slope = objective(jnp.asarray(at))
        return float(value), np.asarray(slope)

    begin = np.r_[np.full(len(names), np.log(first_sd)), np.linalg.lstsq(X, y, rcond=None)[0]]
    return float(minimize(value_and_slope, begin, jac=True, method="BFGS").fun)


def sleep_objective(zero: float) -> float:
    """Of reaction times with a slope and an intercept of each person that are independent at day ``zero``.

    A correlation of the two is a matter of where the covariate is 0: in one place there is none, and the
    least objective over all places is that of a program that has the correlation as a parameter.
    """
    times = data("sleep")
    days = np.tile(np.arange(10.0), len(times))
    mass = {"mass_kg": REFERENCE * np.exp(days - zero)}
    return least_objective("log(mass_kg) + (log(mass_kg)|subject)", times, mass, 20.0)


def _objective(formula: str, name: str, first_sd: float, **of_column: int) -> dict[str, float]:
    """Of a table with a further factor, of which ``of_column`` has how many columns are one level."""
    values = data(name)
    further = {factor: columns(values, count) for factor, count in of_column.items()}
    return {"objective": least_objective(formula, values, further, first_sd)}


def _sleep() -> dict[str, float]:
    from scipy.optimize import minimize_scalar

    return {"objective": float(minimize_scalar(sleep_objective, bracket=(-1.0, 0.0), tol=1e-5).fun)}


def _element_of_rates(rates: tuple[float, ...]) -> Float[np.ndarray, " 3"]:
    """K [N/m], C [N s/m] and arm_ratio of the standard linear solid on which 1 kg has these rates [1/s]."""
    total, product = sum(rates), float(np.prod(rates))
    pairs = (total**2 - sum(rate**2 for rate in rates)) / 2
    K = product / total
    return np.array([K, (pairs - K) / total, (pairs - K) / K])


@jax.jit
def _left(logs: Float[Array, " parameter"]) -> Float[Array, " time"]:
    """What the motions that begin with x, v or s alone leave of `LANCZOS3`."""
    which, one = element("standard_linear"), jnp.ones(1)
    values = dict(
        zip((parameter.name for parameter in which.parameters), jnp.exp(logs)[:, None], strict=True)
    )
    free = Collision.of(which, values, one, one)
    motions = transition(free, jnp.asarray(TIME)[None])[0, :, 0]
    basis, _ = jnp.linalg.qr(motions)
    series = jnp.asarray(LANCZOS3)
    return series - basis @ (basis.T @ series)


def _exponentials() -> dict[str, float]:
    """Least squares of `LANCZOS3`, the linear parameters solved for at each step (variable projection).

    Three decaying exponentials are the motion of a mass on a standard linear solid that is overdamped. The
    poles -l of M x'' = -K x - r K (x - s), s' = r K (x - s) / C are those of

        (l^2 + (1 + r) K / M) (r K / C - l) = (r K)^2 / (M C),

    so that with M = 1 kg, r K / C is the sum of the three rates l, (1 + r) K that of their products in pairs,
    and r K^2 / C the product of all three. The motion is linear in where it begins, x, v and s, which are
    solved for.

    Returns:
        Amplitudes b1, b3, b5 and rates b2, b4, b6 of b1 exp(-b2 t) + ..., rates rising, and ``squares``, the
        sum of squares that is left.
    """
    from scipy.optimize import least_squares

    slopes = jax.jit(jax.jacfwd(_left))
    fitted = least_squares(
        _left, np.log(_element_of_rates(_RATES)), slopes, method="lm", xtol=1e-15, ftol=1e-15, gtol=1e-15
    )
    # Those steps end where the sum of squares no longer falls by more than its rounding error, a hundred
    # thousandth of a standard deviation from its least and more. Gauss and Newton's go by its slope.
    logs = fitted.x
    for _ in range(_STEPS):
        logs = logs - np.linalg.lstsq(slopes(logs), _left(logs))[0]
    K, C, ratio = np.exp(logs)
    arm = ratio * K
    rates = np.sort(np.roots([1.0, -arm / C, K + arm, -arm / C * K]).real)
    amplitudes = np.linalg.lstsq(np.exp(-np.outer(TIME, rates)), LANCZOS3, rcond=None)[0]
    named = {f"b{2 * n + 1 + k}": value[n] for n in range(3) for k, value in enumerate((amplitudes, rates))}
    named["squares"] = _left(logs) @ _left(logs)
    return {name: float(value) for name, value in named.items()}


_COMPUTED: dict[str, Callable[[], Mapping[str, float]]] = {
    "Stata": _stata,
    "Dyestuff": lambda: _objective("(1|subject)", "dyestuff", 40.0),
    "Pastes": lambda: _objective("(1|subject) + (1|subject:side)", "pastes", 1.0, side=2),
    "Penicillin": lambda: _objective("(1|subject) + (1|session)", "penicillin", 1.0, session=1),
    "sleepstudy": _sleep,
    "Lanczos3": _exponentials,
    "end gauge": lambda: _budget(_END_GAUGE),
    "four inputs": lambda: _budget(dict.fromkeys("1234", 1.0)),
    "one large input": lambda: _budget({"1": 1.0, "2": 1.0, "3": 1.0, "4": 10.0}),
}
PUBLISHED = {
    name: Published(**entry, computed=_COMPUTED[name])
    for name, entry in declared(__package__, "published_numbers.toml")["published"].items()
}
