"""`bayestissue check`: what is wrong with a dataset, and how good its recordings are."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pandas as pd
from rich.console import Console
from rich.table import Table

from bayestissue.commands.console import echo, plain
from bayestissue.dataset import Dataset, read_dataset
from bayestissue.errors import Problem
from bayestissue.inference.points.notes import said_once
from bayestissue.report.check_page import check_page, kinds, quality_table
from bayestissue.report.writing import after_results
from bayestissue.results import Place, claim, whole_file
from bayestissue.signal import Displacements, displacements
from bayestissue.signal.displacement import FEWEST_SAMPLES
from bayestissue.signal.quality import inspect

_NAMED = 10


def run(
    dataset: Path, *, out: Path | None, skip_bad: bool, overwrite: bool, quiet: bool, as_json: bool
) -> None:
    """Check a dataset folder, say what was found and, with ``out``, write quality figures.

    Writes ``quality.csv`` (one row per impact), ``problems.csv`` (what was left out, and warnings) and
    ``check.html`` (a panel per impact).

    Raises:
        InputError: something is wrong with the dataset, or ``out`` is not free.
    """
    if out is None:
        _check(dataset, None, skip_bad=skip_bad, quiet=quiet, as_json=as_json)
        return
    with claim(out, overwrite=overwrite, command="check", inputs=(dataset,)) as place:
        _check(dataset, place, skip_bad=skip_bad, quiet=quiet, as_json=as_json)


def _check(dataset: Path, place: Place | None, *, skip_bad: bool, quiet: bool, as_json: bool) -> None:
    data = read_dataset(dataset, skip_bad=skip_bad)
    signal = displacements(data)
    warnings = [*data.warnings, *_raised(data, signal)]
    quality = quality_table(data, signal, warnings)
    if place is not None:
        _write(place, data, signal, quality, warnings)
    if as_json:
        content = _plain(data, signal, quality, warnings)
        echo(json.dumps(content, default=str, ensure_ascii=False))
    elif not quiet:
        _print(data, signal, quality, warnings)
    if place is not None and not quiet and not as_json:
        echo(f"wrote {place.path / 'check.html'}")


def _verdict(data: Dataset, signal: Displacements, warnings: list[Problem]) -> str:
    left_out = len({problem.impact for problem in data.left_out})
    warned = len(kinds(warnings))
    fine = f"no errors, {warned} warning{'s' if warned > 1 else ''}" if warned else "fine"
    fine += f" without the {left_out} impacts left out" if left_out else ""
    short = int((signal.n_samples < FEWEST_SAMPLES).sum())
    if not short:
        return fine
    return f"{fine}, and {short} of {len(data.impacts)} impacts too short to be fitted (see the warnings)"


def _plain(
    data: Dataset, signal: Displacements, quality: pd.DataFrame, warnings: list[Problem]
) -> dict[str, Any]:
    return {
        "dataset": data.name,
        "verdict": _verdict(data, signal, warnings),
        "impacts": len(data.impacts),
        "input_hash": data.input_hash,
        "left_out": [problem.as_dict() for problem in data.left_out],
        "warnings": [problem.as_dict() for problem in warnings],
        "notes": _notes(data, signal),
        "quality": json.loads(quality.to_json(orient="records")),
    }


def _raised(data: Dataset, signal: Displacements) -> list[Problem]:
    """What the signal chain and the detectors of spoilt recordings say: the flags of `estimate`."""
    names = data.impacts["impact"]
    chain = [
        Problem("recording", "a recording that the default signal chain can use", f"{flag}.", impact=impact)
        for impact, flags in zip(names, signal.flags, strict=True)
        for flag in flags
    ]
    spoilt = [
        Problem("recording", finding.kind.expected, finding.advice, value=said, impact=impact)
        for finding in inspect(data)
        for impact, said in zip(names, finding.said, strict=True)
        if said
    ]
    return [*chain, *spoilt]


def _notes(data: Dataset, signal: Displacements) -> list[str]:
    impacts = data.impacts
    one_mass = impacts["mass_kg"].min() == impacts["mass_kg"].max()
    masses = ["the mass never varies: these data have no mass exponent"] if one_mass else []
    return [*masses, *said_once("; ".join(notes) for notes in signal.notes)]


def _print(data: Dataset, signal: Displacements, quality: pd.DataFrame, warnings: list[Problem]) -> None:
    console = Console(highlight=False)
    table = Table(
        title=plain(f"{data.name}: {_verdict(data, signal, warnings)}"),
        show_header=False,
        title_justify="left",
    )
    for name, words in _summary(data, quality):
        table.add_row(name, plain(words))
    for words in _notes(data, signal):
        table.add_row("note", plain(words))
    console.print(table)
    for heading, problems in (("Left out", data.left_out), ("Warnings", warnings)):
        if problems:
            console.print(plain(f"{heading}:", style="bold"))
            for some in kinds(problems):
                more = f" The same in {_names(some[1:])}." if len(some) > 1 else ""
                console.print(plain(f"  {some[0]}{more}"), soft_wrap=True)


def _summary(data: Dataset, quality: pd.DataFrame) -> list[tuple[str, str]]:
    impacts = data.impacts
    noise = quality["noise_to_peak"]
    return [
        (
            "impacts",
            f"{len(impacts)}; subjects: {impacts['subject'].nunique()}, trials: {impacts['trial'].nunique()}",
        ),
        ("recorded", data.quantity),
        ("samples per impact", _range(quality["n_samples"], "")),
        ("sampling rate", _range(quality["sampling_rate_hz"], " Hz")),
        ("mass", _range(impacts["mass_kg"], " kg")),
        ("velocity at contact", _range(impacts["velocity_m_s"], " m/s")),
        ("time to peak", _range(quality["time_to_peak_s"] * 1e3, " ms")),
        ("samples until the peak", _range(quality["samples_in_window"], "")),
        ("noise", f"{noise.median():.2g} of the peak, at worst {noise.max():.2g}"),
    ]


def _names(problems: list[Problem]) -> str:
    """The impacts, up to ten by name."""
    names = list(dict.fromkeys(problem.impact for problem in problems if problem.impact))
    more = f" and {len(names) - _NAMED} more impacts" if len(names) > _NAMED else ""
    return f"{', '.join(names[:_NAMED])}{more}" if names else f"{len(problems)} more places"


def _range(values: pd.Series, unit: str) -> str:
    low, high = values.min(), values.max()
    if pd.isna(low):
        return "not stated"
    return f"{low:.6g}{unit}" if low == high else f"{low:.6g} to {high:.6g}{unit}"


def _write(
    place: Place, data: Dataset, signal: Displacements, quality: pd.DataFrame, warnings: list[Problem]
) -> None:
    lists = [("left out", problem) for problem in data.left_out] + [("warning", p) for p in warnings]
    columns = ["severity", "file", "row", "column", "impact", "value", "expected", "remedy"]
    problems = pd.DataFrame([{"severity": s, **p.as_dict()} for s, p in lists], columns=columns)
    with place.folder() as staging:
        quality.to_csv(staging / "quality.csv", index=False)
        problems.astype({"row": "Int64"}).to_csv(staging / "problems.csv", index=False)
    with (
        after_results(place.path, "the same command with --overwrite repeats it"),
        whole_file(place.path / "check.html") as staging,
    ):
        page = check_page(data, signal, quality, verdict=_verdict(data, signal, warnings), warnings=warnings)
        staging.write_text(page, encoding="utf-8")
