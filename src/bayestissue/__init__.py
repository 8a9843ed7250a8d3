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
    "dataset": "bayestissue.dataset",
    "read_dataset": "bayestissue.dataset",
    "init_dataset": "bayestissue.intake",
    "Certificate": "bayestissue.certificate.certificate",
    "Check": "bayestissue.checking",
    "Comparison": "bayestissue.comparing",
    "Estimates": "bayestissue.report.estimates_page",
    "Fit": "bayestissue.finished",
    "Impact": "bayestissue.one_impact",
    "InputError": "bayestissue.errors",
    "Plan": "bayestissue.planning.plan",
    "Problem": "bayestissue.errors",
    "read_run": "bayestissue.finished",
}
# What computes with JAX, and so in float64, whatever the caller's setting is.
_COMPUTED: dict[str, str] = {
    "certify": "bayestissue.certificate.certificate",
    "check": "bayestissue.checking",
    "compare": "bayestissue.comparing",
    "fit": "bayestissue.fitting",
    "impact": "bayestissue.one_impact",
    "numpyro_model": "bayestissue.fitting",
    "plan": "bayestissue.planning.plan",
    "estimate": "bayestissue.report.estimates_page",
}
# What does too, compiled, and takes arrays.
_NUMERIC: dict[str, str] = {
    "arma21_log_likelihood": "bayestissue.likelihood",
    "spring_damper": "bayestissue.oscillator",
    "to_continuous": "bayestissue.oscillator",
    "to_discrete": "bayestissue.oscillator",
}

__all__ = sorted([*_PUBLIC, *_COMPUTED, *_NUMERIC])


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version

        return version(__name__)
    if name not in __all__:
        raise AttributeError(f"module 'bayestissue' has no attribute {name!r}")
    module = import_module((_PUBLIC | _COMPUTED | _NUMERIC)[name])
    if name in globals():
        # A package of this name, which can be called.
        return module
    value = getattr(module, name)
    if name not in _PUBLIC:
        from bayestissue.runtime import in_float64, of_arrays

        value = in_float64(of_arrays(value) if name in _NUMERIC else value)
        # Where it is found under its name, by pickle too.
        value.__module__ = __name__
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
