"""What is known of every recording besides its samples: by name, by table, or for all alike."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import TYPE_CHECKING

import pandas as pd

from bayestissue.base.errors import InputError, Problem, collected, refuse
from bayestissue.base.outline import first_of
from bayestissue.recordings.dataset.cells import in_case_of, is_height, read_cells, with_subject
from bayestissue.recordings.dataset.source_files import Source
from bayestissue.recordings.intake.folder import RecorderFile, RecorderFolder
from bayestissue.recordings.intake.names import (
    NUMBERS,
    Pattern,
    columns,
    contradictions,
    fills,
)

if TYPE_CHECKING:
    from bayestissue.recordings.intake.choices import Choices

FILE, NUMBER = "file", "number"

type Cells = dict[str, str | float]


@dataclass(frozen=True)
class Facts:
    """The cells of ``impacts.csv`` that are known of each recording.

    Attributes:
        of_file: by the name of the file, what holds for all of its impacts.
        of_number: by the name of the file and the number of the impact, where the table tells them apart.
        columns: the columns that are filled; a height of fall fills that of the velocity besides its own.
        problems: what is wrong.
        written: how the table is written, in words; empty without one.
        passed_over: what of the table belongs to no recording, in words.
    """

    of_file: dict[str, Cells]
    of_number: dict[tuple[str, int], Cells]
    columns: frozenset[str]
    problems: tuple[Problem, ...]
    written: str = ""
    passed_over: tuple[str, ...] = ()


def gather(recordings: RecorderFolder, choices: Choices, table: Source | None, *, loose: bool) -> Facts:
    """Bring together what names, a table and options say.

    Args:
        recordings: the files.
        choices: how names of files are read, see `Pattern`, and what holds for all recordings.
        table: with a column ``file``, the name of a recording with or without its ending, and a column for
            each fact; with a column ``number`` also, a row for each impact of a recording. Without ``file``
            it is joined by the columns that names have too, such as ``subject``: a row for each person.
        loose: whether nobody said how names are read: what they seem to say must not contradict the rest.

    Raises:
        InputError: the pattern or the table can't be used, or a fact is given in two ways.
    """
    shared, names = choices.given, Pattern.parse(choices.pattern) if choices.pattern else None
    fields = names.fields if names else ()
    rows = _FactTable.read(table, fields) if table else _FactTable()
    sources = {"--pattern": fields, "--table": rows.facts, "--set": tuple(shared)}
    _once(sources)
    problems = list(rows.unmatched_rows(recordings.files))
    of_file: dict[str, Cells] = {}
    of_number: dict[tuple[str, int], Cells] = {}
    for file in recordings.files:
        with collected(problems):
            from_name = names.read(file.source) if names else {}
            whole = names.whole(from_name) if names else {}
            keyed = whole if names and not {*names.within.values()} <= {*rows.keys} else from_name
            for number, cells in rows.cells_of(file, keyed).items():
                problems += contradictions(file, {**shared, **cells}) if loose else ()
                filled = columns({**shared, **whole, **cells}, file.name)
                of_file[file.name] = filled
                if number is not None:
                    of_number[file.name, number] = filled
    named = [name for fields in sources.values() for name in fields]
    filled_columns = frozenset([*map(fills, named), *filter(is_height, named)])
    passed_over = rows.unused(of_file.values())
    return Facts(of_file, of_number, filled_columns, tuple(problems), rows.written, passed_over)


def _once(sources: dict[str, tuple[str, ...]]) -> None:
    by_column: dict[str, list[str]] = {}
    for source, fields in sources.items():
        for name in fields:
            # A velocity may stand beside its height.
            column = name if is_height(name) and fills(name) in fields else fills(name)
            by_column.setdefault(column, []).append(f"{name} by {source}")
    problems = [
        Problem.stated("facts-of-recordings.sources", "init", column=column, value=" and ".join(said))
        for column, said in by_column.items()
        if len(said) > 1
    ]
    if "trace" in by_column:
        problems.append(Problem.stated("facts-of-recordings.trace", "init", column="trace"))
    refuse(problems)


@dataclass(frozen=True)
class _FactTable:
    """A table of facts: their columns, its rows by line, and what it is joined by in place of ``file``."""

    label: str = ""
    facts: tuple[str, ...] = ()
    rows: tuple[tuple[int, dict[str, str]], ...] = ()
    written: str = ""
    keys: tuple[str, ...] = ()

    @classmethod
    def read(cls, source: Source, fields: Sequence[str]) -> _FactTable:
        cells, lines = read_cells(source)
        names = _in_standard_case(cells)
        if "subject" not in fields or FILE not in names:
            names = with_subject(names)
        cells.columns = pd.Index(names)
        keys = () if FILE in names else tuple(n for n in fields if n in names and n not in NUMBERS)
        records = tuple(zip((int(line) for line in lines), cells.to_dict("records"), strict=True))
        facts = tuple(name for name in names if name not in ((FILE, NUMBER) if FILE in names else keys))
        if FILE not in names and not keys:
            example = next((name for name in names if name not in NUMBERS), "subject")
            value = ", ".join(names)
            raise InputError.stated("facts-of-recordings.no-key", source.label, value=value, example=example)
        return cls(source.label, facts, records, f"{source.label}: {cells.attrs['written']}", keys)  # type: ignore[arg-type]

    def cells_of(self, file: RecorderFile, from_name: Mapping[str, str]) -> dict[int | None, dict[str, str]]:
        """The facts of a file, by the number of the impact where the table has that column; none without one.

        Args:
            file: the recording.
            from_name: what its name says, by which a table without names of files is joined.
        """
        facts_of_number: dict[int | None, dict[str, str]] = {} if self.rows else {None: {}}
        key, who = FILE, file.name
        if self.keys:
            key, who = self.keys[0], ", ".join(f"{name} {from_name[name]}" for name in self.keys)
        for line, row in self.rows:
            if not self._is_of(row, file, from_name):
                continue
            number = None if self.keys else self._number(line, row)
            if number in facts_of_number:
                which = who + (f", number {number}" if number else "")
                raise self._wrong("twice", line, key, row[key], which=which)
            facts_of_number[number] = {name: row[name] for name in self.facts if row[name]}
        if not facts_of_number:
            name = f"{who} ({file.name})" if self.keys else who
            raise self._wrong("no-row", None, key, "none", name=name)
        return facts_of_number

    def _is_of(self, row: Mapping[str, str], file: RecorderFile, from_name: Mapping[str, str]) -> bool:
        """Whether a row is of a file: by its name, or by what that says."""
        if not self.keys:
            part = f"#{file.source.part}" if file.source.part else ""
            names = file.name, file.source.stem + part
            return row[FILE] in {*names, *(PurePosixPath(name).name for name in names)}
        return all(row[key] and _alike(row[key]) == _alike(from_name[key]) for key in self.keys)

    def unused(self, recordings: Iterable[Cells]) -> tuple[str, ...]:
        """The rows of a table that was joined of which there is no recording, in words."""
        met = {tuple(_alike(str(cells.get(key, ""))) for key in self.keys) for cells in recordings}
        alone = [
            " ".join(row[key] for key in self.keys)
            for _, row in self.rows
            if tuple(_alike(row[key]) for key in self.keys) not in met
        ]
        if not self.keys or not alone:
            return ()
        return (f"rows of {self.label} without a recording: {first_of(alone, 3)}",)

    def unmatched_rows(self, files: tuple[RecorderFile, ...]) -> Iterator[Problem]:
        """Rows that belong to no file, and to more than one."""
        for line, row in () if self.keys else self.rows:
            named = [file.name for file in files if self._is_of(row, file, {})]
            if len(named) != 1:
                value = f"{row[FILE]}: {', '.join(named) or 'no such file'}"
                yield from self._wrong("name", line, FILE, value).problems

    def _number(self, line: int, row: dict[str, str]) -> int | None:
        text = row.get(NUMBER, "")
        if NUMBER not in row:
            return None
        if not text.isdecimal() or int(text) < 1:
            raise self._wrong("number", line, NUMBER, text)
        return int(text)

    def _wrong(self, kind: str, line: int | None, column: str, value: str, **words: str) -> InputError:
        return InputError.stated(f"facts-of-recordings.{kind}", self.label, line, column, value, **words)


def _alike(name: str) -> str:
    """A name as tables and files may write it differently: capitals, and zeros before a number."""
    return name.casefold().lstrip("0") if name.isdigit() else name.casefold()


def _in_standard_case(cells: pd.DataFrame) -> list[str]:
    """The names of a table's columns, those of files, numbers and what is a number as they are written."""
    return in_case_of((FILE, NUMBER, *NUMBERS), list(map(str, cells.columns)))


def told_by(table: Source) -> list[str]:
    """What a table tells of each recording, if it names these; else nothing.

    What it leaves open is guessed from the names of the recordings, and so is by what it is joined.
    """
    cells, _ = read_cells(table)
    names = with_subject(_in_standard_case(cells))
    return [name for name in names if name not in (FILE, NUMBER)] if FILE in names else []
