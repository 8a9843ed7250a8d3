"""What a command computes, and Python returns: tables, a record and a page, and one way to write them."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar

from bayestissue.base.errors import InputError, PartialResultError
from bayestissue.base.outline import Outlined, short
from bayestissue.base.remedies import Code
from bayestissue.base.results.files import whole_file, write_json
from bayestissue.base.results.output_folder import OutputFolder, claim
from bayestissue.base.results.tables import write_table

if TYPE_CHECKING:
    import pandas as pd

type Say = Callable[[str, int, int], None]


def silent(*_: object) -> None:
    """Say nothing."""


class Result(Outlined):
    """What a command computes.

    Attributes:
        about: the content of ``run.json``; empty where there is none.
    """

    command: ClassVar[str]
    page_file: ClassVar[str] = "report.html"
    # Those that the command names when it has written all.
    files: ClassVar[tuple[str, ...]] = ("report.html",)
    # Those of the folder, attributes by the names of their files.
    table_names: ClassVar[tuple[str, ...]] = ()
    about: dict[str, Any]

    @property
    def tables(self) -> Mapping[str, pd.DataFrame]:
        """The tables of the folder, by the names of their files."""
        return {name: getattr(self, name) for name in self.table_names}

    @property
    def passed(self) -> bool:
        """Whether the diagnostics let the numbers be used."""
        return True

    @property
    def inputs(self) -> tuple[str | Path | None, ...]:
        """Files and folders that these results were made of, in whose place they can't be written."""
        return ()

    def page(self) -> str:
        """The HTML of the page; empty where there is none."""
        return ""

    def page_in(self, folder: Path) -> str:
        """The same, once all other files stand in a folder."""
        return self.page()

    def write(self, folder: Path) -> None:
        """Write every file but the page into a folder."""
        for name, table in self.tables.items():
            write_table(table, folder / f"{name}.csv")
        if self.about:
            write_json(self.about, folder / "run.json")

    def report(self, path: str | Path, *, overwrite: bool = False) -> Path:
        """Write the folder that the command writes, page and all; or only the page.

        Args:
            path: a folder that is new or empty, or a file name that ends in ``.html``.
            overwrite: replace what is there.

        Returns:
            The path of the page, or of the folder where there is none.

        Raises:
            InputError: ``path`` is taken and ``overwrite`` is false, or holds what no command wrote.
            PartialResultError: the results are written, but not the page.
        """
        path = Path(path)
        if path.suffix == ".html":
            if path.exists() and not overwrite:
                raise InputError.stated("out-taken.page", str(path))
            return _put(path, self.page())
        with claim(path, overwrite=overwrite, command=self.command, inputs=self.inputs) as target:
            return self.put(target, silent)

    def put(self, target: OutputFolder, say: Say) -> Path:
        """Write all into a claimed place, whole, and then the page, which must not put them in doubt.

        Raises:
            PartialResultError: as of `report`.
        """
        say("writing the results", 0, 1)
        with target.folder() as folder:
            self.write(folder)
        say("writing the report", 0, 1)
        again = f"`bayestissue report {target.path}` draws the page"
        with after_results(
            target.path, again if self.about else "the same command with --overwrite repeats it"
        ):
            html = self.page_in(target.path)
            return _put(target.path / self.page_file, html) if html else target.path

    def as_json(self) -> Any:
        """What ``--json`` prints: of each table, by its name, the rows."""
        return {name: json.loads(table.to_json(orient="records")) for name, table in self.tables.items()}

    def wrote(self, folder: Path) -> str:
        """What was written, in a line."""
        return f"wrote {' and '.join(str(folder / name) for name in self.files)}"


@dataclass(frozen=True, eq=False, repr=False)
class Made(Result):
    """What a command computes that Python does not offer.

    Attributes:
        about: the content of ``run.json``; empty where there is none.
        tables: by the names of their files.
        further: writes the other files into a folder.
        html: the page, made once all files stand in the folder.
        passed: whether all checks did.
        files: those that the command names when it has written all.
        said: what it says then of the ``{folder}`` in place of this.
        inputs: what these results were made of.
        words: what the command prints.
    """

    command = "export"
    about: dict[str, Any] = field(default_factory=dict)
    tables: Mapping[str, pd.DataFrame] = MappingProxyType({})
    further: Callable[[Path], None] = lambda _: None
    html: Callable[[Path], str] = lambda _: ""
    passed: bool = True
    files: tuple[str, ...] = ("report.html",)  # type: ignore[misc]
    said: str = ""
    inputs: tuple[str | Path | None, ...] = ()
    words: Iterable[Any] = ()

    def page_in(self, folder: Path) -> str:
        """The page."""
        return self.html(folder)

    def write(self, folder: Path) -> None:
        """Write every file but the page into a folder."""
        super().write(folder)
        self.further(folder)

    def wrote(self, folder: Path) -> str:
        """What was written, in a line."""
        return self.said.format(folder=folder) or super().wrote(folder)


def _put(path: Path, html: str) -> Path:
    with whole_file(path) as staging:
        staging.write_text(html, encoding="utf-8")
    return path


@contextmanager
def after_results(
    folder: Path, again: str, *, failed: str = "their page could not be drawn", code: Code = "page-not-drawn"
) -> Iterator[None]:
    """A block that adds to results that stand.

    Args:
        folder: of the results.
        again: how it is repeated if it fails or is stopped.
        failed: what it means that it failed.
        code: of that.

    Raises:
        PartialResultError: whatever failed in the block, in one line.
    """
    try:
        yield
    except KeyboardInterrupt as request:
        request.add_note(f"the results are in {folder}; {again}")
        raise
    except Exception as error:
        what = short(" ".join(f"{type(error).__name__}: {error}".split()), 300)
        words = f"the results are in {folder}, but {failed} ({what}); {again}"
        raise PartialResultError(words, code=code) from error
