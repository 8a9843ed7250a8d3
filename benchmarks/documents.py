"""Tables and sentences in the READMEs that the scripts which measured them write."""

from __future__ import annotations

import textwrap
from pathlib import Path

import pandas as pd

HERE = Path(__file__).parent
README = HERE / "README.md"


def between_marks(path: Path, script: str, text: str, indent: str = "") -> None:
    """Replace what stands between the marks of a script."""
    begin, end = (f"<!-- {script}: {word} -->" for word in ("begin", "end"))
    before, rest = path.read_text(encoding="utf-8").split(begin)
    after = rest.split(end)[1]
    path.write_text(f"{before}{begin}\n{text}\n{indent}{end}{after}", encoding="utf-8")


def paragraph(text: str, indent: str = "") -> str:
    """Broken into lines as the READMEs are."""
    return textwrap.fill(text, 120, initial_indent=indent, subsequent_indent=indent)


def table(rows: pd.DataFrame) -> str:
    """As Markdown: the first column to the left, the others to the right; empty where a cell is missing."""
    head = [" | ".join(map(str, rows.columns)), " | ".join(["---", *["---:"] * (rows.shape[1] - 1)])]
    cells = rows.astype(object).where(rows.notna(), "").astype(str)
    return "\n".join(f"| {line} |" for line in [*head, *(" | ".join(row) for row in cells.to_numpy())])


def with_error(share: pd.Series, error: pd.Series) -> list[str]:
    """Shares and their standard errors, in percent."""
    return [f"{100 * each:.1f} ± {100 * sd:.1f} %" for each, sd in zip(share, error, strict=True)]


def coverage(lines: pd.DataFrame, by: list[str]) -> pd.DataFrame:
    """Of each quantity: how often the intervals held it, how far off the median, how wide the widest."""
    lines = lines.assign(cell=with_error(lines["share"], lines["campaign_se"]))
    cells = lines.pivot_table("cell", by, "level", "first", sort=False).rename(columns="{} % held".format)
    widest = lines[lines["level"] == lines["level"].max()].set_index(by)
    cells["off by"], cells["90 % width"] = widest["median_error"], widest["median_width"]
    return cells
