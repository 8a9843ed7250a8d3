"""What formulas are of: log K, log C and an element's further parameters."""

from __future__ import annotations

RESPONSES = ("K", "C")


def parameter_of(response: str) -> str:
    """The impact's parameter that a formula is of, by its name in the hierarchy: K, ``log_thickness_m``."""
    return response if response in RESPONSES else f"log_{response}"


def intercept(parameter: str) -> str:
    """The name of an impact's parameter at the reference row; without covariates that is the mean of all."""
    return f"intercept_{parameter}" if parameter in RESPONSES else f"{parameter}_mean"


def sd_impact(parameter: str) -> str:
    """The name of its standard deviation between impacts."""
    return f"sd_impact_{parameter}" if parameter in RESPONSES else f"sd_{parameter}"
