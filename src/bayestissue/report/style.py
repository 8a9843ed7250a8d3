"""How every figure looks: one palette, one size of type, and no state shared with anyone else's plots."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import matplotlib as mpl
from matplotlib.figure import Figure
from matplotlib.rcsetup import cycler
from matplotlib.ticker import LogFormatterSciNotation, LogLocator, NullLocator

INK = "#1f2328"
MUTED = "#6a737d"
FAINT = "#d0d7de"

# Okabe and Ito's colours. The first four differ in lightness too, so that a grey print tells them apart;
# with more than four, and wherever two quantities share axes, the shape of the mark differs as well.
PALETTE = ("#0072B2", "#E69F00", "#000000", "#D55E00", "#56B4E9", "#CC79A7", "#009E73")

POSTERIOR, PUBLISHED, REFERENCE = PALETTE[0], PALETTE[3], INK

PANEL = (4.8, 3.5)

_FEW_FOLD, _MANY_FOLD = 8, 1e5

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
    "xtick.color": MUTED,
    "xtick.labelcolor": INK,
    "ytick.color": MUTED,
    "ytick.labelcolor": INK,
}


@contextmanager
def style() -> Iterator[None]:
    """Matplotlib's settings for the length of a block; what was set before comes back after it."""
    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update(_RC)
        yield


def log_ticks(axis: Any, values: Any) -> None:
    """Label a logarithmic ``axis`` over ``values`` in plain numbers, as many as there is room for."""
    positive = [float(value) for value in values if value > 0]
    span = max(positive) / min(positive) if positive else 1.0
    axis.set_major_locator(
        LogLocator(subs=tuple(range(1, 10)) if span < _FEW_FOLD else (1, 2, 5), numticks=50)
    )
    axis.set_major_formatter("{x:g}" if span < _MANY_FOLD else LogFormatterSciNotation())
    axis.set_minor_locator(NullLocator())


def new_figure(
    size: tuple[float, float] = PANEL, rows: int = 1, columns: int = 1, **axes: Any
) -> tuple[Figure, Any]:
    """A figure of ``size`` inches and its axes, outside pyplot: nothing to close, no display needed.

    Call it inside `style`. ``axes`` is passed on to `Figure.subplots` (``sharex``, ``width_ratios`` ...).
    """
    figure = Figure(figsize=size)
    return figure, figure.subplots(rows, columns, **axes)
