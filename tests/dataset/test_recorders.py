"""Every recorder format, written as its own software writes it, read back to the same samples."""

from __future__ import annotations

import gzip
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pandas as pd
import pytest
from nptdms import ChannelObject, TdmsWriter
from scipy.io import savemat
from scipy.sparse import csc_array

from bayestissue.base.errors import InputError
from bayestissue.recordings.dataset import Dataset, read_dataset
from bayestissue.recordings.dataset.recorders import contents_of
from bayestissue.recordings.dataset.source_files import Source
from dataset_bench import MASSES, NAMES, RATE, Lab, tables
from recorder_files import acq, c3d, lvm, markers, xlsx

Writer = Callable[[Path, np.ndarray, np.ndarray], None]


def _csv(path: Path, time: np.ndarray, value: np.ndarray) -> None:
    text = pd.DataFrame({"time_s": time, "value": value, "note": "x"}).to_csv(index=False).encode()
    path.write_bytes(gzip.compress(text) if path.suffix == ".gz" else text)


def _xlsx(path: Path, time: np.ndarray, value: np.ndarray) -> None:
    rows = [list(pair) for pair in zip(time.tolist(), value.tolist(), strict=True)]
    xlsx(path, [["Prüfstand 3"], [], ["time_s", "value"], *rows], before=("empty",))


def _of_lvm(factors: dict[str, float], **options: Any) -> Writer:
    """LabVIEW's file of channels that are multiples of what was recorded."""

    def write(path: Path, time: np.ndarray, value: np.ndarray) -> None:
        lvm(path, time, {name: factor * value for name, factor in factors.items()}, **options)

    return write


_lvm = _of_lvm({"Accelerometer": 1})


def _lvm_of_several_rates(path: Path, time: np.ndarray, value: np.ndarray) -> None:
    lvm(path, time, {"Note": value[:5], "value": value, "Slow": value[::4]}, intervals=[1.0, None, 4 / RATE])


def _of_tdms(channel: str, offset: bool = True, **clock: Any) -> Writer:
    """A waveform with a clock of these properties, and with the time of its first sample."""

    def write(path: Path, time: np.ndarray, value: np.ndarray) -> None:
        about = ({"wf_start_offset": float(time[0])} if offset else {}) | clock
        with TdmsWriter(path) as writer:
            writer.write_segment([ChannelObject("Impact", channel, value, properties=about)])

    return write


_tdms = _of_tdms("Accelerometer", wf_increment=1 / RATE)


def _tdms_many(path: Path, time: np.ndarray, value: np.ndarray) -> None:
    columns = {"time_s": time, "value": value, "Force": 3 * value}
    channels = [ChannelObject("Impact", name, values) for name, values in columns.items()]
    with TdmsWriter(path) as writer:
        writer.write_segment([*channels, ChannelObject("Notes", "words", ["a", "b"])])


def _mat5(path: Path, time: np.ndarray, value: np.ndarray) -> None:
    savemat(path, {"time_s": time[:, None], "value": value[:, None], "rate": RATE, "who": "someone"})


def _mat73(path: Path, time: np.ndarray, value: np.ndarray) -> None:
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, array in (("time_s", time), ("value", value)):
            file.create_dataset(name, data=array[None, :]).attrs["MATLAB_class"] = b"double"
        who = file.create_dataset("who", data=np.array([[115], [49]], dtype=np.uint16))
        who.attrs["MATLAB_class"] = b"char"
        file.create_group("settings")
    data = bytearray(path.read_bytes())
    data[:128] = b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM"
    path.write_bytes(data)


def _hdf5(path: Path, time: np.ndarray, value: np.ndarray) -> None:
    with h5py.File(path, "w") as file:
        file["time_s"], file["value"], file["who"] = time, value, "somebody"


