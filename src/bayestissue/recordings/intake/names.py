"""File names read by a pattern or by a guessed one, and the columns of `impacts.csv` that facts fill."""

from __future__ import annotations

import math
import re
import string
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import PurePosixPath

import pyarrow as pa
import pyarrow.compute as pc

from bayestissue.base.declarations import declared
from bayestissue.base.errors import InputError, Problem, refuse
from bayestissue.recordings.dataset.cells import HEIGHTS, is_height, number_in
from bayestissue.recordings.dataset.dataset_file import STANDARD_GRAVITY
from bayestissue.recordings.dataset.dialect import OPEN, open_mark
from bayestissue.recordings.dataset.source_files import Source
from bayestissue.recordings.intake.folder import RecorderFile

# Of each name the column that it fills with (factor x number)^power. After a fall, of a pendulum too, the
# velocity is v = (2 g h)^(1/2); the height stays as a covariate as well.
_FILLS: dict[str, tuple[str, float, float]] = {
    "mass_g": ("mass_kg", 1e-3, 1),
    "velocity_cm_s": ("velocity_m_s", 1e-2, 1),
    "velocity_mm_s": ("velocity_m_s", 1e-3, 1),
    "diameter_mm": ("diameter_m", 1e-3, 1),
    **{name: ("velocity_m_s", 2 * metres * STANDARD_GRAVITY, 0.5) for name, metres in HEIGHTS.items()},
}
NUMBERS = {"mass_kg", "velocity_m_s", "sampling_rate_hz", "energy_J", "diameter_m", *_FILLS}


def fills(name: str) -> str:
    """The column of ``impacts.csv`` that a field fills: ``velocity_m_s`` for a height of fall."""
    return _FILLS[name][0] if name in _FILLS else name


def columns(fields: dict[str, str], file: str) -> dict[str, str | float]:
    """The cells of ``impacts.csv`` that the fields of a file fill.

    Args:
        fields: text by name; decimals may have a comma.
        file: what to call the file in a message.

    Raises:
        InputError: a number is none, or a height or mass is not above 0.
    """
    cells: dict[str, str | float] = {}
    problems = []
    for name, text in fields.items():
        if name not in NUMBERS:
            cells[name] = text.strip()
            continue
        if "," in text and OPEN.fullmatch(text.strip()):
            problems.append(open_mark(file, None, name, text))
            continue
        value = number_in(text.strip().replace(",", "."))
        if not 0 < value < math.inf:
            problems.append(Problem.stated("impossible-value.fact", file, column=name, value=text, name=name))
            continue
        column, factor, power = _FILLS.get(name, (name, 1.0, 1.0))
        # Twelve digits are more than anybody measured, and fewer than show how 0.07 is kept.
        # Beside its height a velocity is as it is stated: `check` holds the one against the other.
        if column == name or column not in fields:
            cells[column] = float(f"{(factor * value) ** power:.12g}")
        if is_height(name):
            cells[name] = value
    refuse(problems)
    return cells


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
        within: of a name the field in each of whose levels it counts anew, as ``{subject:group}``.
    """

    text: str
    fields: tuple[str, ...]
    within: Mapping[str, str]
    _parts: tuple[tuple[str, str | None], ...]

    @classmethod
    def parse(cls, text: str) -> Pattern:
        """Read a pattern.

        Raises:
            InputError: braces that do not match, a format, or a name that is none or stands there twice.
        """
        try:
            parsed = list(string.Formatter().parse(text))
        except ValueError as error:
            raise _unfit(text, str(error)) from None
        names = [name for _, name, _, _ in parsed if name]
        within = {name: spec for _, name, spec, _ in parsed if name and spec}
        if any(conversion for *_, conversion in parsed) or not {*within.values()} <= {*names} - {*within}:
            raise _unfit(text, "a format after a name")
        if odd := [name for name in names if not name.isidentifier()]:
            raise _unfit(text, f"{{{odd[0]}}}")
        if len(set(names)) < len(names):
            raise _unfit(text, f"{{{max(names, key=names.count)}}} twice")
        if not names:
            raise _unfit(text, "no name in braces")
        return cls(text, tuple(names), within, tuple((literal, name) for literal, name, _, _ in parsed))

    def read(self, file: Source) -> dict[str, str]:
        """The fields of a file.

        Args:
            file: called by its path relative to the folder, with ``/`` between the parts; as many of the last
                parts are read as the pattern has. A pattern that does not end as the file does is read as one
                of the name before it. A sheet is read behind ``.xlsx#``, or ``#`` alone; the number of a
                block likewise, and it need not be read.

        Raises:
            InputError: the name does not fit, or fits in two ways.
        """
        name = self._text_of(file)
        # Where the shortest first field is the longest too, and so on for the next, there is one reading.
        shortest, longest = (self._reading(name, lazy) for lazy in ("?", ""))
        if shortest is None or longest is None:
            raise InputError.stated("file-names.unlike", file.label, value=name, pattern=self.text)
        if shortest != longest:
            fields = (reading.items() for reading in (shortest, longest))
            readings = (", ".join(f"{name} {text}" for name, text in reading) for reading in fields)
            raise InputError.stated(
                "file-names.two-ways", file.label, value=" or ".join(readings), pattern=self.text
            )
        return shortest

    def whole(self, fields: Mapping[str, str]) -> dict[str, str]:
        """The fields of a file; one that counts anew in each level of another has that before it."""
        levels = {name: f"{fields[outer]}-{fields[name]}" for name, outer in self.within.items()}
        return {**fields, **levels}

    def fits(self, file: Source) -> bool:
        """Whether the name of a file has the fields, in one way or in several."""
        return self._reading(self._text_of(file), "") is not None

    def _text_of(self, file: Source) -> str:
        """What of a file's path is read."""
        name, text = "/".join(PurePosixPath(file.name).parts[-1 - self.text.count("/") :]), self.text.lower()
        part = f"#{file.part}" if file.part and (file.is_sheet or "#" in text) else ""
        has_ending = f"{file.suffix}#" in text if part else text.endswith(file.suffix)
        return (name if has_ending else name.removesuffix(file.name[len(file.stem) :])) + part

    def _reading(self, name: str, lazy: str) -> dict[str, str] | None:
        """The fields of a name; None where it does not fit.

        RE2 takes time in proportion to the name; an expression of many fields that backtracks has no end.
        """
        text = name.encode(errors="replace").decode()
        (groups,) = pc.extract_regex(pa.array([text]), self._expression(lazy)).to_pylist()
        return None if groups is None else dict(zip(self.fields, groups.values(), strict=True))

    def _expression(self, lazy: str) -> str:
        pieces = []
        for literal, name in self._parts:
            pieces.append(re.escape(literal))
            if name is not None:
                what = (_NUMBER if name in NUMBERS else _TEXT).replace("{lazy}", lazy)
                # Names of columns have letters that those of groups may not have.
                group = f"?P<f{self.fields.index(name)}>" if name else "?:"
                pieces.append(f"({group}{what})")
        return f"^{''.join(pieces)}$"


