"""`bayestissue check`: what is wrong with a dataset, and how good its recordings are."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayestissue import results
from bayestissue.commands.options import DatasetFolder, Json, Overwrite, Quiet, SkipBad
from bayestissue.errors import Problem
from bayestissue.remedies import codes_in
from bayestissue.words import Words

if TYPE_CHECKING:
    import pandas as pd

    from bayestissue.checking import Check
    from bayestissue.signal.force import Force


def run(
    dataset: DatasetFolder,
    out: Path | None = None,
    skip_bad: SkipBad = False,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    """Say what is wrong with a dataset: file, row, column, value, what was expected, how to mend it.

    Args:
        out: Also write quality figures and a page with one panel per impact.
    """
    with results.claim_if(out, overwrite=overwrite, command="check", inputs=(dataset,)) as target:
        from bayestissue.checking import check
        from bayestissue.commands.console import echo
        from bayestissue.dataset import read_dataset

        checked = check(read_dataset(dataset, skip_bad=skip_bad))
        if target is not None:
            _write(target, checked)
        if as_json:
            echo(json.dumps(_plain(checked), default=str, ensure_ascii=False))
        elif not quiet:
            _print(checked)
            if target is not None:
                echo(f"wrote {target.path / 'check.html'}")


def _plain(checked: Check) -> dict[str, Any]:
    data = checked.dataset
    return {
        "dataset": data.name,
        "verdict": checked.verdict,
        "impacts": len(data.impacts),
        "input_hash": data.input_hash,
        "left_out": [problem.as_dict() for problem in data.left_out],
        "warnings": [problem.as_dict() for problem in checked.warnings],
        "notes": checked.notes,
        **({"force": _plain_force(checked.force)} if checked.force else {}),
        "quality": json.loads(checked.quality.to_json(orient="records")),
    }


def _plain_force(force: Force) -> dict[str, Any]:
    (ratio, scatter), (lag, lag_sd) = force.common, force.common_lag
    lags = {} if force.impulse else {"lag_s": lag, "lag_sd_s": lag_sd}
    return {
        "channel": force.channel.name,
        "ratio": ratio,
        "ratio_sd": force.total_sd,
        "ratio_scatter": scatter,
        **lags,
        "contradicts": force.contradicts,
    }


def _print(checked: Check) -> None:
    from rich.table import Table

    from bayestissue.commands.console import explained, line, plain, show
    from bayestissue.report.recordings_pages import kinds

    data = checked.dataset
    title = plain(f"{data.name}: {checked.verdict}")
    table = Table(title=title, show_header=False, title_justify="left")
    nouns = Words(data.words)
    for name, words in (*_summary(checked), *(("note", words) for words in checked.notes)):
        table.add_row(nouns(name), plain(nouns(words)))
    show(table)
    for heading, problems in (("Left out", data.left_out), ("Warnings", checked.warnings)):
        if problems:
            line(f"{heading}:", "bold")
        for first, *others in kinds(problems):
            more = f" The same in {_names(others)}." if others else ""
            line(f"  {first}{more} [{first.code}]")
    codes = [problem.code for problem in (*data.left_out, *checked.warnings)]
    explained([*codes, *codes_in("; ".join(checked.notes))])


def _summary(checked: Check) -> list[tuple[str, str]]:
    from bayestissue.dataset.impacts import counts

    data, quality, impacts = checked.dataset, checked.quality, checked.dataset.impacts
    noise = quality["noise_to_peak"]
    # Of a slow recording the window goes on to the rebound.
    until_peak = quality["time_to_peak_s"] * quality["sampling_rate_hz"] // 1 + 1
    return [
        ("impacts", counts(impacts)),
        ("recorded", data.quantity),
        *([("further channel", str(channel)) for channel in data.channels]),
        *([("force", checked.force.words)] if checked.force else []),
        *([("gravity along the motion", f"{data.gravity:.4g} m/s²")] if data.gravity else []),
        *([("low-pass", str(data.recorder)), ("noise entered", _entry(checked))] if data.recorder else []),
        *([("contact", checked.signal.phase.words)] if data.quantity != "displacement" else []),
        ("samples per impact", _range(quality["n_samples"], "")),
        ("sampling rate", _range(quality["sampling_rate_hz"], " Hz")),
        ("mass", _range(impacts["mass_kg"], " kg")),
        ("velocity at contact", _range(impacts["velocity_m_s"], " m/s", digits=4)),
        ("time to peak", _range(quality["time_to_peak_s"] * 1e3, " ms", digits=3)),
        ("samples until the peak", _range(quality["samples_in_window"].clip(upper=until_peak), "")),
        ("noise", f"{noise.median():.2g} of the peak, at worst {noise.max():.2g}"),
    ]


def _entry(checked: Check) -> str:
    """Where a recorder's noise entered, in words."""
    from bayestissue.signal.recorder_noise import white_share

    white = white_share(checked.dataset, checked.signal)
    if white in {0.0, 1.0}:
        return f"{'behind' if white else 'before'} the low-pass"
    return f"before the low-pass, and {white:.0%} of it behind"


def _names(problems: list[Problem]) -> str:
    """The impacts, up to ten by name."""
    from bayestissue.commands.console import SCREEN

    names = list(dict.fromkeys(problem.impact for problem in problems if problem.impact))
    named, more = names[: SCREEN.named], len(names) - SCREEN.named
    others = f" and {more} more impacts" if more > 0 else ""
    return f"{', '.join(named)}{others}" if names else f"{len(problems)} more places"


def _range(values: pd.Series, unit: str, digits: int = 6) -> str:
    low, high = values.min(), values.max()
    if not low <= high:
        return "not stated"
    ends = [f"{end:.0f}" if end >= 10**digits else f"{end:.{digits}g}" for end in (low, high)]
    return f"{ends[0]}{unit}" if low == high else f"{ends[0]} to {ends[1]}{unit}"


def _write(target: results.OutputFolder, checked: Check) -> None:
    from bayestissue.report.run_folder import after_results

    with target.folder() as staging:
        results.write_table(checked.quality, staging / "quality.csv")
        results.write_table(checked.problems, staging / "problems.csv")
    with (
        after_results(target.path, "the same command with --overwrite repeats it"),
        results.whole_file(target.path / "check.html") as staging,
    ):
        staging.write_text(checked.page(), encoding="utf-8")