def _hdf5_table(path: Path, time: np.ndarray, value: np.ndarray) -> None:
    with h5py.File(path, "w") as file:
        file["drop/raw"] = np.column_stack([time, value, 3 * value])
        file["drop/picture"] = np.zeros((100, 100))
        # More paths than can be walked, to as many groups as a hand has fingers.
        for one in "abcde":
            file.create_group(f"drop/{one}")
        for one in "abcde":
            for other in "abcde":
                file[f"drop/{one}/{other}"] = file[f"drop/{other}"]
        file["drop/again"] = file["drop"]


def _c3d(path: Path, time: np.ndarray, value: np.ndarray) -> None:
    c3d(path, {"Fz": 3 * value, "value": value}, RATE, {"Fz": "N"}, points=2)


def _acq(path: Path, time: np.ndarray, value: np.ndarray) -> None:
    acq(path, {"Fz": 3 * value, "value": value}, RATE, {"Fz": "N"})


FORMATS: dict[str, tuple[str, Writer]] = {
    "csv": (".csv", _csv),
    "packed csv": (".csv.gz", _csv),
    "parquet": (".parquet", lambda p, t, v: pd.DataFrame({"time_s": t, "value": v}).to_parquet(p)),
    "xlsx": (".xlsx", _xlsx),
    "lvm": (".lvm", _lvm),
    "lvm of many channels": (".lvm", _of_lvm({"Force": 3, "value": 1, "Other": 0})),
    "lvm without x": (".lvm", _of_lvm({"value": 1}, x_columns="No", comment=False)),
    "lvm with an x per channel": (".lvm", _of_lvm({"Force": 3, "value": 1}, x_columns="Multi")),
    "lvm of channels of several rates": (".lvm", _lvm_of_several_rates),
    "lvm with decimal comma": (".lvm", _of_lvm({"value": 1}, decimal=",")),
    "tdms": (".tdms", _tdms),
    "tdms of many channels": (".tdms", _tdms_many),
    "mat 5": (".mat", _mat5),
    "mat 5 packed": (".mat", lambda p, t, v: savemat(p, {"time_s": t, "value": v}, do_compression=True)),
    "mat 7.3": (".mat", _mat73),
    "hdf5": (".h5", _hdf5),
    "hdf5 of another name": (".hdf5", _hdf5),
    "c3d": (".c3d", _c3d),
    "acq": (".acq", _acq),
}
# Such files hold no time of their first sample, and C3D's real numbers have four bytes.
BEGIN_AT_ZERO, SINGLE = (".c3d", ".acq"), (".c3d",)


def _lvm_spectrum(path: Path, time: np.ndarray, value: np.ndarray) -> None:
    _lvm(path, time, value)
    path.write_text(path.read_text().replace("X_Dimension\tTime", "X_Dimension\tFrequency"))


def _lvm_short_and_broken(path: Path, time: np.ndarray, value: np.ndarray) -> None:
    lvm(path, time, {"value": value, "Slow": value[:5]}, intervals=[None, 1.0], samples=500)


def _lvm_blocks(path: Path, time: np.ndarray, value: np.ndarray) -> None:
    _lvm(path, time, value)
    text = path.read_text()
    path.write_text(text + "\n" + text[text.index("Channels") :])


def _mat73_elsewhere(path: Path, time: np.ndarray, value: np.ndarray) -> None:
    away = path.with_suffix(".away")
    with h5py.File(away, "w") as file:
        file["value"] = value
    away.with_suffix(".raw").write_bytes(value.tobytes())
    with h5py.File(path, "w") as file:
        file["linked"] = h5py.ExternalLink(str(away), "value")
        raw = [(str(away.with_suffix(".raw")), 0, value.nbytes)]
        file.create_dataset("value", value.shape, value.dtype, external=raw)
        layout = h5py.VirtualLayout(value.shape, value.dtype)
        layout[:] = h5py.VirtualSource(str(away), "value", value.shape)
        file.create_virtual_dataset("virtual", layout)