def _unfit(text: str, slip: str) -> InputError:
    return InputError.stated("file-names.pattern", OPTION, value=f"{text}: {slip}", example=_EXAMPLE)


_CUTS = re.compile(r"([_\-\s/]+)")
_NUMBERED = re.compile(r"(?P<before>[^\W\d]*)(?P<number>\d+(?:[.,]\d+)?)(?P<after>[^\W\d]*)")
_WORDS = declared(__package__, "words.toml")
_UNITS: dict[str, str] = _WORDS["units"]
_PAIRS = [(set(one), set(opposite)) for one, opposite in _WORDS["pairs"]]
_SIDES = frozenset(word for pair in _PAIRS for side in pair for word in side)
_SESSIONS, _TIMES, _REPEATS, _GROUPS = (
    frozenset(_WORDS[name]) for name in ("sessions", "times", "repeats", "groups")
)
# A person's name among parts that are all alike.
_PERSON = re.compile(
    r"(?!(rec|run|rep|nr|n|r|day|ses|exp|hit)\d)([^\W\d]{1,3}|subj(ect)?|person|patient)\d{1,3}"
)
# Facts that tell recordings apart and say nothing of them.
_COUNTED = re.compile(r"n|group(_\d+)?")


def _cut(file: Source) -> list[str]:
    """The parts of a file's name without its ending, and of that of its part, with what separates them."""
    parts = _CUTS.split(file.stem)
    return [*parts, f"{file.name[len(file.stem) :]}#", *_CUTS.split(file.part)] if file.part else parts


def guessed(files: Sequence[RecorderFile], known: Collection[str] = ()) -> str | None:
    """A pattern that all names fit and that says something of the recordings, or None.

    Names such as ``s01_left_2.5kg_1`` are cut at underscores, hyphens, spaces and folders. Where all names
    have the same number of parts, a number before ``kg`` or ``g`` is a mass, before ``cm`` or ``mm`` a drop
    height, before ``mps`` a velocity, also where all have the same; words such as left and right are a side,
    before and after a session; a number behind ``session`` or ``day`` is a session; counts are repeats; and
    the first other part that varies is the person, if one comes twice. Where none varies, one such as ``p1``
    is. A guess is shown and can be replaced.

    Args:
        files: of the folder.
        known: facts that are given otherwise; what is in names of them does not matter.
    """
    cut = [_cut(file.source) for file in files]
    separators = {tuple(parts[1::2]) for parts in cut}
    if len(separators) != 1:
        return None
    columns = list(zip(*(parts[::2] for parts in cut), strict=True))
    pieces = _pieces(columns)
    people = columns[pieces.index("{subject}")] if "{subject}" in pieces else ()
    filled = {fills(name) for name in known}
    # A person each, or a count: it can't be told.
    filled |= {"subject"} if 1 < len(set(people)) == len(people) else set()
    fields = re.findall(r"\{(\w+)\}", "".join(pieces))
    for name in fields:
        if fills(name) in filled:
            pieces = [piece.replace(f"{{{name}}}", "{}") for piece in pieces]
    if not [name for name in fields if fills(name) not in filled and not _COUNTED.fullmatch(name)]:
        return None
    text = "".join(piece + gap for piece, gap in zip(pieces, [*separators.pop(), ""], strict=True))
    try:
        pattern = Pattern.parse(text)
        for file in files:
            pattern.read(file.source)
    except InputError:
        return None
    return text


