"""One impact out of the file of a recorder: CSV, Parquet, LabVIEW .lvm, NI .tdms, MATLAB .mat."""

from __future__ import annotations

import io
import logging
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64

from bayestissue.dataset import mat5, mat73
from bayestissue.dataset.files import read_bytes, require_small
from bayestissue.dataset.headers import header
from bayestissue.dataset.settings import SignalSettings
from bayestissue.dataset.tables import TABLE_SUFFIXES, Numbers, read_table
from bayestissue.errors import InputError, Problem

REMEDY = "Correct the cell in column trace of impacts.csv, or put the file there."


@dataclass(frozen=True)
class Recording:
    """What a file holds of one impact, in the recorder's units.

    Attributes:
        value: the raw samples.
        time: the time channel in the dataset's time unit, if the file has one.
        clock: the recorder's own time in s, if the format carries one and there is no time channel.
        first_row: the row, or in a binary file the number, of the first sample.
        text: what stood in cells that held no number, by the index of the sample.
    """

    value: Float64[np.ndarray, " sample"]
    time: Float64[np.ndarray, " sample"] | None = None
    clock: Float64[np.ndarray, " sample"] | None = None
    first_row: int = 1
    text: dict[int, str] | None = None


@dataclass(frozen=True)
class _Channel:
    values: np.ndarray
    clock: np.ndarray | None = None


def read_recording(path: Path, label: str, signal: SignalSettings) -> Recording:
    """Read the recording of one impact.

    The channel ``signal.value_column`` holds the values; where that was left at its default, the only
    channel of a file will do. Time is the channel ``signal.time_column``, else the recorder's own clock.

    Args:
        path: the file; its suffix says the format.
        label: what to call it in a message.
        signal: the names of the channels.

    Raises:
        InputError: the file is missing, damaged, of an unknown format, or lacks a channel.
    """
    suffix = "".join(path.suffixes[-2:]) if path.suffix == ".gz" else path.suffix.lower()
    if suffix in TABLE_SUFFIXES:
        return _from_table(path, label, signal)
    if suffix not in _READERS:
        raise InputError(
            Problem(
                label,
                f"a file ending in {', '.join([*TABLE_SUFFIXES, *_READERS])}",
                "Export the recording in one of these formats.",
                value=path.name,
            )
        )
    # Lines that are taken apart one by one take many times their size.
    data = read_bytes(path, label, REMEDY, share=0.1 if suffix == ".lvm" else 1.0)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            channels, first_row = _READERS[suffix](data, label)
    except _UnfitError as error:
        raise InputError(Problem(label, error.expected, error.remedy, value=error.found)) from None
    except InputError:
        raise
    except Exception as error:
        # Damaged bytes can fail anywhere in a decoder, with whatever that part of it raises.
        found = (str(error).splitlines() or [""])[0] or type(error).__name__
        raise InputError(
            Problem(label, f"a whole {suffix} file", "Copy or export the recording anew.", value=found)
        ) from error
    return _pick(channels, first_row, label, signal)


class _UnfitError(Exception):
    def __init__(self, expected: str, remedy: str, found: object) -> None:
        super().__init__(expected)
        self.expected, self.remedy, self.found = expected, remedy, found


def _from_table(path: Path, label: str, signal: SignalSettings) -> Recording:
    wanted = [signal.time_column, signal.value_column]
    if path.suffix != ".parquet" and signal.time_column not in header(read_bytes(path, label, REMEDY), label):
        wanted = [signal.value_column] if "time_column" not in signal.model_fields_set else wanted
    columns, _ = read_table(path, label, numbers=wanted, remedy=REMEDY)
    value, time = columns[signal.value_column], columns.get(signal.time_column, Numbers(np.empty(0)))
    return Recording(
        value.array,
        time.array if signal.time_column in columns else None,
        first_row=2,
        text={**time.text, **value.text},
    )


def _pick(channels: dict[str, _Channel], first_row: int, label: str, signal: SignalSettings) -> Recording:
    problems = []
    name = signal.value_column
    if name not in channels and "value_column" not in signal.model_fields_set:
        others = [other for other in channels if other != signal.time_column]
        name = others[0] if len(others) == 1 else name
    for key, wanted in (("value_column", name), ("time_column", signal.time_column)):
        needed = key == "value_column" or key in signal.model_fields_set
        if needed and wanted not in channels:
            problems.append(
                Problem(
                    label,
                    f"a channel {wanted!r}",
                    f"Name one of the channels as signal.{key} in dataset.toml.",
                    column=wanted,
                    value=", ".join(channels) or "no channels of numbers",
                )
            )
    if problems:
        raise InputError(problems)
    value, time = channels[name], channels.get(signal.time_column)
    if time is not None and time.values.size != value.values.size:
        raise InputError(
            Problem(
                label,
                f"as many samples as in channel {name!r} ({value.values.size})",
                "Export both channels over the same span.",
                column=signal.time_column,
                value=time.values.size,
            )
        )
    return Recording(
        value.values,
        None if time is None else time.values,
        value.clock if time is None else None,
        first_row=first_row,
    )


