"""Which files of a folder that a recorder writes to are whole, by their sizes and times alone.

Polling works on network drives, which tell nobody of a change. No clock is compared with another.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from bayestissue.recordings.dataset.recorders import SUFFIXES
from bayestissue.recordings.dataset.source_files import suffix_of
from bayestissue.recordings.intake.folder import files_within, natural


class Stamp(NamedTuple):
    """The size of a file in bytes, when it was last changed, ns, and its number on the disk.

    Two files of one size and time that swap their names differ in the last alone.
    """

    size: int
    modified_ns: int
    number: int = 0


class Changes(NamedTuple):
    """What a look at the folder showed.

    Attributes:
        ready: files that stand still and are new, or other than they were when they were settled; the
            oldest first.
        empty: files that stand still without a byte in them; of each once.
        gone: settled files that are not there any more; of each once.
    """

    ready: tuple[str, ...]
    empty: tuple[str, ...]
    gone: tuple[str, ...]


@dataclass
class Follower:
    """What is known of the files of a folder.

    Attributes:
        settled: the stamp that each file had when it was taken or refused.
    """

    settled: dict[str, Stamp] = field(default_factory=dict)
    _last: dict[str, Stamp] = field(default_factory=dict)
    _said: set[tuple[str, str]] = field(default_factory=set)

    def changes(self, listing: Mapping[str, Stamp]) -> Changes:
        """What follows from a look at the folder; a file is whole where two looks show the same stamp."""
        still = {name: stamp for name, stamp in listing.items() if self._last.get(name) == stamp}
        self._last = dict(listing)
        ready = [n for n, stamp in still.items() if stamp.size and self.settled.get(n) != stamp]
        empty = [n for n, stamp in still.items() if not stamp.size]
        gone = [n for n in self.settled if n not in listing]
        # What was said of a file holds until it is another again.
        self._said &= {*(("empty", n) for n in empty), *(("gone", n) for n in gone)}
        return Changes(
            tuple(sorted(ready, key=lambda n: (listing[n].modified_ns, natural(n)))),
            self._once("empty", empty),
            self._once("gone", gone),
        )

    def _once(self, what: str, names: list[str]) -> tuple[str, ...]:
        new = [name for name in names if (what, name) not in self._said]
        self._said |= {(what, name) for name in new}
        return tuple(new)


def listing(folder: Path, suffixes: tuple[str, ...] = SUFFIXES) -> dict[str, Stamp]:
    """The recorder files in a folder and below it: of each its stamp, by its path relative to the folder.

    Raises:
        OSError: the folder can't be read, as where a network drive is away.
    """
    stamps = {}
    for path in files_within(folder):
        if suffix_of(path) in suffixes:
            try:
                status = path.stat()
            except FileNotFoundError:
                continue
            stamps[path.relative_to(folder).as_posix()] = Stamp(
                status.st_size, status.st_mtime_ns, status.st_ino
            )
    return stamps
