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
    "Dataset": "bayestissue.recordings.dataset",
    "dataset": "bayestissue.recordings.dataset.arrays",
    "read_dataset": "bayestissue.recordings.dataset",
    "init_dataset": "bayestissue.studies.init",
    "Certificate": "bayestissue.studies.certificate.certificate",
    "Check": "bayestissue.studies.checking",
    "Comparison": "bayestissue.studies.comparing",
    "Estimates": "bayestissue.studies.estimates",
    "Fit": "bayestissue.studies.finished",
    "Impact": "bayestissue.studies.one_impact",
    "InputError": "bayestissue.base.errors",
    "Plan": "bayestissue.studies.planning.plan",
    "Problem": "bayestissue.base.errors",
    "read_run": "bayestissue.studies.finished",
}
# What computes with JAX, and so in float64, whatever the caller's setting is.
_COMPUTED: dict[str, str] = {
    "certify": "bayestissue.studies.certificate.certificate",
    "check": "bayestissue.studies.checking",
    "compare": "bayestissue.studies.comparing",
    "fit": "bayestissue.studies.fitting",
    "impact": "bayestissue.studies.one_impact",
    "numpyro_model": "bayestissue.studies.fitting",
    "plan": "bayestissue.studies.planning.plan",
    "estimate": "bayestissue.studies.estimates",
}
# What does too, compiled, and takes arrays.
_NUMERIC: dict[str, str] = {
    "arma21_log_likelihood": "bayestissue.model.likelihood.arma21",
    "spring_damper": "bayestissue.mechanics.oscillator",
    "to_continuous": "bayestissue.mechanics.oscillator",
    "to_discrete": "bayestissue.mechanics.oscillator",
}

__all__ = sorted([*_PUBLIC, *_COMPUTED, *_NUMERIC])


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version

        return version(__name__)
    if name not in __all__:
        raise AttributeError(f"module 'bayestissue' has no attribute {name!r}")
    module = import_module((_PUBLIC | _COMPUTED | _NUMERIC)[name])
    value = getattr(module, name)
    if name not in _PUBLIC:
        from bayestissue.base.runtime import in_float64, of_arrays

        value = in_float64(of_arrays(value) if name in _NUMERIC else value)
        # Where it is found under its name, by pickle too.
        value.__module__ = __name__
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
