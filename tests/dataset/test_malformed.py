"""Every way a dataset can be wrong: refused with status 2, the place named, and nothing written."""

from __future__ import annotations

import gzip
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from bayestissue.base.errors import has_control_characters
from bayestissue.recordings.dataset import read_dataset
from dataset_bench import SAMPLES, Lab, Outcome

Spoil = Callable[[Lab], object]


@dataclass(frozen=True)
class Case:
    name: str
    spoil: Spoil
    says: tuple[str, ...]


def case(name: str, spoil: Spoil, *says: str) -> Case:
    return Case(name, spoil, says)


def _toml(old: str, new: str) -> Spoil:
    return lambda lab: lab.replace("dataset.toml", old, new)


def _cell(row: int, column: str, value: str) -> Spoil:
    return lambda lab: lab.cell("impacts.csv", row, column, value)


def _sample(row: int, column: str, value: str) -> Spoil:
    return lambda lab: lab.cell("traces.csv", row, column, value)


def _values(impact: str, change: Callable[[np.ndarray], np.ndarray]) -> Spoil:
    def spoil(time: np.ndarray, value: np.ndarray) -> None:
        value[:] = change(value)

    return lambda lab: lab.samples(impact, spoil)


def _times(impact: str, change: Callable[[np.ndarray], np.ndarray]) -> Spoil:
    def spoil(time: np.ndarray, value: np.ndarray) -> None:
        time[:] = change(time)

    return lambda lab: lab.samples(impact, spoil)


def _lost_sample(time: np.ndarray) -> np.ndarray:
    return np.where(np.arange(time.size) < 100, time, time + 1e-4)


def _behind_a_low_pass(spoil: Spoil) -> Spoil:
    """A filter of the recorder is applied to even times only."""

    def both(lab: Lab) -> None:
        spoil(lab)
        with lab.path("dataset.toml").open("a", encoding="utf-8") as settings:
            settings.write("\n[recorder]\nlow_pass_hz = 2000\n")

    return both


def _swapped(time: np.ndarray) -> np.ndarray:
    time[[50, 51]] = time[[51, 50]]
    return time


def _only(lab: Lab, impact: str, rows: slice) -> None:
    table = pd.read_csv(lab.path("traces.csv"))
    mine = table[table["impact"] == impact].iloc[rows]
    pd.concat([table[table["impact"] != impact], mine]).to_csv(lab.path("traces.csv"), index=False)


def _from_peak_on(lab: Lab) -> None:
    table = pd.read_csv(lab.path("traces.csv"))
    mine = table[table["impact"] == "a"]
    _only(lab, "a", slice(0, int(mine["value"].argmax()) - 20))


def _bytes(name: str, data: bytes) -> Spoil:
    return lambda lab: lab.path(name).write_bytes(data)


def _trace_column(value: str) -> Spoil:
    def spoil(lab: Lab) -> None:
        table = pd.read_csv(lab.path("traces.csv"))
        impacts = pd.read_csv(lab.path("impacts.csv"))
        for impact, part in table.groupby("impact"):
            part.drop(columns="impact").to_csv(lab.path(f"{impact}.csv"), index=False)
        impacts["trace"] = [value, "b.csv", "c.csv", "d.csv"]
        impacts.to_csv(lab.path("impacts.csv"), index=False)
        lab.path("traces.csv").unlink()

    return spoil


def _and(*steps: Spoil) -> Spoil:
    def spoil(lab: Lab) -> None:
        for step in steps:
            step(lab)

    return spoil


def _displacement(lab: Lab) -> None:
    lab.replace("dataset.toml", '"deceleration"', '"displacement"')
    lab.replace("dataset.toml", '"m/s^2"', '"mm"')


def _sinking(scale: float) -> Spoil:
    """Displacements of 16 mm and a declared velocity, so many times too large."""

    def spoil(lab: Lab) -> None:
        lab.replace("dataset.toml", '"deceleration"', '"displacement"')
        lab.replace("dataset.toml", '"m/s^2"', '"m"')
        for impact in "abcd":
            lab.samples(impact, lambda t, v: np.copyto(v, scale * np.sin(60 * np.maximum(t, 0)) / 60))

    return spoil


