"""What others measured by hitting tissue: a section for each site."""

from __future__ import annotations

from collections.abc import Iterable

from bayestissue.base.literature import SITES, Measurement, measurements
from from_program.markdown import escaped, table

# By column of `Measurement.published`: name, unit, how many of it per SI unit.
_NAMES = {
    "K_N_per_m": ("K", "kN/m", 1e-3),
    "C_N_s_per_m": ("C", "N s/m", 1.0),
    "peak_force_N": ("peak force", "N", 1.0),
    "peak_deceleration_g": ("peak deceleration", "g", 1.0),
    "peak_displacement_m": ("depth", "mm", 1e3),
    "energy_share": ("energy lost", "%", 100.0),
}


def published_values() -> str:
    """A section for each site, with a row for each measurement."""
    return "\n\n".join(f"## {site.capitalize()}\n\n{_section(site, words)}" for site, words in SITES.items())


def _section(site: str, words: str) -> str:
    rows = [_row(each) for each in measurements() if each.site == site]
    header = ["what was hit by what", "mass, velocity", "found", "method", "source"]
    return f'`site = "{site}"`: {words}.\n\n{table(header, rows)}'


def _row(of: Measurement) -> tuple[str, ...]:
    motion = [_words(of.mass, "kg"), _words(of.velocity, "m/s")] if of.mass or of.velocity else []
    found = [
        f"{name} {_words(of.published[column], unit, factor)}"
        for column, (name, unit, factor) in _NAMES.items()
        if column in of.published
    ]
    method = f"{of.method}; derived: {of.derived}" if of.derived else of.method
    source = f"[{escaped(of.source.short)}]({of.source.address}): {escaped(of.source.title)}. {_place(of)}"
    return (
        escaped(f"{of.hit}, by {of.by}"),
        ", ".join(filter(None, motion)) or "not stated",
        "<br>".join(map(escaped, found)),
        escaped(method),
        source,
    )


def _place(of: Measurement) -> str:
    return escaped(f"Looked up in: {of.where}. Licence: {of.source.licence}.")


def _words(values: Iterable[float] | None, unit: str, factor: float = 1.0) -> str:
    """A value or a range with its unit; empty where none was stated."""
    if values is None:
        return ""
    numbers = dict.fromkeys(f"{factor * value:.4g}" for value in values)
    return f"{' to '.join(numbers)}\N{NO-BREAK SPACE}{unit}"
