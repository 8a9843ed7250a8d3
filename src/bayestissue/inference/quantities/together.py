"""Stiffness and damping of the recorded impacts together, and of each person's own."""

from __future__ import annotations

import numpy as np
import xarray as xr

# By what it is called: the draws of an impact that it is made of. On a spring and damper side by side the
# secant stiffness is K itself, and C is the equivalent damping.
OF_IMPACTS = {"K_secant_of_impacts": ("K_secant", "K"), "C_equivalent_of_impacts": ("C_equivalent", "C")}
OF_PEOPLE = {"K_secant_of_subject": ("K_secant", "K"), "C_equivalent_of_subject": ("C_equivalent", "C")}


def comparable_draws(posterior: xr.Dataset, people: np.ndarray) -> dict[str, xr.DataArray]:
    """Stiffness and damping that mean the same for every element, of these impacts and of each person's.

    The geometric means over all recorded impacts, and over each person's own, of the secant stiffness and
    of the equivalent damping: for K, exp((1/n) sum_i log K_secant,i), by draw.

    Args:
        posterior: with "K" and "C" [chain, draw or kept draw, impact], and "K_secant" and "C_equivalent"
            where the run's element has them. Nothing comes of a run without single impacts.
        people: [impact], whose each impact is.

    Returns:
        By name, [chain, draw] or [chain, draw, subject].
    """
    comparable = {}
    for name, sources in {**OF_IMPACTS, **OF_PEOPLE}.items():
        source = next((candidate for candidate in sources if candidate in posterior), None)
        if source is None or "impact" not in posterior[source].dims:
            continue
        logs = xr.apply_ufunc(np.log, posterior[source])
        if name in OF_PEOPLE:
            mean = logs.assign_coords(subject=("impact", people)).groupby("subject").mean("impact")
        else:
            mean = logs.mean("impact")
        comparable[name] = xr.apply_ufunc(np.exp, mean)
    return comparable