def _mat_of_size(path: Path, time: np.ndarray, value: np.ndarray) -> None:
    _mat5(path, time, value)
    data = path.read_bytes()
    path.write_bytes(data[:132] + b"\xff" * 4 + data[136:])


def _cut(write: Writer, lost: int) -> Writer:
    """The file without its last bytes."""

    def half(path: Path, time: np.ndarray, value: np.ndarray) -> None:
        write(path, time, value)
        path.write_bytes(path.read_bytes()[:-lost])

    return half


def _acq_of_thousands(path: Path, time: np.ndarray, value: np.ndarray) -> None:
    """A file whose damaged header states 1,944 channels, more than its bytes can hold."""
    _acq(path, time, value)
    data = bytearray(path.read_bytes())
    data[10:12] = (1944).to_bytes(2, "little")
    path.write_bytes(data)


def files_instead(lab: Lab, suffix: str, write: Writer, **columns: object) -> None:
    """Put one file per impact in the place of the long table."""
    impacts, traces = tables()
    for impact, part in traces.groupby("impact"):
        write(lab.path(f"{impact}{suffix}"), part["time_s"].to_numpy(), part["value"].to_numpy())
    impacts.assign(trace=impacts["impact"] + suffix, **columns).to_csv(lab.path("impacts.csv"), index=False)
    lab.remove("traces.csv")


def assert_same(dataset: Dataset, suffix: str = "") -> None:
    _, traces = tables()
    assert tuple(dataset.impacts["impact"]) == NAMES
    np.testing.assert_array_equal(dataset.impacts["mass_kg"], MASSES)
    for impact, trace in zip(NAMES, dataset.traces, strict=True):
        mine = traces[traces["impact"] == impact]
        start = mine["time_s"].iloc[0] if suffix in BEGIN_AT_ZERO else 0.0
        stored = mine["value"].astype(np.float32 if suffix in SINGLE else np.float64)
        # Times may be rebuilt from a start and an interval: a few rounding errors of a time of 0.04 s.
        np.testing.assert_allclose(trace.time_s, mine["time_s"] - start, rtol=0, atol=1e-14)
        np.testing.assert_array_equal(trace.value, stored.astype(np.float64))


@pytest.mark.slow
@pytest.mark.parametrize("name", FORMATS)
def test_round_trip(name: str, lab: Lab) -> None:
    suffix, write = FORMATS[name]
    files_instead(lab, suffix, write)
    assert_same(read_dataset(lab.folder), suffix)


def test_columns_of_a_table_in_hdf5_are_called_by_number(lab: Lab) -> None:
    names = 'time_column = "drop/raw:1"\nvalue_column = "drop/raw:2"'
    lab.replace("dataset.toml", "[signal]", f"[signal]\n{names}")
    files_instead(lab, ".h5", _hdf5_table)
    assert_same(read_dataset(lab.folder))


def _mat5_export(path: Path, time: np.ndarray, value: np.ndarray) -> None:
    # As LabChart exports: variables without content among the others.
    beside = {"com": np.zeros((0, 0)), "comtext": "", "titles": np.array(["Fx", "Impact"]), "rate": RATE}
    empty = {"cfg": {"note": "", "gain": np.zeros((0, 1))}}
    data = np.column_stack([time, value, 3 * value])
    trials = np.zeros((1, 2), dtype=[("acc", object)])
    trials["acc"] = [[3 * value, value]]
    daq = {"daq": {"time": time[:, None], "acc": value, **empty}}
    savemat(path, {**beside, "test": daq, "data": data, "wide": data.T, "trial": trials})


def _mat73_export(path: Path, time: np.ndarray, value: np.ndarray) -> None:
    data = np.column_stack([time, value, 3 * value])
    with h5py.File(path, "w", userblock_size=512) as file:
        # MATLAB writes the dimensions from the other end, and of an empty array the shape.
        file["data"], file["wide"] = data.T, data
        file["test/daq/time"], file["test/daq/acc"] = time[None, :], value[None, :]
        file["com"] = np.zeros(2, dtype=np.uint64)
        file["com"].attrs["MATLAB_empty"] = np.int32(1)
        file["#refs#/a"] = 3 * value


