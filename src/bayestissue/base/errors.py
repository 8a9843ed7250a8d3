"""What is wrong with an input, in words that say where it is and how to mend it."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Self

from bayestissue.base.declarations import filled
from bayestissue.base.remedies import Code, flags, messages, retired

# Control characters, and those that force a direction of writing: a terminal would obey them. And halves of
# characters, which stand for bytes of a file name that are no UTF-8: no text can be written with them.
_CONTROL = re.compile(r"[\x00-\x1f\x7f-\x9f\u2028-\u202e\u2066-\u2069\ud800-\udfff]")

_WHERE = ("row", "column", "value", "impact")


@dataclass(frozen=True)
class Problem:
    """One thing that is wrong: where it stands, what was found, what was expected, what to do.

    ``row`` counts as a spreadsheet does: the header is row 1, so the first record is row 2. ``code`` names
    the entry of `bayestissue.base.remedies` that says more, ``files_read`` how many files were
    read in the same way.
    """

    file: str
    expected: str
    remedy: str
    row: int | None = None
    column: str | None = None
    value: object = None
    impact: str | None = None
    code: Code = field(kw_only=True)
    files_read: int = field(default=1, kw_only=True)

    @classmethod
    def stated(cls, key: str, file: str, *where: Any, **words: Any) -> Self:
        """The problem that the message ``key`` of ``remedies.toml`` tells.

        Args:
            key: a code, or a code, a point and which of its messages.
            file: as the attribute.
            where: ``row``, ``column``, ``value`` and ``impact`` as the attributes, or by name in ``words``.
            words: what stands in braces in the sentences.
        """
        text, words = messages()[key], dict.fromkeys(_WHERE) | dict(zip(_WHERE, where, strict=False)) | words
        row, column, value, impact = (words[name] for name in _WHERE)
        expected, remedy = (filled(sentence, **words) for sentence in (text.expected, text.remedy))
        at = None if row is None else int(row)
        return cls(file, expected, remedy, at, column, value, impact or None, code=text.code)

    @classmethod
    def of_retired(cls, kind: str, name: str, file: str, *where: Any) -> Self | None:
        """The problem of a name that is gone, with what to do instead; None of one that never was.

        Args:
            kind: as in ``retired.toml``, such as "key".
            name: what stands there.
            file: and what follows as of `stated`.
            where: row, column and value.
        """
        instead = retired()[kind].get(name)
        if instead is None:
            return None
        return cls.stated("retired.name", file, *where, kind=kind, name=name, instead=instead)

    def __str__(self) -> str:
        within = {"row": self.row, "column": self.column, "impact": self.impact}
        named = (f"{name} {printable(str(which))}" for name, which in within.items() if which is not None)
        value = "" if self.value is None else f"found {_shown(self.value)}; "
        expectation = printable(f"expected {self.expected}. {self.remedy}", lines=True)
        return f"{', '.join([printable(self.file), *named])}: {value}{expectation}"

    @property
    def with_code(self) -> str:
        """The message, its code at the end of the first line: under that of a question stands its place."""
        first, *further = str(self).split("\n")
        return "\n".join([f"{first} [{self.code}]", *further])

    def as_dict(self) -> dict[str, object]:
        """The problem as plain values, for ``--json`` and for tables."""
        plain = asdict(self)
        del plain["files_read"]
        return plain


class InputError(ValueError):
    """The input is wrong; ``problems`` lists everything that was found at once. Exit status 2."""

    def __init__(self, problems: Problem | Iterable[Problem]) -> None:
        self.problems: tuple[Problem, ...] = (problems,) if isinstance(problems, Problem) else tuple(problems)
        super().__init__("\n".join(str(problem) for problem in by_cause(self.problems)))

    @classmethod
    def stated(cls, key: str, file: str, *where: Any, **numbers: Any) -> Self:
        """The error of one problem; arguments as of `Problem.stated`."""
        return cls(Problem.stated(key, file, *where, **numbers))

    @classmethod
    def of_argument(cls, name: str, value: object, what: str) -> Self:
        """The error of an argument of another type than ``what`` it is to be."""
        return cls.stated("option-value.argument", "arguments", column=name, value=value, what=what)


def path_argument(name: str, value: object, what: str) -> Path:
    """The path that an argument of this name is, which is to be ``what``.

    Raises:
        InputError: it is no path.
    """
    if isinstance(value, str | Path):
        return Path(value)
    raise InputError.of_argument(name, value, what)


# From so many files on, the same problem in each is one cause.
_MANY = 3


def by_cause(problems: Iterable[Problem]) -> list[Problem]:
    """The problems, with one in place of those that many files share, such as "all 60 files"."""
    groups: dict[tuple[object, ...], list[Problem]] = {}
    for problem in problems:
        key = (problem.expected, problem.remedy, problem.column, problem.code)
        groups.setdefault(key, []).append(problem)
    causes = []
    for group in groups.values():
        count = len({problem.file for problem in group})
        if count < _MANY:
            causes += group
            continue
        all_read = count == max(problem.files_read for problem in group)
        files = f"all {count} files" if all_read else f"{count} files"
        causes.append(replace(group[0], file=f"{files}, such as {group[0].file}", impact=None))
    return causes


def all_of[Item, Result](function: Callable[[Item], Result], items: Iterable[Item]) -> list[Result]:
    """``function`` of each of ``items``; what is wrong with any is raised at once, as one `InputError`."""
    results: list[Result] = []
    problems: list[Problem] = []
    for item in items:
        with collected(problems):
            results.append(function(item))
    refuse(problems)
    return results


def refuse(problems: Iterable[Problem]) -> None:
    """Raise one `InputError` of all ``problems``, if there are any."""
    if listed := tuple(problems):
        raise InputError(listed)


@contextmanager
def collected(problems: list[Problem]) -> Iterator[None]:
    """A block of which an `InputError` goes to ``problems``; what is behind the block goes on."""
    try:
        yield
    except InputError as error:
        problems += error.problems


@contextmanager
def along_with(problems: Iterable[Problem]) -> Iterator[None]:
    """A block of which an `InputError` is raised together with ``problems``, these first."""
    try:
        yield
    except InputError as error:
        raise InputError([*problems, *error.problems]) from None


class PartialResultError(RuntimeError):
    """The results are written, but not all is as it was asked for; the message says what. Exit status 4."""

    def __init__(self, message: str, *, code: Code) -> None:
        super().__init__(message)
        self.code: Code = code


class Coded(str):
    """Words of a table or page that warn, with the ``code`` of their entry in `bayestissue.base.remedies`."""

    __slots__ = ("code",)
    code: Code

    def __new__(cls, words: str, code: Code) -> Self:
        """The words, with the code of their entry."""
        coded = super().__new__(cls, words)
        coded.code = code
        return coded

    @classmethod
    def stated(cls, key: str, **values: object) -> Self:
        """The words ``key`` of ``remedies.toml``, with ``values`` in their braces."""
        flag = flags()[key]
        return cls(filled(flag.says, **values), flag.code)

    def __getnewargs__(self) -> tuple[str, Code]:  # type: ignore[override]
        return str(self), self.code


def by_impact(words: Mapping[Coded, Any], count: int) -> list[list[Coded]]:
    """Of each of ``count`` impacts the words that have something true in its place."""
    return [[text for text, is_so in words.items() if is_so[row]] for row in range(count)]


def codes_of(words: Iterable[str]) -> list[Code]:
    """The codes of those words that warn."""
    return [text.code for text in words if isinstance(text, Coded)]


def more(codes: Iterable[Code]) -> str:
    """The command that prints the entries of ``codes``, each once; empty where there are none."""
    named = " ".join(dict.fromkeys(codes))
    return f"More: bayestissue explain {named}" if named else ""


def has_control_characters(text: str) -> bool:
    """Whether `printable` would change a text: it holds line ends, tabs, or what steers a terminal."""
    return _CONTROL.search(text) is not None


def printable(text: str, *, lines: bool = False) -> str:
    r"""Text that may go to a terminal whoever wrote it: control characters as ``\u001b`` and so on.

    The escapes are those of JSON, so that JSON stays what it is.

    Args:
        text: of any origin.
        lines: whether line ends and tabs stay.
    """
    allowed = "\n\t" if lines else ""
    return _CONTROL.sub(lambda match: match[0] if match[0] in allowed else f"\\u{ord(match[0]):04x}", text)


def _shown(value: object, width: int = 80) -> str:
    text = printable(value if isinstance(value, str) else f"{value}")
    text = text if len(text) <= width else f"{text[: width - 1]}…"
    return f'"{text}"' if isinstance(value, str) else text
