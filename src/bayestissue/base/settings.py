"""Settings files: TOML, checked whole against a pydantic schema before anything runs."""

from __future__ import annotations

import inspect
import re
import tomllib
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import UnionType
from typing import TYPE_CHECKING, Annotated, Any, Self, Union, get_args, get_origin

from pydantic import AfterValidator, BaseModel, ConfigDict, ValidationError, model_validator

from bayestissue.base.declarations import described
from bayestissue.base.errors import InputError, Problem
from bayestissue.base.remedies import messages

if TYPE_CHECKING:
    from pydantic.fields import FieldInfo

_LARGEST = 10_000_000


class TomlTable(BaseModel):
    """A table of a settings file: a key that it does not have is a mistake, and its values stay as read.

    What a key means stands in the docstring of its table under ``Attributes:``, whence the reference has it.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    @classmethod
    def __pydantic_init_subclass__(cls, **_: Any) -> None:
        """Give each key what the docstring says of it."""
        for key, meaning in described(cls.__doc__, "Attributes")[1].items():
            cls.model_fields[key].description = meaning

    def contradictions(self) -> Iterator[str]:
        """What is expected of its values together and does not hold; the first is said."""
        yield from ()

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        for expected in self.contradictions():
            raise ValueError(expected)
        return self


def only(holds: Callable[[Any], object], expected: str) -> AfterValidator:
    """Refuses a value of which ``holds`` is false; ``expected`` says what it may be."""

    def validated(value: Any) -> Any:
        if not holds(value):
            raise ValueError(expected)
        return value

    return AfterValidator(validated)


# An argument of a function, its name apart, and what it means: see `bayestissue.base.declarations.taking`.
Argument = tuple[inspect.Parameter, str]


def argument(field: FieldInfo) -> Argument:
    """The argument that states a key; a table is a dictionary of its keys."""
    types, meaning, default = kinds(field.annotation), str(field.description), field.default
    if keys := [key for kind in types for key in getattr(kind, "model_fields", {})]:
        types, default = [*types, dict[str, Any]], None
        meaning += f"{'' if meaning.endswith('.') else '.'} Its keys are {', '.join(keys)}."
    if field.is_required():
        default = inspect.Parameter.empty
    annotation: Any = Union[*types] if default is not None else Union[*types, None]
    parameter = inspect.Parameter(
        "key", inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation
    )
    return parameter, meaning


def kinds(annotation: Any) -> list[Any]:
    """The types that a value may have, without None and what else is required of it."""
    if get_origin(annotation) is Annotated:
        return kinds(get_args(annotation)[0])
    if get_origin(annotation) in (Union, UnionType):
        return [kind for one in get_args(annotation) if one is not type(None) for kind in kinds(one)]
    return [annotation]


def read_toml(path: Path) -> dict[str, Any]:
    """The content of a TOML file.

    Raises:
        InputError: the file can't be read, is not UTF-8, or is not TOML (with the row of the slip).
    """
    return parse_toml(read_text(path, str(path)), str(path))


def read_text(path: Path, file: str) -> str:
    """The text of a file, which messages call ``file``.

    Raises:
        InputError: the file can't be read, is far too large, or is not UTF-8 (with the row of the first wrong
            byte).
    """
    try:
        if path.exists() and not (path.is_file() and path.stat().st_size < _LARGEST):
            kind = "a folder, a device or more"
            raise InputError.stated("no-file.settings", file, value=kind, limit=_LARGEST / 1e6)
        return path.read_bytes().decode("utf-8-sig")
    except OSError as error:
        value = error.strerror or "an unreadable file"
        problem = Problem.stated("unreadable-file.settings", file, value=value)
    except UnicodeDecodeError as error:
        row = error.object[: error.start].count(b"\n") + 1
        wrong = error.object[error.start : error.start + 1]
        problem = Problem.stated("not-text.settings", file, row=row, value=wrong)
    raise InputError(problem)


def parse_toml(text: str, file: str) -> dict[str, Any]:
    """The content of TOML text, which came from ``file``.

    Raises:
        InputError: the text is not TOML (with the row of the slip).
    """
    try:
        return tomllib.loads(text)
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        line = re.search(r"at line (\d+)", str(error))
        row = int(line[1]) if line else None
        raise InputError.stated("not-toml", file, row=row, value=str(error)) from None


def row_of(text: str, key: Sequence[str]) -> int | None:
    """The row of TOML text in which a key, or the table of that name, stands; None if it isn't found.

    A table of a list has its number behind the list's name: ``("channel", "0", "unit")``; so has a table
    within one.
    """
    table: tuple[str, ...] = ()
    count: Counter[str] = Counter()
    for number, line in enumerate(text.splitlines(), start=1):
        here = None
        if header := re.match(r"\s*\[\[\s*([^\]]+?)\s*\]\]", line):
            here = table = (*_parts(header[1]), str(count[header[1]]))
            count[header[1]] += 1
        elif header := re.match(r"\s*\[\s*([^\]]+?)\s*\]", line):
            name, *within = _parts(header[1])
            here = table = (name, str(count[name] - 1), *within) if name in count else (name, *within)
        elif entry := re.match(r"\s*([^=#]+?)\s*=", line):
            here = table + _parts(entry[1])
        if here == tuple(key):
            return number
    return None


def _parts(name: str) -> tuple[str, ...]:
    return tuple(part.strip(" \"'") for part in name.split("."))


def checked[Schema: BaseModel](
    content: Mapping[str, Any], schema: type[Schema], *, file: str, within: Sequence[str] = (), text: str = ""
) -> Schema:
    """``content`` as a ``schema``; ``within`` names the table of ``file`` that holds it.

    With the ``text`` of the file, problems name their rows.

    Raises:
        InputError: every key that is unknown, missing or has a wrong value, with what is allowed.
    """
    try:
        return schema.model_validate(dict(content))
    except ValidationError as error:
        details = _causes(error.errors())
        problems = _merged([_problem(detail, schema, file, tuple(within)) for detail in details])
        raise InputError(
            replace(problem, row=row_of(text, (problem.column or "").split("."))) for problem in problems
        ) from error


def _causes(details: Sequence[Any]) -> list[Any]:
    """Without what only follows: a list whose tables are all wrong counts as one that is too short."""

    def has_others(location: tuple[str | int, ...]) -> bool:
        return any(location == one["loc"][: len(location)] != one["loc"] for one in details)

    return [detail for detail in details if detail["type"] != "too_short" or not has_others(detail["loc"])]


def _merged(problems: list[Problem]) -> list[Problem]:
    # One wrong value of a choice of types is one problem, whatever the number of types.
    merged: dict[str, Problem] = {}
    for problem in problems:
        key = str(problem.column)
        earlier = merged.get(key)
        expected = f"{earlier.expected}, or {problem.expected}" if earlier else problem.expected
        merged[key] = replace(problem, expected=expected)
    return list(merged.values())


def _problem(detail: Any, schema: type[BaseModel], file: str, within: tuple[str, ...]) -> Problem:
    location = _existing(detail["loc"], schema)
    key = ".".join([*within, *(str(part) for part in location)])
    # Of a key or a value of an earlier version, the name is without the numbers of tables.
    name, value = ".".join(part for part in (*within, *location) if isinstance(part, str)), detail["input"]
    is_unknown = detail["type"] == "extra_forbidden"
    retired = ("key", name) if is_unknown else ("value", f"{name} = {value}")
    if gone := Problem.of_retired(*retired, file, None, key, None if is_unknown else value):
        return gone
    if is_unknown:
        allowed = ", ".join(allowed_keys(schema, location[:-1]))
        return Problem.stated("unknown-key", file, None, key, value, allowed=allowed)
    if detail["type"] == "missing":
        return Problem.stated("missing-key", file, column=key)
    if detail["type"] == "model_type":
        allowed = ", ".join(allowed_keys(schema, location))
        return Problem.stated("key-value.table-of", file, None, key, value, allowed=allowed)
    if detail["type"] in messages():
        return Problem.stated(detail["type"], file, None, key, value, **detail["ctx"])
    message = detail["msg"].removeprefix("Input should be ").removeprefix("Value error, ")
    shown = None if isinstance(value, Mapping) else value
    words = {"expected": message[:1].lower() + message[1:]}
    return Problem.stated(
        "key-value.key" if key else "key-value.keys", file, None, key or None, shown, **words
    )


def allowed_keys(schema: type[BaseModel], location: Sequence[str | int] = ()) -> tuple[str, ...]:
    """The keys that the table at ``location`` of a file of this ``schema`` may hold."""
    node = _at(schema, location)
    return tuple(node.model_fields) if node is not None else ()


def _at(schema: type[BaseModel], location: Sequence[str | int]) -> type[BaseModel] | None:
    node: type[BaseModel] | None = schema
    for part in location:
        if isinstance(part, int):
            continue
        field = None if node is None else node.model_fields.get(part, _free(node))
        if field is None:
            return None
        node = _table_in(field.annotation)
    return node


def _free(table: type[BaseModel]) -> FieldInfo | None:
    """The kind of keys that a table may have besides its own: that of its own."""
    fields = iter(table.model_fields.values())
    return next(fields, None) if table.model_config.get("extra") == "allow" else None


def _table_in(annotation: Any) -> type[BaseModel] | None:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next(filter(None, map(_table_in, get_args(annotation))), None)


def _existing(location: Sequence[str | int], schema: type[BaseModel]) -> tuple[str | int, ...]:
    # For a choice of types pydantic appends the type it tried, and for a choice of tables it inserts
    # the tag that chose: neither is a key of the file.
    keys: list[str | int] = []
    for index, part in enumerate(location):
        node = _at(schema, keys)
        if keys and node is None and isinstance(part, str):
            break
        last = index == len(location) - 1
        known = node is None or part in node.model_fields or _free(node) is not None
        if isinstance(part, str) and not known and not last:
            continue
        keys.append(part)
    return tuple(keys)
