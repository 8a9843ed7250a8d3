"""What known springs and phantoms say of the measuring chain, and whether what was declared allows it."""

from __future__ import annotations

from typing import Any

import numpy as np

from bayestissue.hierarchy.reference import HALF_WIDTH, Reference
from bayestissue.inference.checking import sentence

# Of standard deviations, beyond which phantoms contradict what is declared of the mass: once in 370.
_LIMIT = 3.0


def judge_reference(reference: Reference) -> dict[str, Any]:
    """The entry ``reference`` of ``diagnostics.json``, of a fit with phantoms.

    Returns:
        ``passed``: whether what phantoms say of log f is within three standard deviations of 0, that of
        the declared mass counted in; ``mass_factor``, its 90 % interval about the median; ``impacts``, how
        many were of phantoms, and ``phantoms`` their names; ``first``, what the first line of the run says;
        ``words``.
    """
    mean, sd = reference.apart
    passed = abs(mean) <= _LIMIT * np.hypot(sd, reference.mass_sd)
    low, middle, high = np.exp(reference.log_mean + reference.log_sd * HALF_WIDTH * np.array([-1, 0, 1]))
    off = 100 * (np.exp(-mean) - 1)
    numbers = {
        "size": f"{abs(off):.2g} % {'high' if off > 0 else 'low'}",
        "give": f"{100 * HALF_WIDTH * sd:.2g} %",
        "impacts": len(reference.table),
        "factor": f"{middle:.4g} ({low:.4g} to {high:.4g})",
        "declared": f"{100 * reference.mass_sd:.2g} %",
    }
    return {
        "passed": bool(passed),
        "impacts": len(reference.table),
        "phantoms": reference.table["impact"].astype(str).tolist(),
        "mass_factor": [float(low), float(middle), float(high)],
        "first": sentence("reference.first", **numbers),
        "words": sentence("reference.corrected" if passed else "reference.contradicted", **numbers),
    }
