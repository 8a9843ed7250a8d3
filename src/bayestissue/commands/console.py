"""What commands say: safely, whoever wrote the names in it, and while a long one works."""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import rich.table
import typer
from rich.console import Console
from rich.measure import Measurement
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TaskID,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.text import Text

from bayestissue.base.errors import printable

if TYPE_CHECKING:
    from bayestissue.reports.pages.page_tables import Table


@dataclass(frozen=True)
class Screen:
    """How much a command prints, what a terminal shows at once.

    Attributes:
        width: letters of a line of text that is read from its beginning to its end.
        people: whose posteriors are listed; of more there is a file.
        named: impacts that a warning names.
        unbounded: letters of a line of which a table is measured without breaking a word.
    """

    width: int = 88
    people: int = 12
    named: int = 10
    unbounded: int = 10_000


SCREEN = Screen()


def echo(text: str, *, err: bool = False) -> None:
    """Print lines that may hold names of any origin: the terminal obeys none of them; ``err`` as of typer."""
    typer.echo(printable(text, lines=True), err=err)


def plain(text: str, style: str = "") -> Text:
    """The same for a table or a line that rich prints, which then reads no markup in it either."""
    return Text(printable(text, lines=True), style=style)


@dataclass(frozen=True)
class Grid:
    """A table of texts of any origin, with a title above it.

    Headings are not shown where all are empty. The first column breaks long words.
    """

    title: str
    table: Table

    def drawn(self) -> rich.table.Table:
        """As rich prints it."""
        columns = self.table.columns
        headed = any(column.title for column in columns)
        table = rich.table.Table(title=plain(self.title), title_justify="left", show_header=headed)
        for position, column in enumerate(columns):
            side: Any = "right" if column.kind == "number" else "left"
            # Two rows whose first cells begin alike are told apart by the ends of these cells.
            table.add_column(column.title, justify=side, overflow="ellipsis" if position else "fold")
        for row in self.table.rows:
            table.add_row(*map(plain, row.cells))
        return table


class Heading(str):
    """A line that stands above others."""

    __slots__ = ()


# What a command prints: lines, however long, and tables; of an empty line nothing.
type Shown = str | Heading | Grid


def show(what: Shown) -> None:
    """Print a line, or a table; on a terminal too narrow for it each cell stands on a line of its own."""
    console = Console(highlight=False)
    if isinstance(what, str):
        if what:
            console.print(plain(what, "bold" if isinstance(what, Heading) else ""), soft_wrap=True)
        return
    table = what.drawn()
    # A measurement says no more than the width that it may use.
    free = console.options.update(max_width=SCREEN.unbounded)
    if Measurement.get(console, free, table).minimum <= console.width:
        console.print(table)
        return
    if what.title:
        console.print(plain(what.title))
    for row in what.table.rows:
        for column, cell in zip(what.table.columns, row.cells, strict=True):
            if cell:
                console.print(plain(f"{column.title}: {cell}" if column.title else cell), soft_wrap=True)


class Stages:
    """Called with a stage, how much of it is done and its total; shows one bar a stage.

    A stage is told by its words before the first comma: what stands behind it may change as it goes on.

    Where standard error is no terminal, a line is printed when a stage begins and at most every ten
    seconds while it lasts, so that a log tells what takes long. ``quiet`` says nothing. No line is printed in
    the first ``patience_s`` seconds: of what is over by then a log needs none.
    """

    interval_s = 10.0

    def __init__(self, *, quiet: bool, patience_s: float = 0.0) -> None:
        self._quiet = quiet
        self._stage, self._done = "", 0
        self._task: TaskID | None = None
        self._began = self._spoke = time.monotonic()
        self._done_before, self._silent_until = 0, self._began + patience_s
        console = Console(stderr=True)
        columns = BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TimeRemainingColumn()
        bars = Progress("{task.description:34}", *columns, console=console)
        self._bars = bars if console.is_terminal and not quiet else None

    @property
    def started(self) -> bool:
        """Whether any stage was told."""
        return bool(self._stage)

    def __enter__(self) -> Stages:
        if self._bars is not None:
            self._bars.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._bars is not None:
            self._finish_bar()
            self._bars.stop()

    def __call__(self, stage: str, done: int, total: int) -> None:
        """Tell that ``done`` of ``total`` parts of ``stage`` are done."""
        if self._quiet:
            return
        # Sites are made in several passes over all impacts: each has a time of its own.
        new = stage.split(",")[0] != self._stage.split(",")[0] or done < self._done
        other_words = stage != self._stage
        self._stage, self._done = stage, done
        if self._bars is not None:
            if new:
                self._finish_bar()
                self._task = self._bars.add_task(stage, total=total)
            if self._task is not None:
                self._bars.update(self._task, description=stage, completed=done, total=total)
            return
        now = time.monotonic()
        # The first part of a stage has what is compiled in it: the time left is told from the others.
        if new or not self._done_before:
            self._began, self._done_before = now, done
        if now >= self._silent_until and (other_words or new or now - self._spoke > self.interval_s):
            self._spoke = now
            count, since = f": {done} of {total}" if total > 1 else "", done - self._done_before
            if count and self._done_before and since > 0:
                count += f", about {(now - self._began) / since * (total - done):.0f} s left"
            print(f"{stage}{count}", file=sys.stderr, flush=True)  # noqa: T201

    def _finish_bar(self) -> None:
        if self._bars is not None and self._task is not None:
            task = self._bars.tasks[self._task]
            self._bars.update(self._task, completed=task.total)
