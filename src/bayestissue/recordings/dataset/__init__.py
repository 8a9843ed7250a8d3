"""What a lab brings in: folder layout, recorder formats, units, validation, and the published tables."""

from __future__ import annotations

from bayestissue.recordings.dataset.dataset_file import LowPassFilter, Quantity, Uncertainty
from bayestissue.recordings.dataset.model import Dataset
from bayestissue.recordings.dataset.ragged_traces import Trace, Traces
from bayestissue.recordings.dataset.read import as_dataset, read_dataset
from bayestissue.recordings.dataset.write import write_dataset

__all__ = [
    "Dataset",
    "LowPassFilter",
    "Quantity",
    "Trace",
    "Traces",
    "Uncertainty",
    "as_dataset",
    "read_dataset",
    "write_dataset",
]
