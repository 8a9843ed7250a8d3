"""What `dataset.toml` may say, and what to answer when it says something else."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from bayestissue.dataset.model import Quantity, Uncertainty
from bayestissue.dataset.units import EXAMPLES, Dimension, to_si
from bayestissue.errors import InputError, Problem

FILE = "dataset.toml"


def _not_zero(value: float) -> float:
    if value == 0:
        raise ValueError("zero")
    return value


Name = Annotated[str, Field(min_length=1)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Spread = Annotated[float, Field(ge=0, allow_inf_nan=False)]


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


class SignalSettings(_Table):
    """The table ``[signal]``: what was recorded and in which units."""

    quantity: Quantity = Field(description='"deceleration", "acceleration" or "displacement"')
    unit: Name = Field(description="the unit of the recorded values, as text")
    time_unit: Name = Field(default="s", description=EXAMPLES["time"])
    time_column: Name = Field(default="time_s", description="the name of the time column or channel")
    value_column: Name = Field(default="value", description="the name of the value column or channel")
    scale: Annotated[Finite, AfterValidator(_not_zero)] = Field(
        default=1.0, description="a number other than 0, by which raw values are multiplied"
    )
    offset: Finite = Field(default=0.0, description="a number, added to the raw values after the scale")

    @property
    def dimension(self) -> Dimension:
        """What ``unit`` has to measure."""
        return _dimension(self.quantity)


class UncertaintySettings(_Table):
    """The table ``[uncertainty]``: standard deviations of the measuring chain, in SI units."""

    relative_mass_sd: Spread = Field(default=0.0, description="a fraction of the mass, 0 or more")
    velocity_sd_m_s: Spread = Field(default=0.0, description="a number of m/s, 0 or more")
    relative_gain_sd: Spread = Field(default=0.0, description="a fraction of the gain, 0 or more")
    offset_sd: Spread = Field(default=0.0, description="a number of SI units of the quantity, 0 or more")

    def values(self) -> Uncertainty:
        """The same as the plain object a `Dataset` carries."""
        return Uncertainty(**self.model_dump())


class Settings(_Table):
    """The whole of ``dataset.toml``."""

    name: Name = Field(description="a name, as text")
    description: str = Field(default="", description="free text")
    licence: str = Field(default="", description="free text")
    source: str = Field(default="", description="free text")
    signal: SignalSettings = Field(description="a table [signal] with quantity and unit")
    uncertainty: UncertaintySettings = Field(
        default_factory=lambda: UncertaintySettings(),
        description="a table [uncertainty] of standard deviations",
    )


def read_settings(path: Path) -> Settings:
    """Read and check ``dataset.toml``.

    Raises:
        InputError: the file is missing, is no TOML, or has unknown, missing or wrong entries; all at once.
    """
    try:
        text = path.read_bytes().decode("utf-8-sig")
        raw = tomllib.loads(text)
    except FileNotFoundError:
        raise InputError(
            Problem(
                FILE,
                "a dataset.toml in the folder",
                _WRITE_ONE,
                value=f"no file {path.name} in {path.parent}",
            )
        ) from None
    except OSError as error:
        raise InputError(
            Problem(FILE, "a readable file", "Check its permissions.", value=str(error))
        ) from None
    except UnicodeDecodeError as error:
        row = error.object[: error.start].count(b"\n") + 1
        raise InputError(
            Problem(
                FILE,
                "text encoded as UTF-8",
                "Save the file as UTF-8.",
                row=row,
                value=error.object[error.start : error.start + 1],
            )
        ) from None
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        found = re.search(r"at line (\d+)", str(error))
        raise InputError(
            Problem(
                FILE,
                "valid TOML",
                "Mend the syntax; text stands in quotes, tables in [brackets].",
                row=int(found[1]) if found else None,
                value=str(error),
            )
        ) from None
    return parse_settings(raw, text)


def parse_settings(raw: dict[str, Any], text: str = "") -> Settings:
    """Check settings that are already a dictionary.

    Args:
        raw: the keys of ``dataset.toml``, tables as nested dictionaries.
        text: the file they came from, to find the rows of what is wrong.

    Raises:
        InputError: every unknown, missing or wrong entry.
    """
    problems = _unit_problems(raw, text)
    try:
        settings = Settings.model_validate(raw)
    except ValidationError as error:
        problems = [_as_problem(detail, text) for detail in error.errors()] + problems
    if problems:
        raise InputError(problems)
    return settings


_WRITE_ONE = (
    'Write one with name = "…" and a table [signal] with quantity and unit; data/README.md shows how.'
)


def _dimension(quantity: str) -> Dimension:
    return "length" if quantity == "displacement" else "acceleration"


def _unit_problems(raw: dict[str, Any], text: str) -> list[Problem]:
    signal = raw.get("signal")
    signal = signal if isinstance(signal, dict) else {}
    wanted: dict[str, Dimension] = {"time_unit": "time"}
    if signal.get("quantity") in ("deceleration", "acceleration", "displacement"):
        wanted["unit"] = _dimension(signal["quantity"])
    problems = []
    for key, dimension in wanted.items():
        unit = signal.get(key)
        if not isinstance(unit, str) or not unit:
            continue
        try:
            to_si(unit, dimension)
        except ValueError:
            problems.append(
                Problem(
                    FILE,
                    EXAMPLES[dimension],
                    "Write the unit that the recorder used, and check signal.quantity.",
                    row=_row_of(text, ("signal", key)),
                    column=f"signal.{key}",
                    value=unit,
                )
            )
    return problems


def _as_problem(detail: Any, text: str) -> Problem:
    place = tuple(str(part) for part in detail["loc"])
    allowed = _table(place[:-1]).model_fields
    column, row = ".".join(place), _row_of(text, place)
    if detail["type"] == "extra_forbidden":
        keys = ", ".join(allowed)
        return Problem(
            FILE, f"one of the keys {keys}", "Correct the name or take the line out.", row, column, place[-1]
        )
    expected = allowed[place[-1]].description or "a value"
    if detail["type"] == "missing":
        return Problem(FILE, expected, f"Add the key {column}.", column=column, value="nothing")
    return Problem(FILE, expected, f"Correct the value of {column}.", row, column, repr(detail["input"]))


def _table(place: tuple[str, ...]) -> type[BaseModel]:
    tables: dict[str, type[BaseModel]] = {"signal": SignalSettings, "uncertainty": UncertaintySettings}
    return tables.get(".".join(place), Settings)


def _row_of(text: str, place: tuple[str, ...]) -> int | None:
    table: tuple[str, ...] = ()
    for number, line in enumerate(text.splitlines(), start=1):
        here = None
        if header := re.match(r"\s*\[\s*([^\]]+?)\s*\]", line):
            here = table = _parts(header[1])
        elif key := re.match(r"\s*([^=#]+?)\s*=", line):
            here = table + _parts(key[1])
        if here == place:
            return number
    return None


def _parts(name: str) -> tuple[str, ...]:
    return tuple(part.strip(" \"'") for part in name.split("."))
