"""What a lab brings in: folder layout, recorder formats, units, validation, and the published tables."""

from bayestissue.dataset.model import Dataset, Quantity, Trace, Uncertainty
from bayestissue.dataset.read import read_dataset
from bayestissue.dataset.write import write_dataset

__all__ = ["Dataset", "Quantity", "Trace", "Uncertainty", "read_dataset", "write_dataset"]
