"""What a lab brings in: folder layout, recorder formats, units, validation, and the published tables.

This package can be called: ``bayestissue.dataset(impacts, traces, quantity=..., unit=...)`` is
`bayestissue.dataset.arrays.dataset`, whose name it shares.
"""

from __future__ import annotations

import sys
from importlib import import_module
from inspect import getdoc, signature
from types import ModuleType
from typing import Any

from bayestissue.dataset.arrays import dataset as _from_arrays
from bayestissue.dataset.model import Dataset
from bayestissue.dataset.read import as_dataset, read_dataset
from bayestissue.dataset.settings import LowPassFilter, Quantity, Uncertainty
from bayestissue.dataset.traces import Trace, Traces
from bayestissue.dataset.write import write_dataset

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


class _Callable(ModuleType):
    """A package under whose name its users expect a function too."""

    __wrapped__ = staticmethod(_from_arrays)

    def __call__(self, *args: Any, **kwargs: Any) -> Dataset:
        return _from_arrays(*args, **kwargs)

    def __reduce__(self) -> tuple[Any, tuple[str]]:
        """Pickled by its name."""
        return import_module, (self.__name__,)


sys.modules[__name__].__class__ = _Callable
# What `help` shows of a package is this text.
__doc__ = f"bayestissue.dataset{signature(_from_arrays)}\n\n{getdoc(_from_arrays)}\n\n{__doc__}"
