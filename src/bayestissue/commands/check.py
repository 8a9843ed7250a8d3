"""`bayestissue check`: what is wrong with a dataset, and how good its recordings are."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pandas as pd
from rich.console import Console
from rich.table import Table

from bayestissue.checking import Check, check
from bayestissue.commands.console import echo, explained, plain
from bayestissue.dataset import read_dataset
from bayestissue.errors import Problem
from bayestissue.remedies import codes_in
from bayestissue.report.recordings_pages import kinds
from bayestissue.report.writing import after_results
from bayestissue.results import Excel, Place, claim_if, whole_file, write_table
from bayestissue.signal.recorder_noise import white_share

_NAMED = 10


def run(
    dataset: Path,
    *,
    out: Path | None,
    excel: Excel | None = None,
    skip_bad: bool,
    overwrite: bool,
    quiet: bool,
    as_json: bool,
) -> None:
    """Check a dataset folder, say what was found and, with ``out``, write quality figures.

    Writes ``quality.csv`` (one row per impact), ``problems.csv`` (what was left out, and warnings) and
    ``check.html`` (a panel per impact).

    Raises:
        InputError: something is wrong with the dataset, or ``out`` is not free.
    """
    with claim_if(out, overwrite=overwrite, command="check", inputs=(dataset,)) as place:
        found = check(read_dataset(dataset, skip_bad=skip_bad))
        if place is not None:
            _write(place, found, excel)
        if as_json:
            echo(json.dumps(_plain(found), default=str, ensure_ascii=False))
        elif not quiet:
            _print(found)
            if place is not None:
                echo(f"wrote {place.path / 'check.html'}")


def _plain(found: Check) -> dict[str, Any]:
    data = found.dataset
    return {
        "dataset": data.name,
        "verdict": found.verdict,
        "impacts": len(data.impacts),
        "input_hash": data.input_hash,
        "left_out": [problem.as_dict() for problem in data.left_out],
        "warnings": [problem.as_dict() for problem in found.warnings],
        "notes": found.notes,
        "quality": json.loads(found.quality.to_json(orient="records")),
    }


def _print(found: Check) -> None:
    data, warnings = found.dataset, found.warnings
    console = Console(highlight=False)
    table = Table(
        title=plain(f"{data.name}: {found.verdict}"),
        show_header=False,
        title_justify="left",
    )
    for name, words in _summary(found):
        table.add_row(name, plain(words))
    for words in found.notes:
        table.add_row("note", plain(words))
    console.print(table)
    for heading, problems in (("Left out", data.left_out), ("Warnings", warnings)):
        if problems:
            console.print(plain(f"{heading}:", style="bold"))
            for some in kinds(problems):
                more = f" The same in {_names(some[1:])}." if len(some) > 1 else ""
                console.print(plain(f"  {some[0]}{more} [{some[0].code}]"), soft_wrap=True)
    explained([*(each.code for each in (*data.left_out, *warnings)), *codes_in("; ".join(found.notes))])


def _summary(found: Check) -> list[tuple[str, str]]:
    data, quality, impacts = found.dataset, found.quality, found.dataset.impacts
    noise = quality["noise_to_peak"]
    return [
        (
            "impacts",
            f"{len(impacts)}; subjects: {impacts['subject'].nunique()}, trials: {impacts['trial'].nunique()}",
        ),
        ("recorded", data.quantity),
        *([("gravity along the motion", f"{data.gravity:.4g} m/s²")] if data.gravity else []),
        *([("low-pass", str(data.recorder)), ("noise entered", _entry(found))] if data.recorder else []),
        ("samples per impact", _range(quality["n_samples"], "")),
        ("sampling rate", _range(quality["sampling_rate_hz"], " Hz")),
        ("mass", _range(impacts["mass_kg"], " kg")),
        ("velocity at contact", _range(impacts["velocity_m_s"], " m/s", digits=4)),
        ("time to peak", _range(quality["time_to_peak_s"] * 1e3, " ms", digits=3)),
        ("samples until the peak", _range(quality["samples_in_window"], "")),
        ("noise", f"{noise.median():.2g} of the peak, at worst {noise.max():.2g}"),
    ]


def _entry(found: Check) -> str:
    """Where a recorder's noise entered, in words."""
    white = white_share(found.dataset, found.signal)
    if white in {0.0, 1.0}:
        return f"{'behind' if white else 'before'} the low-pass"
    return f"before the low-pass, and {white:.0%} of it behind"


def _names(problems: list[Problem]) -> str:
    """The impacts, up to ten by name."""
    names = list(dict.fromkeys(problem.impact for problem in problems if problem.impact))
    more = f" and {len(names) - _NAMED} more impacts" if len(names) > _NAMED else ""
    return f"{', '.join(names[:_NAMED])}{more}" if names else f"{len(problems)} more places"


def _range(values: pd.Series, unit: str, digits: int = 6) -> str:
    low, high = values.min(), values.max()
    if pd.isna(low):
        return "not stated"
    ends = [f"{end:.0f}" if end >= 10**digits else f"{end:.{digits}g}" for end in (low, high)]
    return f"{ends[0]}{unit}" if low == high else f"{ends[0]} to {ends[1]}{unit}"


def _write(place: Place, found: Check, excel: Excel | None) -> None:
    with place.folder() as staging:
        write_table(found.quality, staging / "quality.csv", excel)
        write_table(found.problems, staging / "problems.csv", excel)
    with (
        after_results(place.path, "the same command with --overwrite repeats it"),
        whole_file(place.path / "check.html") as staging,
    ):
        staging.write_text(found.page(), encoding="utf-8")
