"""The figures of the explanations: `python docs/explanation/figures.py` writes them all into figures/."""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

import bayestissue as bt
from bayestissue.base import runtime
from bayestissue.mechanics import elements

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
K, C, VELOCITY = 3000.0, 25.0, 1.5
MASSES = np.array([0.375, 0.666, 1.0, 1.333])  # of the thesis, kg
BLUE, GREY, RED = "#1f5f99", "#6b7280", "#b4532a"
STYLE = {
    "svg.hashsalt": "bayestissue",
    "svg.fonttype": "none",
    "font.size": 10,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "figure.constrained_layout.use": True,
}


def path_of(element: str, parameters: dict[str, float], mass: float, velocity: float, time: np.ndarray):
    """Depth, velocity and deceleration of one impact, as arrays of the times."""
    given = {name: np.array([value]) for name, value in parameters.items()}
    found = elements.impact(element, given, np.array([mass]), np.array([velocity]), time[None])
    return (np.asarray(values)[0] for values in (found.x, found.v, found.deceleration))


def impact() -> plt.Figure:
    """Depth, velocity and deceleration of one impact."""
    time = np.linspace(-0.008, 0.06, 2000)
    x, v, d = path_of("kelvin_voigt", {"K": K, "C": C}, 0.7, VELOCITY, time)
    figure, axes = plt.subplots(3, 1, sharex=True, figsize=(6, 5))
    peak = 1e3 * time[np.argmax(x)]
    rows = ((1e3 * x, "depth (mm)"), (v, "velocity (m/s)"), (d, "deceleration (m/s²)"))
    for axis, (values, label) in zip(axes, rows, strict=True):
        axis.plot(1e3 * time, values, color=BLUE)
        axis.axvline(0, color=GREY, ls="--", lw=0.8)
        axis.axvline(peak, color=GREY, ls=":", lw=0.8)
        axis.set(ylabel=label)
    axes[0].text(0.5, -11, "contact", color=GREY)
    axes[0].text(peak + 0.5, -11, "deepest", color=GREY)
    axes[2].annotate(
        "jump C V / M",
        (0, C * VELOCITY / 0.7),
        (12, 8),
        arrowprops={"arrowstyle": "->", "color": RED},
        color=RED,
    )
    axes[2].set(xlabel="time since contact (ms)")
    return figure


# What shows the shape of a loop better than K, C and the typical values of an element's further parameters.
SHOWN = {"maxwell": {"C": 60.0}, "wall": {"thickness_m": 0.05}}


