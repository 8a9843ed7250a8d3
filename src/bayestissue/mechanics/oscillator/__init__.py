"""The physics: (K, C, M), (omega_n, zeta) and (phi1, phi2, theta1), and the ways between them."""

from bayestissue.mechanics.oscillator.contact_path import (
    ContactPath,
    contact_duration,
    impact_motion,
    peak_deceleration,
    peak_displacement,
    peak_jerk,
    restitution,
    spring_damper,
    spring_damper_inverse,
    time_to_peak,
)
from bayestissue.mechanics.oscillator.discrete import (
    Differences,
    arccos_branch,
    from_differences,
    to_continuous,
    to_differences,
    to_discrete,
)

__all__ = [
    "ContactPath",
    "Differences",
    "arccos_branch",
    "contact_duration",
    "from_differences",
    "impact_motion",
    "peak_deceleration",
    "peak_displacement",
    "peak_jerk",
    "restitution",
    "spring_damper",
    "spring_damper_inverse",
    "time_to_peak",
    "to_continuous",
    "to_differences",
    "to_discrete",
]
