"""What others measured by hitting tissue, and which of it compares with a study."""

from bayestissue.literature.measurements import (
    FACTOR,
    MEASURED,
    SITES,
    Comparable,
    Measurement,
    Range,
    Source,
    comparable,
    measurements,
)

__all__ = [
    "FACTOR",
    "MEASURED",
    "SITES",
    "Comparable",
    "Measurement",
    "Range",
    "Source",
    "comparable",
    "measurements",
]
