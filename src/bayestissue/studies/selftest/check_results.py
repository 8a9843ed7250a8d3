"""What a check of the self-test finds, and what becomes of all: a table, a verdict, a page of text."""

from __future__ import annotations

import os
import platform
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from bayestissue.base import runtime
from bayestissue.base.outline import markdown_rows
from bayestissue.base.result import Say
from bayestissue.base.results.tables import table_of_rows
from bayestissue.reports.pages.page_tables import shown


class Compared(NamedTuple):
    """What was compared, what was expected and found, in words, and whether that is well."""

    what: str
    expected: str
    found: str
    passed: bool


@dataclass(frozen=True)
class Part:
    """A part of the self-test.

    Attributes:
        name: what it is about.
        comparisons: of a folder, which is its own and empty, what it finds.
        thorough: whether it is one of ``--thorough`` alone.
    """

    name: str
    comparisons: Callable[[Path], Iterable[Compared]]
    thorough: bool = False


def differing(what: str, here: pd.DataFrame, there: pd.DataFrame) -> Compared:
    """Whether two tables have the same numbers: by a program's seed and on one machine, to the last digit."""
    if here.shape != there.shape:
        return Compared(what, f"{there.shape} numbers", f"{here.shape}", False)
    count = int((~np.isclose(here, there, rtol=0, atol=0, equal_nan=True)).sum())
    return Compared(what, "the same numbers", "the same" if not count else f"{count} differ", not count)


def run(checks: Iterable[Part], folder: Path, say: Say) -> pd.DataFrame:
    """All checks, one after another, each in a folder of its own: the table ``selftest.csv``.

    What a check raises is what it found.
    """
    rows: list[tuple[Any, ...]] = []
    chosen = list(checks)
    for number, check in enumerate(chosen):
        say(check.name, number, len(chosen))
        files, began = folder / f"check-{number}", perf_counter()
        files.mkdir(parents=True)
        try:
            comparisons = list(check.comparisons(files))
        except Exception as error:
            # Whatever it is, the other checks go on.
            comparisons = [Compared("it ran to its end", "yes", f"{type(error).__name__}: {error}", False)]
        seconds = round((perf_counter() - began) / len(comparisons), 2)
        rows += [(check.name, *compared[:3], int(compared.passed), seconds) for compared in comparisons]
    return table_of_rows("selftest", rows)


def verdict(table: pd.DataFrame) -> tuple[bool, str]:
    """Whether all is well, and so in one line."""
    failed, seconds = table[table["passed"] == 0], table["seconds"].sum()
    if failed.empty:
        return True, f"The self-test passed: {len(table)} checks in {seconds:.0f} s."
    names = ", ".join(dict.fromkeys(failed["check"]))
    return False, f"The self-test failed: {len(failed)} of {len(table)} checks ({names}). Trust no result."


def machine() -> dict[str, str]:
    """The machine that the program ran on."""
    memory = ""
    if hasattr(os, "sysconf") and "SC_PHYS_PAGES" in os.sysconf_names:
        memory = f"{os.sysconf('SC_PHYS_PAGES') * os.sysconf('SC_PAGE_SIZE') / 2**30:.1f} GiB"
    return {
        "system": platform.platform(),
        "processor": platform.processor() or platform.machine(),
        "cores": str(runtime.cores()),
        "memory": memory,
    }


def as_markdown(table: pd.DataFrame, record: Mapping[str, Any]) -> str:
    """The file to attach to a paper: verdict, date, versions, machine, and every check."""
    _, words = verdict(table)
    facts = {"date": record["started"], **record["versions"], **record["machine"]}
    return "\n".join(
        [
            "# Self-test of bayestissue",
            "",
            words,
            "",
            *markdown_rows(("", ""), facts.items()),
            "",
            *shown("selftest", table).markdown(),
            "",
        ]
    )