IN_BOTH = [("test.daq.time", "test.daq.acc"), ("data:1", "data:2"), ("wide:1", "wide:2")]


@pytest.mark.parametrize(
    ("write", "time_column", "value_column"),
    [(write, *names) for write in (_mat5_export, _mat73_export) for names in IN_BOTH]
    + [(_mat5_export, "data:1", "trial(2).acc")],
)
def test_fields_and_columns_of_matlab_are_named(
    write: Writer, time_column: str, value_column: str, lab: Lab
) -> None:
    names = f'time_column = "{time_column}"\nvalue_column = "{value_column}"'
    lab.replace("dataset.toml", "[signal]", f"[signal]\n{names}")
    files_instead(lab, ".mat", write)
    assert_same(read_dataset(lab.folder))
    channels = contents_of(Source.at(next(lab.folder.glob("*.mat")))).channels
    assert not {"com", "comtext", "test.daq.cfg.gain", "#refs#.a"} & set(channels)


def test_whole_numbers_of_c3d_are_scaled_as_its_analog_group_says(tmp_path: Path) -> None:
    value = np.linspace(-1, 1, 40)
    c3d(tmp_path / "real.c3d", {"value": value}, RATE, {})
    data = bytearray((tmp_path / "real.c3d").read_bytes())
    # As a recorder of whole numbers writes it: a positive scale of points, and OFFSET and SCALE.
    raw, scale, offset = np.rint(value / 0.001 + 50).astype("<i2"), 0.001, 50
    begin = 512 * (int.from_bytes(data[16:18], "little") - 1)
    data[12:16] = np.float32(1).tobytes()
    for name, stored in ((b"OFFSET", np.int16(offset).tobytes()), (b"SCALE", np.float32(scale).tobytes())):
        at = data.index(bytes([len(name), 2]) + name) + 2 + len(name) + 4
        at += data[at - 1]
        data[at : at + len(stored)] = stored
    (tmp_path / "whole.c3d").write_bytes(data[:begin] + raw.tobytes())
    read = contents_of(Source.at(tmp_path / "whole.c3d")).channels["value"]
    # SCALE itself has four bytes.
    np.testing.assert_allclose(
        np.asarray(read.values), (raw - float(offset)) * np.float64(np.float32(scale)), rtol=1e-15
    )


def test_a_c3d_file_without_analog_channels_has_those_of_its_markers(tmp_path: Path) -> None:
    height = np.linspace(100.0, 80.0, 30)
    markers(tmp_path / "a.c3d", height, 200.0, hidden=7)
    found = contents_of(Source.at(tmp_path / "a.c3d")).channels
    assert list(found) == [f"{name}.{axis}" for name in ("HAMR", "REST") for axis in "xyz"]
    own = found["HAMR.z"]
    seen = np.arange(30) != 7
    # Coordinates have four bytes.
    np.testing.assert_allclose(np.asarray(own.values)[seen], height[seen], rtol=1e-6)
    assert np.isnan(np.asarray(own.values)[7])
    assert own.unit == "mm"
    np.testing.assert_allclose(own.clock, np.arange(30) / 200.0, rtol=1e-6)


def test_a_marker_at_the_origin_is_a_gap(tmp_path: Path) -> None:
    """Some programs write a marker that no camera saw as 0, 0, 0 and a residual of 0."""
    height = np.where(np.arange(30) == 7, 0.0, np.linspace(100.0, 80.0, 30))
    markers(tmp_path / "a.c3d", height, 200.0)
    own = contents_of(Source.at(tmp_path / "a.c3d")).channels["HAMR.z"]
    assert np.flatnonzero(np.isnan(np.asarray(own.values))).tolist() == [7]


