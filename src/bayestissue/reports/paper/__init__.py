"""What a paper takes from a finished fit: methods and results as text, tables as a workbook, figures."""

from dataclasses import dataclass

# Of a figure in print: a journal's column.
WIDTH_MM = 85.0


@dataclass(frozen=True)
class Print:
    """How figures and tables are set.

    Attributes:
        dots_per_inch: of a bitmap; journals ask for 300 of what is no line drawing.
        panel_pixels: pixels at the least of a panel beside others.
        label_pixels: pixels that labels and titles take of the width where panels stand one above the other.
        widest: letters of a column of the workbook; longer text is cut on the screen.
    """

    dots_per_inch: int = 300
    panel_pixels: int = 200
    label_pixels: int = 75
    widest: int = 60


PRINT = Print()
