"""What file names say: a pattern such as ``{subject}_{side}_{mass_kg}kg_{n}.lvm``, and what it finds.

The grammar is that of Python's format strings without their formats: text stands for itself, ``{name}`` for
what varies, ``{}`` for what does not matter. It needs no library, and a name that could be read in two ways
is refused, where the shortest reading would quietly be a wrong one.
"""

from __future__ import annotations

import re
import string
from dataclasses import dataclass
from pathlib import PurePosixPath

from bayestissue.errors import InputError, Problem
from bayestissue.intake.columns import is_number

OPTION = "--pattern"
_EXAMPLE = '"{subject}_{side}_{mass_kg}kg_{n}.lvm"'
# As a quantifier ends: the longest text that fits, and with a question mark the shortest.
_NUMBER, _TEXT = r"[+-]?\d+{lazy}(?:[.,]\d+{lazy})?{lazy}", r"[^/]+{lazy}"


@dataclass(frozen=True)
class Pattern:
    """A pattern, and how many folders above the file it names.

    Attributes:
        text: as it was given.
        fields: the names in it, in order.
    """

    text: str
    fields: tuple[str, ...]
    _parts: tuple[tuple[str, str | None], ...]

    @classmethod
    def of(cls, text: str) -> Pattern:
        """Read a pattern.

        Raises:
            InputError: braces that do not match, a format, or a name that is none or stands there twice.
        """
        try:
            parsed = list(string.Formatter().parse(text))
        except ValueError as error:
            raise _unfit(text, str(error)) from None
        names = [name for _, name, _, _ in parsed if name]
        if any(spec or conversion for _, _, spec, conversion in parsed):
            raise _unfit(text, "a format after a name")
        if odd := [name for name in names if not name.isidentifier()]:
            raise _unfit(text, f"{{{odd[0]}}}")
        if len(set(names)) < len(names):
            raise _unfit(text, f"{{{max(names, key=names.count)}}} twice")
        if not names:
            raise _unfit(text, "no name in braces")
        return cls(text, tuple(names), tuple((literal, name) for literal, name, _, _ in parsed))

    def read(self, file: str, suffix: str) -> dict[str, str]:
        """The fields of a file.

        Args:
            file: its path relative to the folder, with ``/`` between the parts; as many of the last parts are
                read as the pattern has.
            suffix: how its name ends; a pattern that does not end so is read as one of the name before it.

        Raises:
            InputError: the name does not fit, or fits in two ways.
        """
        parts = PurePosixPath(file).parts[-1 - self.text.count("/") :]
        name = "/".join(parts)
        if not self.text.lower().endswith(suffix):
            name = name[: -len(suffix)]
        # Where the shortest first field is the longest too, and so on for the next, there is one reading.
        shortest, longest = (re.fullmatch(self._expression(lazy), name) for lazy in ("?", ""))
        if shortest is None or longest is None:
            raise InputError(
                Problem(
                    file,
                    f'a name like "{self.text}"',
                    f"Rename a copy of the file, correct {OPTION}, or move the file out of the folder.",
                    value=name,
                    code="file-names",
                )
            )
        if shortest.groupdict() != longest.groupdict():
            readings = (_words(found.groupdict()) for found in (shortest, longest))
            raise InputError(
                Problem(
                    file,
                    f'one way to read "{self.text}"',
                    "Put other text between the fields, or give the facts as a table with --table.",
                    value=" or ".join(readings),
                    code="file-names",
                )
            )
        return shortest.groupdict()

    def _expression(self, lazy: str) -> str:
        pieces = []
        for literal, name in self._parts:
            pieces.append(re.escape(literal))
            if name is not None:
                what = (_NUMBER if is_number(name) else _TEXT).replace("{lazy}", lazy)
                pieces.append(f"(?P<{name}>{what})" if name else f"(?:{what})")
        return "".join(pieces)


def _words(fields: dict[str, str]) -> str:
    return ", ".join(f"{name} {text}" for name, text in fields.items())


def _unfit(text: str, found: str) -> InputError:
    return InputError(
        Problem(
            OPTION,
            f"the names in file names, each once in braces, such as {_EXAMPLE}",
            "Write {} for what does not matter, and {{ for a brace.",
            value=f"{text}: {found}",
            code="file-names",
        )
    )
