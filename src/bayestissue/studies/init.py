"""A dataset from a folder of recorder files, in three steps: look, settle what is not known, write."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from bayestissue.base.declarations import taking
from bayestissue.base.errors import InputError, Problem, path_argument
from bayestissue.base.outline import counted, first_of, span
from bayestissue.base.results.output_folder import claim
from bayestissue.base.settings import checked
from bayestissue.recordings.dataset import Dataset, read_dataset
from bayestissue.recordings.dataset.cells import REMEDY
from bayestissue.recordings.dataset.dialect import Stated
from bayestissue.recordings.dataset.recorders import SUFFIXES
from bayestissue.recordings.dataset.sample_tables import TABLE_SUFFIXES, TEXT_SUFFIXES
from bayestissue.recordings.dataset.source_files import Source
from bayestissue.recordings.intake.build import Built, build
from bayestissue.recordings.intake.choices import (
    BESIDE_FORCE,
    PLACES,
    Choices,
    MissingFact,
    choices_of,
    forces_among,
    options,
    people_twice,
    settle,
)
from bayestissue.recordings.intake.facts import Facts, gather, told_by
from bayestissue.recordings.intake.folder import ChannelSummary, RecorderFolder, look
from bayestissue.recordings.intake.names import Pattern, guessed

PAGE = "init.html"
# Facts that tell recordings of one combination apart, how many values of a fact a line shows, and digits of a
# count: all of them.
COUNTS, _SHOWN, _WHOLE = ("n", "impact"), 8, 12


@dataclass(frozen=True, eq=False)
class Intake:
    """A folder of recorder files, as far as it is understood.

    Attributes:
        recordings: the files and their channels.
        choices: what was said, and what the files leave no doubt about.
        facts: what is known of each file besides its samples.
        questions: what is left to say.
    """

    recordings: RecorderFolder
    choices: Choices
    facts: Facts
    questions: tuple[MissingFact, ...]
    guess: str | None = None

    def answered(self, question: MissingFact, text: str) -> Intake:
        """The intake with one question answered.

        Raises:
            InputError: the answer contradicts what names or a table say.
        """
        choices = question.answer(self.choices, text)
        if "{" in text and question.option == "--set subject=":
            choices = self.choices.stating(pattern=text)
        return _intake_from(self.recordings, choices, self.guess)

    def design(self) -> list[str]:
        """How names are read, and of each fact its values with the number of recordings, in lines."""
        rows = list(self.facts.of_file.values())
        if not self.choices.pattern or not rows:
            return []
        how = ", a guess; --pattern takes another" if self.guess else ""
        lines = [f"Names read as {self.choices.pattern}{how}:"]
        repeats = Counter(tuple(v for k, v in row.items() if k not in COUNTS) for row in rows)
        for name in sorted(rows[0], key=lambda name: name != "subject"):
            count = Counter(f"{row[name]:.4g}" if isinstance(row[name], float) else row[name] for row in rows)
            values = first_of([f"{value} ({number})" for value, number in count.items()], _SHOWN)
            lines.append(f"  {name}: {len(count)}, {values}")
        return [*lines, f"  recordings of each combination: {span(list(repeats.values()), '', _WHOLE)}"]

    def listed(self) -> list[str]:
        """What was found, in lines: how many files, and of each channel its name, unit and samples."""
        files = self.recordings.files
        total = counted(len(files), "recorder file")
        return [
            f"{total} in {self.recordings.folder}, such as {files[0].name}. Channels:",
            *(
                f"  {name}{_units(channels)}: {span([one.samples for one in channels], 'samples', _WHOLE)}"
                + (f", in {len(channels)} files" if len(channels) < len(files) else "")
                for name, channels in self.recordings.candidates().items()
            ),
            *(f"Texts read as: {words}" for words in self.written()),
            *(f"Passed over: {words}" for words in self.passed_over()),
            *self.design(),
        ]

    def passed_over(self) -> tuple[str, ...]:
        """What of the files and of the table was not read and is no problem, in words."""
        forces = forces_among(self.recordings)
        several = len(forces) > 1 and self.choices.stated("quantity") in BESIDE_FORCE
        said = self.choices.force or self.choices.beside or not several
        words = f"forces: {first_of(forces, _SHOWN)} (--force value_column=NAME takes one)"
        return self.recordings.passed_over + self.facts.passed_over + (() if said else (words,))

    def written(self) -> list[str]:
        """How texts are written: each way of the recordings with the number of files, then the table."""
        count = Counter(file.written for file in self.recordings.files if file.written)
        ways = [words if len(count) == 1 else f"{words} ({number} files)" for words, number in count.items()]
        return [*ways, *([self.facts.written] if self.facts.written else [])]

    def unanswered(self) -> InputError:
        """What is wrong while questions are left: each with an option that answers it, and all else."""
        problems = [
            Problem.stated("not-told", one.option.rstrip("="), value="none", what=one.wording, line=one.line)
            for one in self.questions
        ]
        error = InputError([*problems, *self.recordings.problems, *self.facts.problems])
        error.add_note("\n".join(self.listed()))
        line = " ".join(question.line for question in self.questions)
        error.add_note(f"Options to add, with your own values: {line}")
        return error


def prepare(folder: str | Path, choices: Choices) -> Intake:
    """Look at a folder and settle what its files leave no doubt about; a pattern is `guessed` if need be.

    Raises:
        InputError: there are no recorder files, or the pattern or the table can't be used.
    """
    pattern = (choices.pattern or "").lower()
    ends = [end for end in (*SUFFIXES, *TEXT_SUFFIXES) if pattern.endswith(end) or f"{end}#" in pattern]
    sheets = None if choices.pattern is None else "#" in pattern
    table, stated = _table(choices), checked(choices.text, Stated, file="--text")
    ignore = [table.path] if table else []
    suffix = max(ends, key=len, default="")
    recordings = look(folder, suffix=suffix, ignore=ignore, stated=stated, sheets=sheets)
    guess = None
    columns = told_by(table) if table else []
    if choices.pattern is None and "subject" not in columns:
        guess = guessed(recordings.files, [*choices.given, *columns])
    return _intake_from(recordings, choices.stating(pattern=guess), guess)


def _table(choices: Choices) -> Source | None:
    """The table of facts."""
    stated = checked(choices.text, Stated, file="--text")
    return Source.at(choices.table, remedy=REMEDY, stated=stated) if choices.table else None


def _without_companions(recordings: RecorderFolder, choices: Choices) -> RecorderFolder:
    """The recordings without files beside them that the pattern does not name and that hold no such channels.

    An app exports what it knows of the phone and the times of its buttons beside each recording. A file with
    the channels of a recording and another name stays: its name may be misspelt.
    """
    pattern = Pattern.parse(choices.pattern) if choices.pattern else None
    named = [file for file in recordings.files if pattern and pattern.fits(file.source)]
    if pattern is None or not named:
        return recordings
    common = set.intersection(*(set(file.channels) for file in named))
    files = tuple(file for file in recordings.files if file in named or common <= set(file.channels))
    problems = tuple(p for p in recordings.problems if not _is_note(p.file, pattern))
    over = {file.name for file in recordings.files} - {file.name for file in files}
    over |= {p.file for p in recordings.problems} - {p.file for p in problems}
    words = (f"files that --pattern does not name: {first_of(sorted(over), _SHOWN)}",) if over else ()
    return replace(recordings, files=files, problems=problems, passed_over=recordings.passed_over + words)


def _is_note(file: str, pattern: Pattern) -> bool:
    """Whether a file that could not be read is a text that the pattern does not name."""
    source = Source.at(Path(file), file)
    return source.suffix in (*TABLE_SUFFIXES, *TEXT_SUFFIXES) and not pattern.fits(source)


def _intake_from(recordings: RecorderFolder, choices: Choices, guess: str | None) -> Intake:
    recordings = _without_companions(recordings, choices)
    facts = gather(recordings, choices, _table(choices), loose=choices.pattern == guess)
    choices, questions = settle(choices, recordings, facts.columns)
    questions += people_twice(choices.pattern, facts)
    return Intake(recordings, choices, facts, tuple(questions), guess if choices.pattern == guess else None)


def write(intake: Intake, out: str | Path, *, overwrite: bool = False) -> Built:
    """Write the dataset, and beside its tables the page ``init.html`` that shows what was understood.

    Args:
        intake: with no question left.
        out: the folder of the dataset, new or empty.
        overwrite: replace a dataset that this function wrote and nobody changed.

    Raises:
        InputError: everything that is wrong; nothing is written then.
        PartialResultError: the results could not take their place, and are beside it.
    """
    if intake.questions:
        raise intake.unanswered()
    recordings, facts, choices = intake.recordings, intake.facts, intake.choices
    with claim(
        Path(out), overwrite=overwrite, command="init", inputs=(recordings.folder, choices.table)
    ) as target:
        from bayestissue.reports.pages.recordings_pages import init_page

        with target.folder() as staging:
            choices = choices.stating(name=choices.stated("name") or target.path.resolve().name)
            built = build(staging, recordings, facts, choices)
            page = init_page(
                built.dataset,
                built.signal,
                understood=_understood(intake),
                left_out=built.left_out,
                notes=built.notes,
            )
            (staging / PAGE).write_text(page, encoding="utf-8")
        return replace(built, dataset=replace(built.dataset, folder=target.path))


def default_out(folder: str | Path) -> Path:
    """The folder of a dataset that nobody named: that of the recordings, with ``-dataset`` behind, here."""
    recordings = path_argument("folder", folder, "the folder of the recordings")
    return Path(f"{recordings.resolve().name}-dataset")


@taking(options())
def init_dataset(
    folder: str | Path, out: str | Path | None = None, *, overwrite: bool = False, **stated: Any
) -> Dataset:
    """Make a dataset from a folder of recorder files, and read it: `bayestissue init` from Python.

    The recordings are copied as they are into ``out/recordings``, and the page ``out/init.html`` shows what
    was understood of each.

    Args:
        folder: where the recorder's files lie; folders within it are looked into.
        out: the folder of the dataset, new or empty; that of the recordings with -dataset behind unless
            given.
        overwrite: replace a dataset that this function wrote and nobody changed.
        **stated: what the files do not say, by keys of ``dataset.toml``, its tables as dictionaries, and
            more.

    Raises:
        InputError: everything that is wrong, or that is not known; nothing is written then.
    """
    out = default_out(folder) if out is None else out
    write(prepare(folder, choices_of(**stated)), out, overwrite=overwrite)
    return read_dataset(out)


def _understood(intake: Intake) -> list[tuple[str, str]]:
    """What was understood, as pairs of a heading and words."""
    from bayestissue.reports.pages.page import written

    stated = {option: intake.choices.stated(option) for option in PLACES}
    lines = [line.partition(":") for line in written("init", "understood", intake, stated)]
    return [(heading, words.strip()) for heading, _, words in lines]


def _units(channels: list[ChannelSummary]) -> str:
    units = sorted({channel.unit for channel in channels if channel.unit})
    return f" [{', '.join(units)}]" if units else ""