def test_a_waveform_without_an_offset_begins_at_zero(lab: Lab) -> None:
    files_instead(lab, ".tdms", _of_tdms("a/'b'", offset=False, wf_increment=1 / RATE))
    for trace in read_dataset(lab.folder).traces:
        np.testing.assert_array_equal(trace.time_s, np.arange(trace.value.size) * (1 / RATE))


@pytest.mark.parametrize(("step", "offset"), [(1e-4, "y"), (-1e-4, 0.0), (np.nan, 0.0)])
def test_a_waveform_whose_clock_is_no_number_has_no_times(step: Any, offset: Any, lab: Lab) -> None:
    files_instead(lab, ".tdms", _of_tdms("value", wf_increment=step, wf_start_offset=offset))
    with pytest.raises(InputError, match="no times"):
        read_dataset(lab.folder)


END = "an end that is missing"
SPARSE = csc_array(np.eye(3))
NO_NUMBERS = "no channels of numbers"
SHORT = r'all 4 files, such as a.lvm, column value: found "5 samples".*Name another one .*: Force\.'
UNFIT: dict[str, tuple[str, str, Writer]] = {
    "no such channel": (".lvm", "Force, Torque", _of_lvm({"Force": 1, "Torque": 1})),
    "rows are missing": (".lvm", "400 rows", _of_lvm({"value": 1}, samples=1000)),
    "spectrum": (".lvm", "time along X", _lvm_spectrum),
    "two blocks": (".lvm", 'found "2 blocks"; expected one recording.*a.lvm#1', _lvm_blocks),
    "short": (".lvm", SHORT, lambda p, t, v: lvm(p, t, {"value": v[:5], "Force": v})),
    "short and broken": (".lvm", "400 rows where 500 are stated", _lvm_short_and_broken),
    "half": (".tdms", END, _cut(_tdms, 1600)),
    "no last sample": (".tdms", END, _cut(_tdms, 8)),
    "unequal": (".mat", "as many samples", lambda p, t, v: savemat(p, {"time_s": t[:-1], "value": v})),
    "no numbers": (
        ".mat",
        NO_NUMBERS,
        lambda p, t, v: savemat(p, {"who": "x", "z": 1j * v, "a": SPARSE}),
    ),
    "an older mat": (".mat", "neither a MATLAB 5", lambda p, t, v: p.write_bytes(bytes(200))),
    "a size beyond the mat": (".mat", "longer than the file", _mat_of_size),
    "numbers in other files": (".mat", NO_NUMBERS, _mat73_elsewhere),
    "numbers elsewhere": (".h5", NO_NUMBERS, _mat73_elsewhere),
    "half a c3d": (".c3d", END, _cut(_c3d, 2000)),
    "half an acq": (".acq", END, _cut(_acq, 2000)),
    "channels of a damaged header": (".acq", "header is damaged", _acq_of_thousands),
}


@pytest.mark.parametrize("name", UNFIT)
def test_unfit_recordings_are_refused(name: str, lab: Lab) -> None:
    suffix, says, write = UNFIT[name]
    files_instead(lab, suffix, write)
    with pytest.raises(InputError, match=says):
        read_dataset(lab.folder)


def test_a_shock_table_as_labview_writes_it(shock_table: Path) -> None:
    """Two channels of 51,200 samples at 51.2 kHz beside four of five samples, one every second."""
    for path in sorted(shock_table.glob("*.lvm")):
        channels = contents_of(Source.at(path)).channels
        assert [len(channel.values) for channel in channels.values()] == [51_200] * 2 + [5] * 4
        assert all(np.isfinite(channel.values).all() for channel in channels.values())
        for channel in channels.values():
            step = 1.0 if len(channel.values) == 5 else 1 / 51_200
            assert channel.clock is not None
            # LabVIEW writes X_Value with six decimals.
            np.testing.assert_allclose(np.diff(channel.clock), step, rtol=0, atol=1.1e-6)
