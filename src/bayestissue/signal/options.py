"""What a lab may choose on the way from a recording to a displacement: the ``[signal]`` table of a model."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from bayestissue.errors import InputError
from bayestissue.resources import model_content
from bayestissue.settings import Table, checked

type FilterClass = Literal["none", 60, 180, 600, 1000]
type Window = Literal["peak", "rebound"] | Annotated[float, Field(gt=0, le=1)]


class SignalOptions(Table):
    """How x(t) is made from the recorded d(t); the defaults are those of ``models/exact.toml``.

    Attributes:
        contact: automatic: between the last quiet sample and the first that is not, and within that gap where
            the trace is most nearly that of a spring and damper met at the recorded velocity; time-zero: time
            0 of the recording; threshold: where d first exceeds threshold times its peak.
        threshold: fraction of the peak of d, for contact = 'threshold'.
        remove_offset: subtract the mean of the quiet part before contact, where there is one.
        filter: channel frequency class of SAE J211-1: a four-pole phaseless Butterworth low-pass with its -3
            dB corner at 5/3 of the class, in Hz. It is applied from contact on, so that the jump of d at
            contact, which is physical, is not smeared.
        integration: rule of both integrations. trapezoidal is the thesis's, with an error of order (interval
            x pole)^2; quintic integrates the quintic through six neighbouring samples.
        window: peak: from contact to zero velocity, as in the thesis; a number between 0 and 1: that fraction
            of the time to zero velocity; rebound: until the tissue no longer pushes.
        equilibrium: what x is measured from: the position at contact, where the tissue is at rest, or, as in
            section 2.3 of the thesis, its own mean over the window. estimated: from contact, and a fit lets
            the rest position lie anywhere within the trace's reach of it; a point estimate takes it as rest.
    """

    contact: Literal["automatic", "time-zero", "threshold"] = "automatic"
    threshold: Annotated[float, Field(gt=0, lt=1)] = 0.05
    remove_offset: bool = True
    filter: FilterClass = "none"
    integration: Literal["quintic", "trapezoidal"] = "quintic"
    window: Window = "peak"
    equilibrium: Literal["rest", "sample-mean", "estimated"] = "rest"


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


def alternatives(choice: str, options: SignalOptions) -> tuple[SignalOptions, ...]:
    """``options`` with one choice (contact, filter, window, integration, equilibrium) at each of its values.

    Raises:
        InputError: there is no such choice.
    """
    values: dict[str, tuple[object, ...]] = {
        "contact": ("automatic", "threshold", "time-zero"),
        "filter": ("none", 1000, 600, 180, 60),
        "window": (0.25, 0.5, 0.75, "peak", "rebound"),
        "integration": ("quintic", "trapezoidal"),
        "equilibrium": ("rest", "sample-mean"),
    }
    if choice not in values:
        raise InputError.stated("option-value.vary", "--vary", value=choice, choices=", ".join(values))
    return tuple(options.model_copy(update={choice: value}) for value in values[choice])
