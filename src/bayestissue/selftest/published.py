"""Numbers that others published, and the same numbers by this program: what its own oracles can't say.

Each is computed from data that come with the program or with a library that it needs.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from bayestissue.inference.results.errors import NOISE, STEP, by_source
from bayestissue.likelihood import arma21_log_likelihood
from bayestissue.selftest.decaying import fitted_exponentials
from bayestissue.selftest.mixed_models import (
    DYESTUFF,
    PASTES,
    PENICILLIN,
    columns,
    least_objective,
    sleep_objective,
)


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
        allowed = {name: self.tolerance_of(name) for name in differences}
        return {
            name: difference
            for name, difference in differences.items()
            if not abs(difference) <= allowed[name]
        }

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

    The measurand's information is that of a measurement without noise: P = 1 / sum of c^2 u^2.
    """
    variance = {name: u**2 for name, u in standard_uncertainties.items()}
    total = sum(variance.values())

    def information(name: str, side: int) -> np.ndarray:
        return np.array([[[1 / (total + variance[name] * np.expm1(side * STEP / 2))]]])

    ends = {name: (information(name, 1), information(name, -1)) for name in variance}
    budget = by_source(np.array([[[1 / total]]]), ends)
    # What is left to the noise, of which there is none, is the error of the derivatives.
    parts = {name: np.sqrt(part[0, 0, 0]) for name, part in budget.parts.items() if name != NOISE}
    return {**parts, "combined": np.sqrt(budget.total[0, 0, 0])}


# By input: sensitivity coefficient times standard uncertainty [nm], as measured in the example.
_END_GAUGE = {
    "standard's length": 25.0,
    "difference of the two": 9.7,
    "difference of expansion coefficients": 50.000623e6 * 0.1 * 0.58e-6,
    "difference of temperatures": 50.000623e6 * 11.5e-6 * 0.029,
}
_MIXED_MODELS = "MixedModels.jl, reference objectives of its tests (-2 log likelihood, maximum likelihood)"
_SEARCH = "a search that ends at slopes of 1e-5, and fixed effects that are known to 1e-5"
_RATES = {
    "b1": 0.086816414977,
    "b2": 0.95498101505,
    "b3": 0.84400777463,
    "b4": 2.9515951832,
    "b5": 1.5825685901,
    "b6": 4.9863565084,
}
_RATES_SD = {
    "b1": 0.017197908859,
    "b2": 0.097041624475,
    "b3": 0.041488663282,
    "b4": 0.10766312506,
    "b5": 0.058371576281,
    "b6": 0.034436403035,
}
_SQUARES = 1.6117193594e-8
_JCGM_101 = "JCGM 101:2008 (GUM, supplement 1), 9.2"

PUBLISHED = {
    "Stata": Published(
        "ARIMA(2,1,1) of the consumer price index, exact log likelihood",
        "Stata, as statsmodels keeps it among the results of its own tests",
        {"values": 202, "log likelihood": -239.91961140777},
        1e-10,
        "rounding errors; 14 digits were printed",
        _stata,
    ),
    "Dyestuff": Published(
        "one grouping of a mixed model",
        _MIXED_MODELS,
        {"objective": 327.3270598811428},
        1e-8,
        _SEARCH,
        lambda: {"objective": least_objective("(1|subject)", DYESTUFF, {}, 40.0)},
    ),
    "Pastes": Published(
        "nested groupings of a mixed model",
        _MIXED_MODELS,
        {"objective": 247.99446586325791},
        1e-8,
        _SEARCH,
        lambda: {
            "objective": least_objective(
                "(1|subject) + (1|subject:side)", PASTES, {"side": columns(PASTES, 2)}, 1.0
            )
        },
    ),
    "Penicillin": Published(
        "crossed groupings of a mixed model",
        _MIXED_MODELS,
        {"objective": 332.18834867227616},
        1e-8,
        _SEARCH,
        lambda: {
            "objective": least_objective(
                "(1|subject) + (1|session)", PENICILLIN, {"session": columns(PENICILLIN)}, 1.0
            )
        },
    ),
    "sleepstudy": Published(
        "correlated slopes and intercepts of a mixed model",
        _MIXED_MODELS,
        {"objective": 1751.9393444663153},
        1e-8,
        _SEARCH,
        lambda: {"objective": _least_sleep_objective()},
        takes_long=True,
    ),
    "Lanczos3": Published(
        "three decaying exponentials as an overdamped standard linear solid, least squares",
        "NIST, Statistical Reference Datasets, certified values",
        {**_RATES, "squares": _SQUARES},
        {**{name: 1e-6 * sd for name, sd in _RATES_SD.items()}, "squares": 1e-9 * _SQUARES},
        "rounding errors: a millionth of the certified standard deviations",
        fitted_exponentials,
    ),
    "end gauge": Published(
        "uncertainty budget of an end gauge's length, in nm",
        "JCGM 100:2008 (GUM), H.1",
        dict(zip([*_END_GAUGE, "combined"], (25.0, 9.7, 2.9, 16.6, 32.0), strict=True)),
        # 11.5e-6 / K and 0.029 K are rounded: 0.0005 in 0.029 K are 0.3 nm.
        dict(zip([*_END_GAUGE, "combined"], (0.05, 0.05, 0.05, 0.3, 0.5), strict=True)),
        "half a unit of the last digit printed; 0.3 nm where the inputs themselves were rounded",
        lambda: _budget(_END_GAUGE),
    ),
    "four inputs": Published(
        "sum of four inputs of standard uncertainty 1",
        _JCGM_101,
        {"combined": 2.0},
        0.05,
        "half a unit of the last digit printed",
        lambda: _budget(dict.fromkeys("1234", 1.0)),
    ),
    "one large input": Published(
        "sum of four inputs, one of standard uncertainty 10",
        _JCGM_101,
        {"combined": 10.1},
        0.05,
        "half a unit of the last digit printed",
        lambda: _budget({"1": 1.0, "2": 1.0, "3": 1.0, "4": 10.0}),
    ),
}


def _least_sleep_objective() -> float:
    from scipy.optimize import minimize_scalar

    return float(minimize_scalar(sleep_objective, bracket=(-1.0, 0.0), tol=1e-5).fun)
