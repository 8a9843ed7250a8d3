"""Exact likelihood of a whole impact as an ARMA(2,1) or a sampled A(2), by sine transforms."""

from __future__ import annotations

from bayestissue.model.likelihood.arma.arma21 import arma21_log_likelihood
from bayestissue.model.likelihood.transforms import SineTransforms, sine_transforms

__all__ = ["SineTransforms", "arma21_log_likelihood", "sine_transforms"]
