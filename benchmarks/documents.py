"""Tables and sentences in the READMEs that the scripts which measured them write."""

from __future__ import annotations

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


def table(rows: pd.DataFrame) -> str:
    """As Markdown: the first column to the left, the others to the right; empty where a cell is missing."""
    head = [" | ".join(map(str, rows.columns)), " | ".join(["---", *["---:"] * (rows.shape[1] - 1)])]
    cells = rows.astype(object).where(rows.notna(), "").astype(str)
    return "\n".join(f"| {line} |" for line in [*head, *(" | ".join(row) for row in cells.to_numpy())])
