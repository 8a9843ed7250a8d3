"""Figures as files for print, each with the rows that it is drawn from."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from pathlib import Path

from bayestissue.base.results.tables import write_table
from bayestissue.base.words import PLAIN, Words
from bayestissue.reports.figures.theme import Figure, Specification
from bayestissue.reports.paper import PRINT, WIDTH_MM

# Of CSS and of PostScript.
PIXELS_PER_INCH, POINTS_PER_INCH = 96, 72
_SIZE = re.compile(r'width="([\d.]+)" height="([\d.]+)"')


def write_figures(
    figures: Iterable[tuple[str, Callable[[], Figure]]],
    folder: Path,
    *,
    nouns: Words = PLAIN,
    width_mm: float = WIDTH_MM,
) -> None:
    """Write ``NAME.svg``, ``NAME.pdf``, ``NAME.png`` (300 dots an inch) and ``NAME.csv`` of each figure.

    Args:
        figures: a name fit for a file, and what makes the figure.
        folder: that exists.
        nouns: what the dataset calls people, conditions and impacts.
        width_mm: of each figure, in print.
    """
    import vl_convert

    in_print = POINTS_PER_INCH / PIXELS_PER_INCH
    for name, make in figures:
        figure = make()
        svg = _drawn(nouns.chart(figure.specification()), width_mm / 25.4 * PIXELS_PER_INCH)
        (folder / f"{name}.svg").write_text(svg, encoding="utf-8")
        # A unit of the drawing is a point of the page there, and not a pixel.
        points = _SIZE.sub(lambda size: _size(size, in_print), svg, count=1)
        (folder / f"{name}.pdf").write_bytes(vl_convert.svg_to_pdf(points))
        (folder / f"{name}.png").write_bytes(
            vl_convert.svg_to_png(svg, scale=in_print, ppi=PRINT.dots_per_inch)
        )
        write_table(figure.data, folder / f"{name}.csv")


def _drawn(chart: Specification, pixels: float) -> str:
    """The chart as SVG, so wide with titles and labels."""
    import vl_convert

    # A legend of three columns is wider than a journal's.
    chart["config"] = chart["config"] | {"legend": chart["config"]["legend"] | {"columns": 2}}
    if "vconcat" in chart:
        chart["vconcat"] = [panel | {"width": pixels - PRINT.label_pixels} for panel in chart["vconcat"]]
    elif "facet" in chart:
        # One panel below the other, as in a column of a journal there is room for one.
        across = max(1, min(chart["columns"], int(pixels // PRINT.panel_pixels)))
        width = pixels / across - PRINT.label_pixels
        chart |= {"columns": across, "spec": chart["spec"] | {"width": width}}
    else:
        chart |= {"width": pixels, "autosize": {"type": "fit-x", "contains": "padding"}}
    svg = vl_convert.vegalite_to_svg(chart)
    # Where a legend makes it wider all the same, it is drawn so much smaller.
    return _SIZE.sub(lambda size: _size(size, pixels / float(size.group(1))), svg, count=1)


def _size(size: re.Match[str], factor: float) -> str:
    width, height = (factor * float(length) for length in size.groups())
    return f'width="{width:.2f}" height="{height:.2f}"'
