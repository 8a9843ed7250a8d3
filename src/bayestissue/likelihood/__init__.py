"""Exact likelihood of a whole impact as an ARMA(2,1) or a sampled A(2), by sine transforms."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from bayestissue.likelihood.arma.arma21 import arma21_log_likelihood, log_likelihood
from bayestissue.likelihood.transforms import SineTransforms, sine_transforms

if TYPE_CHECKING:
    from bayestissue.likelihood.arma.distributions import ARMA21

__all__ = ["ARMA21", "SineTransforms", "arma21_log_likelihood", "log_likelihood", "sine_transforms"]


def __getattr__(name: str) -> Any:
    # Point estimates need the likelihood, but no distribution, nor the wait for numpyro.
    if name == "ARMA21":
        from bayestissue.likelihood.arma.distributions import ARMA21

        return ARMA21
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