def _names_as(convert: Callable[[str], object]) -> Spoil:
    def spoil(lab: Lab) -> None:
        table = pd.read_csv(lab.path("traces.csv"))
        lab.path("traces.csv").unlink()
        names = pa.array([convert(name) for name in table["impact"]])
        table = pa.table({"impact": names, "time_s": table["time_s"], "value": table["value"]})
        pq.write_table(table, lab.path("traces.parquet"))

    return spoil


T, I, D = "traces.csv", "impacts.csv", "dataset.toml"  # noqa: E741

CASES = [
    # dataset.toml
    case("no settings", lambda lab: lab.path(D).unlink(), D, "no file", "Write one"),
    case("settings empty", _bytes(D, b""), D, "name", "signal", "Add the key"),
    case("no TOML", _toml('name = "bench"', "name = bench"), D, "row 1", "valid TOML", "quotes"),
    case("settings not UTF-8", _bytes(D, b'name = "\xe9t\xe9"\n'), D, "row 1", "UTF-8"),
    case(
        "unknown key",
        _toml("unit =", "units ="),
        D,
        "row 6",
        "signal.units",
        "value_column",
        "remove the key",
    ),
    case(
        "unknown table",
        _toml("[uncertainty]", "[sensors]"),
        D,
        "row 8",
        "column sensors",
        "uncertainty",
        "remove",
    ),
    case(
        "unknown quantity",
        _toml('"deceleration"', '"force"'),
        D,
        "row 5",
        "signal.quantity",
        "force",
        "'acceleration'",
    ),
    case("no quantity", _toml('quantity = "deceleration"', ""), D, "signal.quantity", "Add the key"),
    case("no unit", _toml('unit = "m/s^2"', ""), D, "signal.unit", "Add the key"),
    case(
        "unknown unit", _toml('"m/s^2"', '"furlong/fortnite"'), D, "row 6", "signal.unit", "furlong/fortnite"
    ),
    case(
        "unit of something else", _toml('"m/s^2"', '"mm"'), D, "row 6", "signal.unit", '"mm"', "acceleration"
    ),
    case("absurd unit", _toml('"m/s^2"', '"m^9^9^9^9"'), D, "row 6", "signal.unit", "m^9^9^9^9"),
    case("grams as length", _and(_displacement, _toml('"mm"', '"g"')), D, "signal.unit", '"g"', "length"),
    case(
        "wrong time unit",
        _toml('unit = "m/s^2"', 'unit = "m/s^2"\ntime_unit = "m"'),
        D,
        "row 7",
        "signal.time_unit",
        '"m"',
    ),
    case(
        "scale of zero",
        _toml('unit = "m/s^2"', 'unit = "m/s^2"\nscale = 0'),
        D,
        "row 7",
        "signal.scale",
        "other than 0",
    ),
    case(
        "scale as text",
        _toml('unit = "m/s^2"', 'unit = "m/s^2"\nscale = "2"'),
        D,
        "row 7",
        "signal.scale",
        '"2"',
    ),
    case(
        "negative uncertainty",
        _toml("0.01", "-0.01"),
        D,
        "row 9",
        "uncertainty.relative_mass_sd",
        "-0.01",
        "greater than or equal to 0",
    ),
    case("infinite uncertainty", _toml("0.01", "inf"), D, "row 9", "uncertainty.relative_mass_sd", "inf"),
    # impacts.csv
    case("no impacts", lambda lab: lab.path(I).unlink(), I, "no such file", "Write one"),
    case("impacts empty", _bytes(I, b"\n"), I, "an empty file"),
    case(
        "header only",
        _bytes(I, b"impact,subject,trial,mass_kg,velocity_m_s\n"),
        I,
        "no rows",
        "Add the impacts",
    ),
    case(
        "impacts not UTF-8",
        lambda lab: lab.path(I).write_bytes(lab.path(I).read_bytes().replace(b"s2", b"\xc3\xa9\xff")),
        I,
        "row 4",
        "UTF-8",
    ),
    case("open quote", _cell(3, "subject", '"s1'), I, "quotes"),
    case(
        "missing column", lambda lab: lab.replace(I, "mass_kg", "mass-kg"), I, "row 1", '"mass_kg"', "Rename"
    ),
    case("missing velocity column", lambda lab: lab.replace(I, "velocity_m_s", "speed"), I, '"velocity_m_s"'),
    case("column twice", lambda lab: lab.replace(I, "skinfold_mm", "mass_kg"), I, "row 1", "mass_kg", "once"),
    case(
        "unnamed column", lambda lab: lab.replace(I, "skinfold_mm", ""), I, "row 1", "name over every column"
    ),
    case(
        "cell too many",
        lambda lab: lab.replace(I, "11.5", "11,5"),
        I,
        "row 2",
        "8 cells",
        "a point, not a comma",
    ),
    case("mass zero", _cell(3, "mass_kg", "0"), I, "row 3", "mass_kg", "impact b", '"0"', "above 0"),
    case("mass negative", _cell(3, "mass_kg", "-1"), I, "row 3", "mass_kg", '"-1"', "above 0"),
    case("mass not a number", _cell(4, "mass_kg", "1_0"), I, "row 4", "mass_kg", '"1_0"', "impact c"),
    case("mass nan", _cell(4, "mass_kg", "nan"), I, "row 4", "mass_kg", '"nan"'),
    case("mass infinite", _cell(4, "mass_kg", "1e999"), I, "row 4", "mass_kg", '"1e999"'),
    case("mass missing", _cell(4, "mass_kg", ""), I, "row 4", "mass_kg", "an empty cell"),
    case(
        "velocity missing",
        _cell(5, "velocity_m_s", ""),
        I,
        "row 5",
        "velocity_m_s",
        "an empty cell",
        "impact d",
    ),
    case("velocity negative", _cell(5, "velocity_m_s", "-0.9"), I, "row 5", "velocity_m_s", '"-0.9"'),
    case(
        "impact twice", _cell(3, "impact", "a"), I, "row 3", "column impact", '"a"', "row 2 has the same name"
    ),
    case("impact unnamed", _cell(3, "impact", ""), I, "row 3", "column impact", "an empty cell"),
    case("subject missing", _cell(3, "subject", " "), I, "row 3", "column subject", "impact b"),
    # the long table
    case("no traces", lambda lab: lab.path(T).unlink(), T, "no table of samples", "Add one of"),
    case(
        "two tables",
        lambda lab: lab.path("traces.csv.gz").write_bytes(gzip.compress(lab.path(T).read_bytes())),
        "traces.csv, traces.csv.gz",
        "Remove the others",
    ),
    case("traces empty", _bytes(T, b""), T, "an empty file"),
    case("no samples", _bytes(T, b"impact,time_s,value\n"), T, "no rows"),
    case("no value column", lambda lab: lab.replace(T, "value", "valeu"), T, "row 1", '"value"', "Rename"),
    case(
        "traces not UTF-8",
        lambda lab: lab.path(T).write_bytes(
            lab.path(T).read_bytes()[:100] + b"\x81" + lab.path(T).read_bytes()[100:]
        ),
        T,
        "UTF-8",
        "row 5",
    ),
    case(
        "unknown impact", _sample(1000, "impact", '"x"'), T, "row 1000", "column impact", '"x"', "impacts.csv"
    ),
    case(
        "no samples of one",
        lambda lab: _only(lab, "b", slice(0)),
        T,
        "impact b",
        "no samples",
        "Add its samples",
    ),
    case("too few samples", lambda lab: _only(lab, "b", slice(7)), T, "impact b", "7 samples", "at least 8"),
    case(
        "sample not a number",
        _sample(500, "value", "1.2.3"),
        T,
        "row 500",
        "column value",
        '"1.2.3"',
        "impact b",
    ),
    case("sample missing", _sample(500, "value", ""), T, "row 500", "column value", "finite", "impact b"),
    case("sample infinite", _sample(500, "value", "-inf"), T, "row 500", "column value", "-inf"),
    case("time not a number", _sample(500, "time_s", "0:01"), T, "row 500", "column time_s", '"0:01"'),
    case(
        "row too short", lambda lab: lab.row(T, 900, lambda line: "c,0.5"), T, "row 900", "2 cells", "3 cells"
    ),
    case("blank row", lambda lab: lab.row(T, 900, lambda line: "\n" + line), T, "row 900", "an empty cell"),
    case("time runs back", _times("c", _swapped), T, "row 853", "time_s", "impact c", "order"),
    case("time stands still", _times("c", lambda t: np.zeros_like(t)), T, "row 803", "time_s", "impact c"),
    case(
        "lost sample",
        _behind_a_low_pass(_times("b", _lost_sample)),
        *(T, "row 502", "time_s", "impact b", "0.0002 s", "the declared low-pass"),
    ),
    case(
        "lost row",
        _behind_a_low_pass(lambda lab: lab.row(T, 600, lambda line: None)),
        *(T, "row 600", "time_s", "impact b"),
    ),
    case(
        "jitter",
        _behind_a_low_pass(_times("b", lambda t: t + np.tile([0, 3e-5], SAMPLES // 2))),
        T,
        "time_s",
        "impact b",
        "evenly",
    ),
    case("wrong sign", _values("a", lambda v: -v), T, "impact a", "slows down", "signal.quantity"),
    case(
        "wrong quantity", _toml('"deceleration"', '"acceleration"'), T, "impact a", "impact d", "slows down"
    ),
    case("unit too large", _values("a", lambda v: 9.8 * v), T, "impact a", "twice", "signal.unit"),
    case("ends before zero velocity", _from_peak_on, T, "impact a", "zero velocity", "longer recording"),
    case("unit too small", _values("a", lambda v: v / 9.8), T, "impact a", "speed that falls", "signal.unit"),
    case(
        "clipped",
        _behind_a_low_pass(_values("d", lambda v: np.minimum(v, 20))),
        *(T, "impact d", "samples at 20", "wider range"),
    ),
    case(
        "hardly a sample below the limit",
        _values("d", lambda v: np.where(v > 2, 20.0, v)),
        *(T, "impact d", "samples at 20", "8 samples"),
    ),
    case("dead channel", _values("d", lambda v: 0 * v), T, "impact d", "0 in every sample", "channel"),
    case(
        "one spike",
        _values("d", lambda v: np.where(np.arange(v.size) == 60, 10_000.0, 0.0)),
        T,
        "impact d",
        "1 samples",
        "higher rate",
    ),
    case("overflow", _values("d", lambda v: v * 1e306), T, "impact d", "signal.unit"),
    case(
        "displacement out of the tissue",
        lambda lab: (_displacement(lab), lab.samples("a", lambda t, v: np.copyto(v, -np.sin(t * 60)))),
        T,
        "impact a",
        "into the tissue",
        "signal.scale",
    ),
    # what no impact can have been, with what was probably meant
    case("percent typed", _toml("0.01", "5"), D, "row 9", "relative_mass_sd", "below 0.5", "5 %", "is 0.05"),
    case("gain all unknown", _toml("relative_mass_sd = 0.01", "relative_gain_sd = 1e300"), D, "a fraction"),
    case(
        "velocity sd in mm/s",
        _toml("0.005", "5"),
        D,
        "uncertainty.velocity_sd_m_s",
        "median 1.05 m/s",
        "0.005",
    ),
    case(
        "offset sd of another unit",
        _toml("velocity_sd_m_s = 0.005", "offset_sd = 1e4"),
        D,
        "uncertainty.offset_sd",
        "median",
        "Write it in m/s^2, whatever signal.unit is.",
    ),
    case("mass in no unit", _cell(3, "mass_kg", "1e308"), I, "row 3", "from 1e-05 to 10000", "Is it in kg?"),
    case("velocity in mm/s", _cell(3, "velocity_m_s", "1100"), I, "row 3", "to 1000", "Is it in m/s?"),
    case("covariate that overflows", _cell(3, "skinfold_mm", "-1e308"), I, "row 3", "below 1e+30"),
    case(
        "milliseconds as seconds",
        lambda lab: [lab.samples(name, lambda t, v: np.copyto(t, 1e3 * t)) for name in "abcd"],
        *(T, "column time_s", "impact a", 'found "one every 0.1 s"', "signal.time_unit"),
    ),
    case(
        "seconds as milliseconds",
        _toml('unit = "m/s^2"', 'unit = "m/s^2"\ntime_unit = "ms"'),
        *(T, "column time_s", "impact a", "at least 0.0001 s", "signal.time_unit"),
    ),
    case("metres as millimetres", _sinking(1e3), T, "impact a", "below 1 m", "signal.unit"),
    case("millimetres as metres", _sinking(1e-3), T, "impact a", "at a speed like the 1 m/s", "signal.unit"),
    # text that is none, or not what it seems
    case("header in capitals", lambda lab: lab.replace(T, "value", "VALUE"), T, 'Rename "VALUE" to "value"'),
    case(
        "a byte that is 0", lambda lab: lab.replace(I, "s2", "s\0"), I, "row 4", "UTF-8", "a byte that is 0"
    ),
    case("digits of another script", _cell(3, "mass_kg", "\u0663"), I, "row 3", "mass_kg", "\u0663"),
    case("wide digits", _sample(500, "value", "\uff11"), T, "row 500", "column value", "\uff11"),
    case("decimal comma in quotes", _cell(3, "mass_kg", '"0,8"'), I, "row 3", "mass_kg", "0,8"),
    case("value twice", lambda lab: lab.replace(T, "time_s", "value"), T, "row 1"),
    case(
        "a hundred thousand columns",
        lambda lab: lab.replace(T, "value", "value," + ",".join(map(str, range(100_000)))),
        *(T, "row 1", "first line of column names"),
    ),
    case(
        "escape in a name", _cell(3, "impact", "\x1b[31mb"), I, "row 3", "impact", "\\u001b[31mb", "control"
    ),
    case("escape of one byte", _cell(3, "subject", "s\x9b2J"), I, "row 3", "subject", "s\\u009b2J"),
    case("writing turned round", _cell(3, "trial", "x\u202ey"), I, "row 3", "trial", "x\\u202ey"),
    case("escape in a column", lambda lab: lab.replace(I, "sex", "se\x07x"), I, "row 1", "se\\u0007x"),
    case("escape in the title", _toml("bench", "b\\u001b[2J"), D, "row 1", "name", "\\u001b[2J", "one line"),
    case("a blank title", _toml('"bench"', '" "'), D, "row 1", "column name", "a name on one line"),
    *(
        case(f"names as {kind}", _names_as(convert), "traces.parquet", "column impact", kind, "as text")
        for kind, convert in (
            ("binary", lambda name: name.encode() + b"\xff"),
            ("list", lambda name: [name]),
            ("struct", lambda name: {"name": name}),
            ("double", lambda name: 1.5),
        )
    ),
    case("a name of two lines", lambda lab: lab.replace(I, "s2", '"s\n2"'), I, "subject", "s\\u000a2"),
    # a file per impact
    case("trace missing", _trace_column("nowhere.csv"), "nowhere.csv", "impact a", "no such file"),
    case("trace not named", _trace_column(""), I, "row 2", "column trace", "impact a", "an empty cell"),
    case(
        "trace escapes",
        _trace_column("../bench/a.csv/../../secret.csv"),
        I,
        "row 2",
        "column trace",
        "inside the dataset's folder",
    ),
    case(
        "trace absolute", _trace_column("/etc/passwd"), I, "row 2", "column trace", '"/etc/passwd"', "inside"
    ),
    case("trace shared", _trace_column("b.csv"), I, "row 3", "column trace", "of its own", "impact b"),
    case(
        "trace of unknown kind", _trace_column("dataset.toml"), "dataset.toml", "impact a", ".lvm", "Export"
    ),
    case(
        "trace is a folder",
        _and(_trace_column("sub.csv"), lambda lab: lab.path("sub.csv").mkdir()),
        "sub.csv",
        "readable",
        "impact a",
    ),
    case(
        "trace is a link to elsewhere",
        _and(
            _trace_column("link.csv"),
            lambda lab: lab.folder.with_name("away.csv").write_bytes(lab.path("b.csv").read_bytes()),
            lambda lab: lab.path("link.csv").symlink_to(lab.folder.with_name("away.csv")),
        ),
        *(I, "row 2", "column trace", "link.csv", "inside the dataset's folder"),
    ),
    case(
        "no time anywhere",
        _and(_trace_column("a.csv"), lambda lab: lab.path("a.csv").write_text("value\n" + "1\n" * 50)),
        "a.csv",
        "time_s",
        "sampling_rate_hz",
    ),
    case(
        "trace beside table",
        _and(_trace_column("a.csv"), _bytes(T, b"impact,time_s,value\na,0,1\n")),
        T,
        "either",
        "Remove",
    ),
    *(
        case(
            f"broken {suffix}",
            _and(_trace_column(f"a{suffix}"), _bytes(f"a{suffix}", b"\x00\x01 no such format \xff" * 40)),
            f"a{suffix}",
            "impact a",
            "anew",
        )
        for suffix in (".lvm", ".tdms", ".mat", ".parquet", ".csv.gz")
    ),
]


@pytest.mark.slow
@pytest.mark.parametrize("malformed", CASES, ids=lambda c: c.name.replace(" ", "-"))
def test_refused_with_its_place_and_nothing_written(
    malformed: Case, lab: Lab, tmp_path: Path, command: Callable[..., Outcome]
) -> None:
    malformed.spoil(lab)
    before = sorted(path.name for path in tmp_path.rglob("*"))
    outcome = command("check", lab.folder, "--out", tmp_path / "quality")
    assert outcome.status == 2
    assert "problem" in outcome.err
    assert "nothing was written" in outcome.err
    for words in malformed.says:
        assert words in outcome.err
    assert not has_control_characters(outcome.out + outcome.err.replace("\n", ""))
    assert outcome.out == ""
    assert sorted(path.name for path in tmp_path.rglob("*")) == before


def test_everything_is_said_at_once(lab: Lab, command: Callable[..., Outcome]) -> None:
    lab.cell("impacts.csv", 2, "mass_kg", "heavy")
    lab.cell("impacts.csv", 3, "velocity_m_s", "-1")
    lab.samples("c", lambda time, value: np.copyto(value, -value))
    lab.samples("d", lambda time, value: np.copyto(time, time[::-1].copy()))
    outcome = command("check", lab.folder)
    assert outcome.err.startswith("4 problems")
    for words in ("impact a", "impact b", "impact c", "impact d"):
        assert words in outcome.err


def test_settings_and_impacts_are_refused_together(lab: Lab, command: Callable[..., Outcome]) -> None:
    lab.replace("dataset.toml", "quantity", "kind")
    lab.cell("impacts.csv", 2, "mass_kg", "0")
    outcome = command("check", lab.folder)
    assert "signal.quantity" in outcome.err
    assert "mass_kg" in outcome.err


@pytest.mark.parametrize("name", ["nothing-here", "a-file"])
def test_no_folder(name: str, tmp_path: Path, command: Callable[..., Outcome]) -> None:
    (tmp_path / "a-file").write_text("")
    outcome = command("check", tmp_path / name)
    assert outcome.status == 2
    assert name in outcome.err


@pytest.mark.parametrize("name", ["unit of something else", "mass zero", "clipped", "broken .tdms"])
def test_estimate_refuses_alike(name: str, lab: Lab, tmp_path: Path, command: Callable[..., Outcome]) -> None:
    next(case for case in CASES if case.name == name).spoil(lab)
    out = tmp_path / "estimates"
    assert command("estimate", lab.folder, "--out", out) == command("check", lab.folder)
    assert not out.exists()


@pytest.mark.parametrize("name", ["./a.csv", "a.csv", "nowhere/../a.csv"])
def test_a_path_inside_the_folder_may_take_a_way_round(name: str, lab: Lab) -> None:
    _trace_column("a.csv")(lab)
    plain = read_dataset(lab.folder)
    impacts = pd.read_csv(lab.path("impacts.csv"))
    impacts.loc[0, "trace"] = name
    impacts.to_csv(lab.path("impacts.csv"), index=False)
    found = read_dataset(lab.folder)
    np.testing.assert_array_equal(found.traces[0].value, plain.traces[0].value)
