"""What tells the mass of tissue that moves along: a force below it, the velocity, or the prior alone."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

from bayestissue.elements import element
from bayestissue.hierarchy.effects import intercept, parameter_of
from bayestissue.hierarchy.force import tells_added_mass
from bayestissue.hierarchy.trace_data import Prepared
from bayestissue.inference.checking import sentence
from bayestissue.inference.results.meanings import MOSTLY
from bayestissue.inference.results.summary import prior_overlap


def judge_added_mass(prepared: Prepared, posterior: xr.Dataset, prior: xr.Dataset) -> dict[str, Any]:
    """The entry ``added_mass`` of ``diagnostics.json``; empty where no tissue moves along by the element.

    A deceleration is that of K / (M + m) and C / (M + m), met at V M / (M + m): only its height over V tells
    m, and K and C with it. A force below the tissue is (1 + m / M) M d and tells m by itself.

    Args:
        prepared: the fit.
        posterior: of it.
        prior: of it.

    Returns:
        ``parameter``, m's name; ``by``, what tells it: "force" or "velocity"; ``overlap``, of the posterior
        of its mean over impacts with the prior; ``passed``, whether that is less than half; ``first``, what
        the first line of the run is to say, if anything; ``words``.
    """
    which = element(prepared.model.element)
    if which.added_mass is None:
        return {}
    name = next(one.name for one in which.extra if one.of_mass)
    mean = intercept(parameter_of(name))
    overlap = prior_overlap(posterior[mean].to_numpy(), prior[mean].to_numpy())
    by_force = prepared.force is not None and tells_added_mass(prepared.force, which.name)
    informed = bool(overlap <= MOSTLY)
    low, middle, high = np.quantile(np.exp(posterior[mean].to_numpy()), (0.05, 0.5, 0.95))
    numbers = {
        "name": name,
        "overlap": f"{100 * overlap:.0f} %",
        "mass": f"{middle:.2g} kg (90 % interval {low:.2g} to {high:.2g} kg)",
    }
    kind = "prior" if not informed else "force" if by_force else "velocity"
    remedy = "" if by_force else sentence("added_mass.remedy")
    return {
        "parameter": name,
        "by": "force" if by_force else "velocity",
        "overlap": overlap,
        "passed": informed,
        "first": "" if kind == "force" else sentence(f"added_mass.first_{kind}", **numbers),
        "words": f"{sentence(f'added_mass.{kind}', **numbers)} {remedy}".strip(),
    }
