"""Write a dataset folder that `read_dataset` reads back."""

from __future__ import annotations

import gzip
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import pandas as pd
import pyarrow as pa
import pyarrow.csv as pa_csv
import pyarrow.parquet as pq

from bayestissue.base.results.tables import as_text, write_table
from bayestissue.base.settings import allowed_keys
from bayestissue.recordings.dataset.dataset_file import Settings, parse_settings
from bayestissue.recordings.dataset.dialect import Stated

TraceFile = Literal["traces.csv", "traces.csv.gz", "traces.parquet"]


def write_dataset(
    folder: Path,
    *,
    settings: dict[str, Any],
    impacts: pd.DataFrame,
    traces: pd.DataFrame | None = None,
    trace_file: TraceFile = "traces.csv.gz",
    further: Mapping[str, pd.DataFrame] | None = None,
) -> None:
    """Write ``dataset.toml``, ``impacts.csv`` and one long trace table; the same input gives the same bytes.

    Without ``traces`` no table is written: the column ``trace`` of ``impacts`` then names a file for each.

    Args:
        folder: made if it is not there.
        settings: the keys of ``dataset.toml``, tables as nested dictionaries.
        impacts: one row per impact, with the columns that ``impacts.csv`` needs, and covariates.
        traces: one row per sample: ``impact`` (text or categories), the time and the value column that
            the settings name (``time_s`` and ``value`` unless they say otherwise), in their units.
        trace_file: the name, and with it the format, of the trace table.
        further: tables of further channels by the names of their files, with ``impact``, ``time_s`` and
            ``value``.

    Raises:
        InputError: the settings are not those of a dataset.
        KeyError: a needed column is missing.
    """
    parsed = parse_settings(settings)
    signal = parsed.signal
    first = [name for name in ("impact", "subject", "trial", "mass_kg") if name != "trial" or name in impacts]
    impacts = impacts[list(dict.fromkeys([*first, *impacts.columns]))]
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "dataset.toml").write_text(settings_text(settings), encoding="utf-8")
    write_table(impacts, folder / "impacts.csv")
    if traces is not None:
        in_table = [channel for channel in settings.get("channel", ()) if "file" not in channel]
        names = [one[key] for one in in_table for key in ("time_column", "value_column") if key in one]
        columns = dict.fromkeys([signal.time_column, signal.value_column, *names])
        _write_table(traces[["impact", *columns]], folder / trace_file)
    for name, table in (further or {}).items():
        _write_table(table, folder / name)


def _write_table(frame: pd.DataFrame, path: Path) -> None:
    table = pa.Table.from_pandas(frame, preserve_index=False).replace_schema_metadata(None)
    if path.suffix == ".parquet":
        pq.write_table(table, path, compression="zstd", write_page_checksum=True)
        return
    plain = table.cast(
        pa.schema([(field.name, getattr(field.type, "value_type", field.type)) for field in table.schema])
    )
    names = pd.Series(plain["impact"].unique().to_pylist(), dtype=str)
    if any(as_text(name) != name for name in names):
        texts = pa.array(frame["impact"].astype(str).map(as_text), pa.string())
        plain = plain.set_column(plain.column_names.index("impact"), "impact", texts)
    options = pa_csv.WriteOptions(quoting_style="needed")
    if path.suffix != ".gz":
        pa_csv.write_csv(plain, path, options)
        return
    # A time stamp in the gzip header would make every run's bytes, and so its hash, another.
    with path.open("wb") as raw, gzip.GzipFile("", "wb", 6, raw, mtime=0) as packed:
        pa_csv.write_csv(plain, packed, options)


def settings_text(settings: dict[str, Any]) -> str:
    """``dataset.toml`` of these keys, tables as nested dictionaries."""
    import tomlkit

    content: dict[str, Any] = {}
    # Tables stand behind single keys, and lists of tables last.
    for kind in (str, dict, list | tuple):
        for key in Settings.model_fields:
            table = settings.get(key)
            if isinstance(table, kind) and table not in ([], ()):
                # Among the keys of [signal] those of how texts are written are the last.
                order = sorted(allowed_keys(Settings, [key]), key=Stated.model_fields.__contains__)
                if isinstance(table, dict):
                    table = {name: table[name] for name in order if name in table}
                content[key] = table
    return tomlkit.dumps(content)
