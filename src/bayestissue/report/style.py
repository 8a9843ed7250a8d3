"""How every figure looks: one palette, one size of type, and no state shared with anyone else's plots."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import matplotlib as mpl
from matplotlib.figure import Figure
from matplotlib.rcsetup import cycler
from matplotlib.ticker import LogLocator, NullFormatter, NullLocator

INK = "#1f2328"
MUTED = "#6a737d"
FAINT = "#d0d7de"

# Okabe and Ito's colours. The first four differ in lightness too, so that a grey print tells them apart;
# with more than four, and wherever two quantities share axes, the shape of the mark differs as well.
PALETTE = ("#0072B2", "#E69F00", "#000000", "#D55E00", "#56B4E9", "#CC79A7", "#009E73")

POSTERIOR, PUBLISHED, REFERENCE = PALETTE[0], PALETTE[3], INK

PANEL = (4.8, 3.5)

_FEW_FOLD, _MANY_FOLD = 8, 1e5
_LONGEST = 28
_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
# Of no concern: the reader's browser draws the text of a page, with fonts of its own.
_OF_TEXT = (
    "Glyph .* missing from",
    "Matplotlib currently does not support",
    "constrained_layout not applied",
)

_RC: dict[str, Any] = {
    "axes.edgecolor": MUTED,
    "axes.grid": True,
    "axes.labelcolor": INK,
    "axes.labelsize": 10,
    "axes.linewidth": 0.8,
    "axes.prop_cycle": cycler("color", PALETTE),
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlelocation": "left",
    "axes.titlesize": 10.5,
    "axes.titleweight": "bold",
    "figure.constrained_layout.use": True,
    "figure.dpi": 96,
    "figure.facecolor": "white",
    "font.family": ["DejaVu Sans"],
    "font.size": 9.5,
    "grid.color": FAINT,
    "grid.linewidth": 0.6,
    "legend.fontsize": 8.5,
    "legend.frameon": False,
    "lines.linewidth": 1.6,
    "savefig.facecolor": "white",
    # Text stays text: it can be searched and read aloud, and the file is smaller.
    "svg.fonttype": "none",
    # Element names are hashes; a fixed salt makes the same figure the same bytes.
    "svg.hashsalt": "bayestissue",
    # Names come from the data: what stands between two dollars in them is no formula.
    "text.parse_math": False,
    "xtick.color": MUTED,
    "xtick.labelcolor": INK,
    "ytick.color": MUTED,
    "ytick.labelcolor": INK,
}


@contextmanager
def style() -> Iterator[None]:
    """Matplotlib's settings for the length of a block; what was set before comes back after it.

    Setting them takes as long as a small figure: within a block they stand already.
    """
    if mpl.rcParams["svg.hashsalt"] == _RC["svg.hashsalt"]:
        yield
        return
    with mpl.rc_context(), warnings.catch_warnings():
        mpl.rcdefaults()
        mpl.rcParams.update(_RC)
        for message in _OF_TEXT:
            warnings.filterwarnings("ignore", message)
        yield


def shown(name: str) -> str:
    """A name from the data as a label: the middle of a long one is left out."""
    name = " ".join(name.split())
    if len(name) > _LONGEST:
        name = f"{name[: _LONGEST // 2 - 1]}…{name[-_LONGEST // 2 :]}"
    # A legend leaves out what begins with an underscore; a space of no width goes before it.
    return f"\u200b{name}" if name.startswith("_") else name


def label_in_powers(axis: Any) -> None:
    """Label a logarithmic ``axis`` at powers of ten, as plain text."""
    axis.set_major_formatter(power_of_ten)
    axis.set_minor_formatter(NullFormatter())


def power_of_ten(value: float, _: int | None = None) -> str:
    """A number on a logarithmic axis, such as 10⁻³ or 2·10⁵."""
    exponent = math.floor(math.log10(value) + 1e-9)
    power, factor = f"10{str(exponent).translate(_RAISED)}", f"{value / 10.0**exponent:.3g}"
    return power if factor == "1" else f"{factor}·{power}"


def log_ticks(axis: Any, values: Any) -> None:
    """Label a logarithmic ``axis`` over ``values`` in plain numbers, as many as there is room for."""
    positive = [float(value) for value in values if value > 0]
    span = max(positive) / min(positive) if positive else 1.0
    axis.set_major_locator(
        LogLocator(subs=tuple(range(1, 10)) if span < _FEW_FOLD else (1, 2, 5), numticks=50)
    )
    axis.set_major_formatter("{x:g}" if span < _MANY_FOLD else power_of_ten)
    axis.set_minor_locator(NullLocator())


def new_figure(
    size: tuple[float, float] = PANEL, rows: int = 1, columns: int = 1, **axes: Any
) -> tuple[Figure, Any]:
    """A figure of ``size`` inches and its axes, outside pyplot: nothing to close, no display needed.

    Call it inside `style`. ``axes`` is passed on to `Figure.subplots` (``sharex``, ``width_ratios`` ...).
    """
    figure = Figure(figsize=size)
    return figure, figure.subplots(rows, columns, **axes)
