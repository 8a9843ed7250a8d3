"""What an impactor may meet: arrangements of spring and damper, one file each, and their impacts."""

from bayestissue.mechanics.elements.element import REFERENCE_DIAMETER_M, Element, Outcomes
from bayestissue.mechanics.elements.library import element, element_names
from bayestissue.mechanics.elements.outcomes import outcomes
from bayestissue.mechanics.elements.whole_impact import impact

__all__ = [
    "REFERENCE_DIAMETER_M",
    "Element",
    "Outcomes",
    "element",
    "element_names",
    "impact",
    "outcomes",
]
