"""Small panels of impacts, so many to a figure: how the pages of `check` and `init` show recordings."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from markupsafe import Markup

from bayestissue.report.page import figure
from bayestissue.report.style import new_figure, shown, style

# Draws one impact's panel, by its row in the dataset.
Panel = Callable[[Any, int], None]


def sheets(
    names: Sequence[str],
    which: np.ndarray,
    panel: Panel,
    *,
    rows: int,
    columns: int,
    size: tuple[float, float],
    alt: str,
    time: str,
    value: str = "",
) -> list[Markup]:
    """Figures of a panel for each impact.

    Args:
        names: of all impacts.
        which: rows of those to show.
        panel: draws one.
        rows: of panels in a full figure.
        columns: of panels.
        size: width of a figure, and its height besides the rows of panels [inch].
        alt: what a panel shows, before "for the impacts" and their names.
        time: label of the horizontal axes.
        value: label of the vertical axes; none unless given.
    """

    def sheet(part: np.ndarray) -> Markup:
        lines = -(-len(part) // columns)
        with style():
            fig, axes = new_figure((size[0], size[1] + 1.75 * lines), lines, columns, squeeze=False)
            for ax, index in zip(axes.flat, part, strict=False):
                panel(ax, int(index))
                ax.set_title(shown(names[index]), fontsize=8)
            for ax in axes.flat[len(part) :]:
                ax.remove()
            handles, labels = axes[0, 0].get_legend_handles_labels()
            fig.legend(handles, labels, loc="outside upper right", ncols=4)
            fig.supxlabel(time, fontsize=9)
            if value:
                fig.supylabel(value, fontsize=9)
            listed = ", ".join(str(names[index]) for index in part)
            return figure(fig, f"{alt} for the impacts {listed}.", raster=True)

    full = rows * columns
    return [sheet(which[begin : begin + full]) for begin in range(0, len(which), full)]
