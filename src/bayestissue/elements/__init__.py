"""What an impactor may meet: arrangements of spring and damper, one file each, and their impacts."""

from bayestissue.elements.comparables import Comparables, comparables
from bayestissue.elements.element import REFERENCE_DIAMETER_M, Element, Parameter
from bayestissue.elements.impact import Impact, impact
from bayestissue.elements.registry import element, element_names

__all__ = [
    "REFERENCE_DIAMETER_M",
    "Comparables",
    "Element",
    "Impact",
    "Parameter",
    "comparables",
    "element",
    "element_names",
    "impact",
]