def _lvm(data: bytes, label: str) -> tuple[dict[str, _Channel], int]:
    import lvm_read

    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError:
        # LabVIEW writes names and units in the code page of its machine; the numbers are plain.
        text = data.decode("latin-1")
    content: dict[Any, Any] = lvm_read.read_str(text)
    if content["Segments"] != 1:
        raise _UnfitError(
            "one block of data",
            "Record every impact to a file of its own, and leave no empty line between samples.",
            f"{content['Segments']} blocks",
        )
    segment = content[0]
    samples, names = segment["data"], segment["Channel names"]
    stated = {int(count) for count in segment.get("Samples", []) if count == count}
    if stated and stated != {len(samples)}:
        raise _UnfitError(
            "as many rows as the header's Samples", "Export the recording anew.", f"{len(samples)} rows"
        )
    if unit := set(segment.get("X_Dimension", [])) - {"Time", ""}:
        raise _UnfitError("time along X", "Export the signal over time.", ", ".join(sorted(unit)))
    if len(names) > 1 and names[-1] == "Comment":
        names = names[:-1]
    channels: dict[str, _Channel] = {}
    clock, measured = None, 0
    for column, name in enumerate(names):
        if name == "X_Value":
            clock = samples[:, column]
            continue
        regular = _regular(segment, measured, len(samples))
        own = clock if clock is not None and np.isfinite(clock).any() else regular
        channels[name] = _Channel(samples[:, column], own)
        measured += 1
    lines = text.splitlines()
    return channels, next(i for i, line in enumerate(lines, 2) if line.startswith("X_Value"))


def _regular(segment: dict[str, Any], channel: int, samples: int) -> np.ndarray | None:
    steps, starts = segment.get("Delta_X", []), segment.get("X0", [])
    if channel >= len(steps) or not steps[channel] > 0:
        return None
    start = starts[channel] if channel < len(starts) else 0.0
    return start + steps[channel] * np.arange(samples)


def _tdms(data: bytes, label: str) -> tuple[dict[str, _Channel], int]:
    from nptdms import TdmsFile

    # Damaged names would be logged one by one; what is wrong is said once, by whoever called.
    logging.getLogger("nptdms").setLevel(logging.ERROR)
    file = TdmsFile.open(io.BytesIO(data))
    if file.file_status.incomplete_final_segment:
        raise _UnfitError(
            "a whole .tdms file", "Copy or export the recording anew.", "an end that is missing"
        )
    found = [channel for group in file.groups() for channel in group.channels()]
    require_small(sum(8 * len(channel) for channel in found), label)
    names = [channel.name for channel in found]
    channels: dict[str, _Channel] = {}
    for channel in found:
        values = np.asarray(channel[:])
        if values.dtype.kind not in "fiu":
            continue
        clock = _waveform_clock(channel.properties, len(values))
        # The same name in two groups says nothing: such channels need their group's name before theirs.
        name = channel.name if names.count(channel.name) == 1 else f"{channel.group_name}/{channel.name}"
        channels[name] = _Channel(values.astype(np.float64), clock)
    return channels, 1


def _waveform_clock(properties: dict[str, Any], samples: int) -> np.ndarray | None:
    step, start = properties.get("wf_increment"), properties.get("wf_start_offset", 0.0)
    if not isinstance(step, (int, float)) or not isinstance(start, (int, float)) or not step > 0:
        return None
    with np.errstate(over="ignore", invalid="ignore"):
        return start + step * np.arange(samples)


def _mat(data: bytes, label: str) -> tuple[dict[str, _Channel], int]:
    if data[512:520] == b"\x89HDF\r\n\x1a\n" or data[:8] == b"\x89HDF\r\n\x1a\n":
        content = mat73.numeric_variables(data, label)
    else:
        content = mat5.numeric_variables(data, label)
    return {
        name: _Channel(np.ravel(values).astype(np.float64))
        for name, values in content.items()
        if isinstance(values, np.ndarray)
        and values.dtype.kind in "fiu"
        and max(values.shape, default=0) == values.size
    }, 1


_READERS: dict[str, Callable[[bytes, str], tuple[dict[str, _Channel], int]]] = {
    ".lvm": _lvm,
    ".tdms": _tdms,
    ".mat": _mat,
}