def contradictions(file: RecorderFile, facts: Mapping[str, str]) -> Iterator[Problem]:
    """What a file's name says otherwise than facts that are given of it: numbers with a unit, and sides.

    Args:
        file: whose name is read.
        facts: by name, as text.
    """
    stated = {_kind(name): (name, text) for name, text in facts.items() if name == "side" or name in NUMBERS}
    for part in _cut(file.source)[::2]:
        match = _NUMBERED.fullmatch(part)
        unit = match["after"] if match else ""
        said = "side" if part.lower() in _SIDES else _UNITS.get(unit, "")
        if not said or _kind(said) not in stated:
            continue
        name, text = stated[_kind(said)]
        if said == "side":
            pairs = [pair for pair in _PAIRS if {part.lower(), text.lower()} <= pair[0] | pair[1]]
            agree = not pairs or any({part.lower(), text.lower()} <= side for side in pairs[0])
        else:
            try:
                number = match["number"] if match else ""
                from_name, from_facts = columns({said: number}, ""), columns({name: text}, "")
            except InputError:
                continue
            agree = math.isclose(float(from_name[fills(said)]), float(from_facts[fills(name)]), rel_tol=1e-9)
        if not agree:
            key, value = "facts-of-recordings.name-says", f"{name} = {text}"
            yield Problem.stated(key, file.name, column=name, value=value, part=part)


def _kind(name: str) -> str:
    """What a fact is of: a height of fall is compared with another, and not with a velocity."""
    return "drop_height" if is_height(name) else fills(name)


def _pieces(columns: Sequence[Sequence[str]]) -> list[str]:
    """The text of a pattern for each part of the names."""
    pieces: list[str | None] = [_recognised(set(texts)) for texts in columns]
    taken = {name for piece in pieces if piece for name in re.findall(r"\{(\w+)\}", piece)}
    for position, texts in enumerate(columns):
        if pieces[position] is None and "subject" not in taken:
            pieces[position], taken = "{subject}", taken | {"subject"}
        elif pieces[position] is None:
            counted = all(text.isdigit() for text in texts)
            names = [*(["n"] if counted else []), "group", *(f"group_{number}" for number in range(2, 20))]
            name = next(name for name in names if name not in taken)
            pieces[position], taken = f"{{{name}}}", taken | {name}
    # All of one person: p1_1, p1_2.
    constant = [len(set(texts)) == 1 and _PERSON.fullmatch(texts[0]) is not None for texts in columns]
    if "subject" not in taken and taken and True in constant:
        pieces[constant.index(True)], taken = "{subject}", taken | {"subject"}
    # Two counts behind a word, as in athletes/1_2: the word is a group, and the first count the person.
    if "group" not in taken and pieces.count("{n}") > 1 and "{subject}" in pieces:
        at = pieces.index("{subject}")
        if all(text.isalpha() for text in columns[at]):
            pieces[at], pieces[pieces.index("{n}")] = "{group}", "{subject}"
    # Counts alone, as in 01_1, 01_2: the first is the person.
    if "subject" not in taken and "{n}" in pieces:
        pieces[pieces.index("{n}")] = "{subject}"
    twice = [piece for piece in pieces if piece and "{" in piece]
    return ["{}" if p in twice and p in pieces[:position] else str(p) for position, p in enumerate(pieces)]


def _recognised(texts: set[str]) -> str | None:
    """What a part is, where that shows; None of one that a person may be."""
    numbered = [_NUMBERED.fullmatch(text) for text in texts]
    frames = {(match["before"], match["after"]) for match in numbered if match}
    before, after = frames.pop() if None not in numbered and len(frames) == 1 else ("", None)
    if after in _UNITS:
        return f"{before}{{{_UNITS[after]}}}{after}"
    if len(texts) == 1:
        return texts.pop().replace("{", "{{").replace("}", "}}")
    for name, words in (("side", _SIDES), ("session", _TIMES), ("group", _GROUPS)):
        if {text.lower() for text in texts} <= words:
            return f"{{{name}}}"
    if after is None:
        return None
    if not after and before.lower() in _SESSIONS:
        return f"{before}{{session}}"
    few = max(float(match["number"].replace(",", ".")) for match in numbered if match) <= 30
    padded = any(match["number"].startswith("0") for match in numbered if match)
    if not after and before.lower() in _REPEATS and few and not padded:
        return f"{before}{{n}}"
    return None
