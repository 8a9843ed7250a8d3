"""`bayestissue predict`: K, C and the peaks of new impacts by a finished fit."""

from __future__ import annotations

from collections.abc import Hashable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayestissue.commands.answers import answer

if TYPE_CHECKING:
    import pandas as pd

_SHOWN = {
    "K_N_per_m": ("K (N/m)", 1.0),
    "C_N_s_per_m": ("C (N s/m)", 1.0),
    "peak_displacement_m": ("depth (mm)", 1e3),
    "peak_force_N": ("force (N)", 1.0),
    "time_to_peak_s": ("to peak (ms)", 1e3),
}
_BESIDE = ("new", "draws", "simulated", "note")


def run(run: Path, *, at: Path, out: Path | None, overwrite: bool, quiet: bool, as_json: bool) -> None:
    """Predict each row of a table, print the predictions and, with ``out``, write ``predictions.csv``.

    Raises:
        InputError: ``run`` is no finished fit, the table is wrong (all that is), or ``out`` is not free.
    """
    answer(
        run,
        lambda finished: finished.predict(at),
        _print,
        command="predict",
        name="predictions",
        inputs=(run, at),
        out=out,
        overwrite=overwrite,
        quiet=quiet,
        as_json=as_json,
    )


def _print(table: pd.DataFrame) -> None:
    """The median of each quantity with its 90 % interval, and under the table what each row was given."""
    import pandas as pd
    from rich.console import Console
    from rich.table import Table

    from bayestissue.commands.console import explained, plain
    from bayestissue.remedies import codes_in

    console = Console(highlight=False)
    shown = Table("row", title="a new impact: median and 90 % interval", title_justify="left")
    for heading, _ in _SHOWN.values():
        shown.add_column(heading, justify="right")
    rows = table.to_dict("records")
    for number, row in enumerate(rows, start=1):
        shown.add_row(f"{number}", *(_cell(row, name) for name in _SHOWN))
    console.print(shown)
    given = [str(name) for name in table if name not in _BESIDE and not str(name).startswith(tuple(_SHOWN))]
    for number, row in enumerate(rows, start=1):
        values = {name: row[name] for name in given if pd.notna(row[name])}
        said = [", ".join(f"{k} {_text(v)}" for k, v in values.items())]
        said += [f"new: {row['new']}"] * bool(row["new"]) + [row["note"]] * bool(row["note"])
        console.print(plain(f"  row {number}: {'; '.join(said)}"), soft_wrap=True)
    explained(codes_in("; ".join(table["note"])))


def _text(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _cell(row: dict[Hashable, Any], name: str) -> str:
    import math

    from bayestissue.report.wording import significant

    if math.isnan(row[name]):
        return ""
    median, low, high = (significant(_SHOWN[name][1] * row[f"{name}{end}"]) for end in ("", "_low", "_high"))
    return f"{median}\n{low} to {high}"
