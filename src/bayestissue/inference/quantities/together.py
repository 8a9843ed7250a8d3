"""Stiffness and damping of the recorded impacts together, and of those of each person, pad or the like."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import xarray as xr

from bayestissue.model.hierarchy.formulas.group_terms import stem_of

# The draws of an impact that each is made of. On a spring and damper side by side the secant stiffness is K
# itself, and C is the equivalent damping.
_SOURCES = {"K_secant": ("K_secant", "K"), "C_equivalent": ("C_equivalent", "C")}
OF_IMPACTS = tuple(f"{name}_of_impacts" for name in _SOURCES)
OF_PEOPLE = tuple(f"{name}_of_subject" for name in _SOURCES)


def comparable_draws(posterior: xr.Dataset, groups: Mapping[str, np.ndarray]) -> dict[str, xr.DataArray]:
    """Stiffness and damping that mean the same for every element, of these impacts and of groups of them.

    The geometric means over all recorded impacts, and over those of each level of a grouping, of the secant
    stiffness and of the equivalent damping: for K, exp((1/n) sum_i log K_secant,i), by draw.

    Args:
        posterior: with "K" and "C" [chain, draw or kept draw, impact], and "K_secant" and "C_equivalent"
            where the run's element has them. Nothing comes of a run without single impacts.
        groups: [impact], each impact's level, by grouping, such as whose it is, by "subject".

    Returns:
        By name, such as "K_secant_of_impacts" [chain, draw] or "K_secant_of_subject" [chain, draw, subject].
    """
    comparable: dict[str, xr.DataArray] = {}
    for name, sources in _SOURCES.items():
        source = next((candidate for candidate in sources if candidate in posterior), None)
        if source is None or "impact" not in posterior[source].dims:
            continue
        logs = xr.apply_ufunc(np.log, posterior[source])
        means = {"impacts": logs.mean("impact")} | {
            stem_of(of): logs.assign_coords({of: ("impact", levels)}).groupby(of).mean("impact")
            for of, levels in groups.items()
        }
        comparable |= {f"{name}_of_{of}": xr.apply_ufunc(np.exp, mean) for of, mean in means.items()}
    return comparable
