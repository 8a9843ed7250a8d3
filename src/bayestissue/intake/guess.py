"""A pattern guessed from file names: their parts that vary, and what these look like.

Names such as ``s01_left_2.5kg_1`` are cut at underscores, hyphens, spaces and folders. Where all names have
the same number of parts, a number before ``kg`` or ``g`` is a mass, before ``cm`` or ``mm`` a drop height,
before ``mps`` a velocity; words such as left and right are a side; a number behind ``session`` or ``day`` is
a session; counts are repeats; and the first other part that varies is the person. A guess is shown and can
be replaced. Where no person comes twice there is none.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence

from bayestissue.errors import InputError
from bayestissue.intake.columns import fills
from bayestissue.intake.folder import File
from bayestissue.intake.names import Pattern

_CUTS = re.compile(r"([_\-\s/]+)")
_NUMBERED = re.compile(r"(?P<before>[^\W\d]*)(?P<number>\d+(?:[.,]\d+)?)(?P<after>[^\W\d]*)")
_UNITS = {
    "kg": "mass_kg",
    "g": "mass_g",
    "cm": "drop_height_cm",
    "mm": "drop_height_mm",
    "mps": "velocity_m_s",
}
_SIDES = frozenset(
    [
        *("left", "right", "l", "r", "li", "re", "lt", "rt", "links", "rechts"),
        *("dominant", "nondominant", "operated", "sound", "affected", "unaffected"),
    ]
)
_SESSIONS = frozenset(["session", "ses", "day", "visit", "week", "sitzung", "tag", "termin"])
_REPEATS = frozenset(["", "r", "n", "nr", "rep", "run", "trial", "drop", "hit", "impact", "wdh", "versuch"])


def guessed(files: Sequence[File], known: Collection[str] = ()) -> str | None:
    """A pattern that all names fit and that names a person, or None.

    Args:
        files: of the folder.
        known: facts that are given otherwise; what is in names of them does not matter.
    """
    cut = [_CUTS.split(file.name[: -len(file.suffix)]) for file in files]
    separators = {tuple(parts[1::2]) for parts in cut}
    if len(separators) != 1 or len(files) < 2:
        return None
    columns = list(zip(*(parts[::2] for parts in cut), strict=True))
    pieces = _pieces(columns)
    filled = {fills(name) for name in known}
    for name in re.findall(r"\{(\w+)\}", "".join(pieces)):
        if fills(name) in filled:
            pieces = [piece.replace(f"{{{name}}}", "{}") for piece in pieces]
    between = [*separators.pop(), ""]
    if "{subject}" not in pieces:
        return None
    text = "".join(piece + gap for piece, gap in zip(pieces, between, strict=True))
    try:
        pattern = Pattern.of(text)
        people = [pattern.read(file.name, file.suffix)["subject"] for file in files]
    except InputError:
        return None
    return text if len(set(people)) < len(people) else None


def _pieces(columns: Sequence[Sequence[str]]) -> list[str]:
    """Of each part of the names the text of a pattern that stands for it."""
    found: list[str | None] = [_by_its_look(set(texts)) for texts in columns]
    taken = {name for piece in found if piece for name in re.findall(r"\{(\w+)\}", piece)}
    for place, texts in enumerate(columns):
        if found[place] is None and "subject" not in taken:
            found[place], taken = "{subject}", taken | {"subject"}
        elif found[place] is None:
            counted = all(text.isdigit() for text in texts)
            name = next(n for n in (["n"] if counted else []) + _others() if n not in taken)
            found[place], taken = f"{{{name}}}", taken | {name}
    # Counts alone, as in 01_1, 01_2: the first is the person.
    if "subject" not in taken and "{n}" in found:
        found[found.index("{n}")] = "{subject}"
    twice = [piece for piece in found if piece and "{" in piece]
    return ["{}" if p in twice and p in found[:place] else str(p) for place, p in enumerate(found)]


def _others() -> list[str]:
    return ["group", *(f"group_{number}" for number in range(2, 20))]


def _by_its_look(texts: set[str]) -> str | None:
    """What a part is, where that shows; None of one that a person may be."""
    numbered = [_NUMBERED.fullmatch(text) for text in texts]
    alike = {(each["before"], each["after"]) for each in numbered if each}
    before, after = alike.pop() if None not in numbered and len(alike) == 1 else ("", None)
    if after in _UNITS:
        return f"{before}{{{_UNITS[after]}}}{after}"
    if len(texts) == 1:
        return texts.pop().replace("{", "{{").replace("}", "}}")
    if {text.lower() for text in texts} <= _SIDES:
        return "{side}"
    if after is None:
        return None
    if not after and before.lower() in _SESSIONS:
        return f"{before}{{session}}"
    few = max(float(each["number"].replace(",", ".")) for each in numbered if each) <= 30
    padded = any(each["number"].startswith("0") for each in numbered if each)
    if not after and before.lower() in _REPEATS and few and not padded:
        return f"{before}{{n}}"
    return None
