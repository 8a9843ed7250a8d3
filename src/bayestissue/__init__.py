"""Bayesian, uncertainty-aware stiffness K and damping C of soft tissue from recorded impacts.

The public names below load on first use, so that importing the package costs nothing.
"""

from __future__ import annotations

from importlib import import_module

# As `typing` has it, whose import would be most of what this costs: no command can be stopped before.
TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

_PUBLIC: dict[str, str] = {
    "Dataset": "bayestissue.dataset",
    "read_dataset": "bayestissue.dataset",
    "Fit": "bayestissue.fitting",
    "fit": "bayestissue.fitting",
    "InputError": "bayestissue.errors",
    "Problem": "bayestissue.errors",
    "estimate": "bayestissue.inference.estimates",
    "arma21_log_likelihood": "bayestissue.likelihood",
    "spring_damper": "bayestissue.oscillator",
    "to_continuous": "bayestissue.oscillator",
    "to_discrete": "bayestissue.oscillator",
}

__all__ = sorted(_PUBLIC)


def __getattr__(name: str) -> Any:
    if name not in _PUBLIC:
        raise AttributeError(f"module 'bayestissue' has no attribute {name!r}")
    value = getattr(import_module(_PUBLIC[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted([*globals(), *_PUBLIC])
