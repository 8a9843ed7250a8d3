"""Recordings as spreadsheets of other countries write them, and the same as plain CSV."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from dataset_bench import deceleration

VELOCITY = 1.2
SIDES = ("links", "rechts")


@dataclass(frozen=True)
class Country:
    """How texts are written."""

    encoding: str = "utf-8"
    delimiter: str = ","
    decimal: str = "."
    above: tuple[str, ...] = ()
    units: bool = False

    def number(self, value: float, digits: int) -> str:
        return f"{value:.{digits}f}".replace(".", self.decimal)

    def table(self, names: list[str], rows: list[list[str]]) -> bytes:
        lines = [*self.above, *(self.delimiter.join(cells) for cells in [names, *rows])]
        return ("\r\n".join(lines) + "\r\n").encode(self.encoding)


GERMAN = Country(
    "cp1252", ";", ",", ("Aufnahmegerät;Prüfstand 3", "Bemerkung;gemäß Anleitung", ""), units=True
)
PLAIN = Country()


def recordings(folder: Path, country: Country, people: int = 15) -> list[dict[str, str]]:
    """A file for each impact, and the rows of a table of them; times in ms, values in m/s²."""
    folder.mkdir(parents=True)
    rows = []
    for person in range(1, people + 1):
        for side in SIDES:
            for mass in (0.5, 1.2):
                # Of each impact its own noise.
                exact = mass + 0.001 * person + 0.0005 * (side == "rechts")
                time, value = deceleration(exact, VELOCITY)
                cells = [
                    [country.number(1e3 * t, 3), country.number(a, 4)]
                    for t, a in zip(time, value, strict=True)
                ]
                units = [["ms", "m/s²"]] if country.units else []
                names = ["Zeit", "Verzögerung"] if country.units else ["Zeit (ms)", "Verzögerung (m/s²)"]
                name = f"Müller{person}_{side}_{len(rows) + 1}"
                (folder / f"{name}.csv").write_bytes(country.table(names, units + cells))
                rows.append(
                    {
                        "file": name,
                        "subject": f"Müller {person}",
                        "trial": "Fall",
                        "mass_kg": country.number(exact, 4),
                        "velocity_m_s": country.number(VELOCITY, 2),
                        "side": side,
                    }
                )
    return rows


def facts(path: Path, country: Country, rows: list[dict[str, str]]) -> None:
    bare = Country(country.encoding, country.delimiter, country.decimal)
    path.write_bytes(bare.table(list(rows[0]), [list(row.values()) for row in rows]))
