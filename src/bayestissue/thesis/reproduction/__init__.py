"""The published results: recomputed, audited, compared."""

from bayestissue.thesis.reproduction.figures_data import MassFigure, correlation_figure, mass_figure
from bayestissue.thesis.reproduction.reproduce import reproduce_published

__all__ = ["MassFigure", "correlation_figure", "mass_figure", "reproduce_published"]
