"""What a lab may choose on the way from a recording to a displacement: the ``[signal]`` table of a model."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from bayestissue.errors import InputError
from bayestissue.resources import model_content
from bayestissue.settings import Table, checked

type Window = Literal["peak", "rebound"] | Annotated[float, Field(gt=0, le=1)]


class SignalOptions(Table):
    """Where contact is in a recording, and which part of it from there on is used.

    Attributes:
        contact: automatic: between the last quiet sample and the first that is not, and within that gap where
            the trace is most nearly that of a spring and damper met at the recorded velocity; time-zero: time
            0 of the recording; threshold: where d first exceeds 5 % of its peak.
        window: peak: from contact to zero velocity, as in the thesis; a number between 0 and 1: that fraction
            of the time to zero velocity; rebound: until the tissue no longer pushes.
    """

    contact: Literal["automatic", "time-zero", "threshold"] = "automatic"
    window: Window = "peak"


def read_signal_options(path: Path) -> SignalOptions:
    """The ``[signal]`` table of a model file; a choice that it leaves out keeps its default.

    Raises:
        InputError: the file can't be read, or the table holds a key or a value that is not allowed; each
            one is named, with what is allowed.
    """
    table = model_content(path).get("signal", {})
    if not isinstance(table, dict):
        raise InputError.stated("key-value.table", str(path), column="signal", value=table)
    return checked(table, SignalOptions, file=str(path), within=("signal",))