def arrangements() -> plt.Figure:
    """Force against depth of each element, as shares of the greatest."""
    time = np.linspace(0, 0.15, 3000)
    names = elements.element_names()
    rows = -(-len(names) // 3)
    figure, axes = plt.subplots(rows, 3, sharex=True, sharey=True, squeeze=False, figsize=(7.5, 2.3 * rows))
    for axis in axes.flat[len(names) :]:
        axis.set_axis_off()
    for axis, name in zip(axes.flat, names, strict=False):
        typical = {each.name: each.typical for each in elements.element(name).extra}
        parameters = {"K": K, "C": C} | typical | SHOWN.get(name, {})
        x, _, d = path_of(name, parameters, 0.7, VELOCITY, time)
        within = slice(0, np.flatnonzero(d > 0)[-1] + 1)
        deepest = np.argmax(x)
        axis.plot(x[within] / x[deepest], d[within] / d[deepest], color=BLUE)
        axis.plot([0, 1], [0, 1], color=GREY, ls="--", lw=0.8)
        axis.set(title="impact" if name == "kelvin_voigt" else name)
    figure.supxlabel("depth / greatest depth")
    figure.supylabel("force / force there")
    return figure


def centring() -> plt.Figure:
    """K and C of one tissue about the rest position and about the sample mean."""
    time = np.arange(-0.005, 0.08, 1e-4)
    recordings = [
        (time, list(path_of("kelvin_voigt", {"K": K, "C": C}, m, VELOCITY, time))[2]) for m in MASSES
    ]
    impacts = pd.DataFrame({"impact": list("abcd"), "subject": "s", "trial": list("abcd"), "mass_kg": MASSES})
    dataset = bt.dataset(
        impacts.assign(velocity_m_s=VELOCITY),
        recordings,
        quantity="deceleration",
        unit="m/s^2",
        name="one tissue",
    )
    found = {method: bt.estimate(dataset, method=method) for method in ("impact", "dds")}
    figure, axes = plt.subplots(1, 2, figsize=(7.5, 3.2))
    for axis, column, truth, label in zip(
        axes, ("K_N_per_m", "C_N_s_per_m"), (K, C), ("K (N/m)", "C (N s/m)"), strict=True
    ):
        axis.axhline(truth, color=GREY, lw=0.8)
        axis.plot(MASSES, found["impact"][column], "o", color=BLUE, label="about the rest position")
        axis.plot(MASSES, found["dds"][column], "D", color=RED, mfc="none", label="about the sample mean")
        axis.set(xlabel="mass (kg)", ylabel=label, ylim=(0, None))
    axes[0].legend(frameon=False, loc="lower left")
    return figure


def exponent() -> plt.Figure:
    """What exponents 0 and 1 mean."""
    mass = np.linspace(0.3, 1.4, 100)
    figure, axes = plt.subplots(1, 2, figsize=(7.5, 3.2))
    for beta, colour in ((0, BLUE), (1, RED)):
        stiffness = K * (mass / 0.7) ** beta
        axes[0].plot(mass, stiffness, color=colour, label=f"exponent {beta}")
        axes[1].plot(mass, np.sqrt(stiffness / mass), color=colour)
    axes[0].set(xlabel="mass (kg)", ylabel="K (N/m)", ylim=(0, None))
    axes[1].set(xlabel="mass (kg)", ylabel="natural frequency (rad/s)", ylim=(0, None))
    axes[0].legend(frameon=False)
    return figure


def depth() -> plt.Figure:
    """Two masses on one stiffening tissue."""
    time = np.linspace(0, 0.05, 2000)
    parameters = {"K": 1500.0, "C": 1.0, "stiffening_depth_m": 0.015}
    figure, axis = plt.subplots(figsize=(5.5, 3.6))
    reached = {}
    for mass, colour in ((0.4, BLUE), (1.3, RED)):
        x, _, _ = path_of("stiffening", parameters, mass, VELOCITY, time)
        reached[mass] = deepest = x.max()
        at = deepest * np.array([0, 1])
        force = parameters["K"] * at * (1 + (at / parameters["stiffening_depth_m"]) ** 2)
        axis.plot(1e3 * at, force, "--", color=colour)
        axis.plot(1e3 * at[1], force[1], "o", color=colour, label=f"{mass} kg: greatest depth")
    x = np.linspace(0, max(reached.values()), 100)
    axis.plot(1e3 * x, parameters["K"] * x * (1 + (x / parameters["stiffening_depth_m"]) ** 2), color=GREY)
    axis.axvline(1e3 * min(reached.values()), color=GREY, ls=":", label="common depth")
    axis.set(xlabel="depth (mm)", ylabel="force of the spring (N)")
    axis.legend(frameon=False)
    return figure


def intervals() -> plt.Figure:
    """K of an impact and of people, of the example's committed fit."""
    table = pd.read_csv(ROOT / "reports" / "example" / "summary.csv")
    row_of = {(row.variable, str(row.label)): row for row in table.itertuples()}
    hit = next(label for name, label in row_of if name == "K")
    person = hit.split("-")[1]

    def as_it_is(value: float) -> float:
        return value

    shown = {
        f"an impact ({hit})": ("K", hit, as_it_is),
        f"a person ({person})": ("K_subject", person, as_it_is),
        "a typical person": ("intercept_K", "nan", np.exp),
        "a new person": ("K_new", "nan", as_it_is),
    }
    figure, axis = plt.subplots(figsize=(6.5, 2.6))
    for place, (name, label, scale) in enumerate(shown.values()):
        row = row_of[name, label]
        low, middle, high = (scale(q) for q in (row.eti90_low, row.median, row.eti90_high))
        axis.plot([low, high], [-place, -place], color=BLUE, lw=3, solid_capstyle="butt")
        axis.plot(middle, -place, "o", color=BLUE)
    axis.set(
        yticks=-np.arange(len(shown)), yticklabels=list(shown), xlabel="K (N/m): median and 90 % interval"
    )
    return figure


FIGURES = {
    "impact": impact,
    "elements": arrangements,
    "centring": centring,
    "depth": depth,
    "intervals": intervals,
    "exponent": exponent,
}


def main() -> None:
    """Write every figure as SVG, without its date."""
    runtime.configure()
    (HERE / "figures").mkdir(exist_ok=True)
    with mpl.rc_context(STYLE | {"backend": "agg"}):
        for name, draw in FIGURES.items():
            figure = draw()
            figure.savefig(HERE / "figures" / f"{name}.svg", metadata={"Date": None})
            plt.close(figure)


if __name__ == "__main__":
    main()
