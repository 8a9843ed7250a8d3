"""The keys of the program's settings files, from the classes that check them."""

from __future__ import annotations

import re
import types
from collections.abc import Iterator
from typing import Annotated, Any, Literal, NamedTuple, TypeAliasType, Union, get_args, get_origin

from annotated_types import Ge, Gt, Le, Lt
from pydantic import BaseModel
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from bayestissue.mechanics.elements import element, element_names
from bayestissue.model.hierarchy import priors
from bayestissue.model.hierarchy.specification import ModelSpecification
from bayestissue.recordings.dataset.dataset_file import Settings
from bayestissue.recordings.dataset.impact_table import COLUMNS, required_columns
from bayestissue.studies.bench.campaign_file import CampaignSpecification
from bayestissue.studies.planning.design_prior import Known
from bayestissue.studies.planning.plan_file import PlanSpecification
from bayestissue.studies.simulation.simulation_file import Simulation
from from_program.markdown import code, escaped, table

# Tables that are written on one line, and described once.
_DISTRIBUTIONS = (priors.Normal, priors.HalfNormal, priors.HalfStudentT, priors.Correlation)
_IN_ONE_LINE = (*_DISTRIBUTIONS, priors.Pair, Known)
_UNITS = {
    "_N_s_per_m": "N s/m",
    "_N_per_m": "N/m",
    "_rad_s": "rad/s",
    "_m_s2": "m/s²",
    "_m_s": "m/s",
    "_kg": "kg",
    "_Hz": "Hz",
    "_hz": "Hz",
    "_J": "J",
    "_s": "s",
    "_m": "m",
}


class Table(NamedTuple):
    """A table of a settings file: how its heading is written, and the class that checks it."""

    heading: str
    schema: type[BaseModel]


def unit(name: str) -> str:
    """The unit that a name ends with; none of what has none."""
    return next((of for ending, of in _UNITS.items() if name.endswith(ending)), "")


def model() -> str:
    """Keys of a model file, its distributions, and what an element has besides K and C."""
    kinds = [(code(each.__doc__.split("``")[1]), escaped(_after(each.__doc__))) for each in _DISTRIBUTIONS]
    further = [
        (code(name), code(each.name), each.unit, escaped(each.meaning))
        for name in element_names()
        for each in element(name).extra
    ]
    return "\n\n".join(
        [
            sections(ModelSpecification),
            "## Distributions",
            "`K` and `C` of one prior have a distribution each.",
            table(["written", "is of"], kinds),
            "## Elements' parameters",
            "Those besides `K` and `C`. Each is above zero; formulas and priors are of its logarithm.",
            table(["element", "parameter", "unit", "meaning"], further),
        ]
    )


def dataset() -> str:
    """Keys of dataset.toml."""
    return sections(Settings)


def impacts() -> str:
    """Columns of impacts.csv."""
    required = required_columns()
    rows = [
        (code(name), "required" if name in required else "", escaped(words))
        for name, words in COLUMNS.items()
    ]
    return table(["column", "", "meaning"], rows)


def simulation() -> str:
    """Keys of the specification of `bayestissue simulate`."""
    return sections(Simulation)


def plan() -> str:
    """Keys of the plan file of `bayestissue plan`."""
    return sections(PlanSpecification)


def campaign() -> str:
    """Keys of the campaign file of `bayestissue watch`."""
    return sections(CampaignSpecification)


def sections(schema: type[BaseModel]) -> str:
    """A heading and a table of keys for every table of a file."""
    return "\n\n".join(f"## {name}\n\n{_table(each)}" for name, each in tables(schema))


def tables(schema: type[BaseModel], within: str = "") -> Iterator[Table]:
    """The tables of a file, the outermost first."""
    yield Table(f"`[{within}]`" if within else "At the top", schema)
    for name, field in schema.model_fields.items():
        for inner, pattern in _inner(field.annotation):
            here = pattern.format(f"{within}.{name}" if within else name)
            if pattern.startswith("[["):
                yield Table(f"`{here}`", inner)
            elif not issubclass(inner, _IN_ONE_LINE):
                yield from tables(inner, here)


def _inner(annotation: Any) -> Iterator[tuple[type[BaseModel], str]]:
    """The tables that a key may hold, each with how its name is made from the key's."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation, "{}"
    pattern = {dict: "{}.NAME", list: "[[{}]]", tuple: "[[{}]]"}.get(get_origin(annotation))
    for part in get_args(annotation):
        for inner, own in _inner(part):
            yield inner, pattern or own


def _own_first(schema: type[BaseModel]) -> list[tuple[str, FieldInfo]]:
    """The fields, those that a class takes from another behind its own."""
    return sorted(schema.model_fields.items(), key=lambda item: item[0] not in schema.__annotations__)


def _table(schema: type[BaseModel]) -> str:
    rows = [
        (code(name), _value(name, field), escaped(_sentence(_with_choices(field))))
        for name, field in _own_first(schema)
    ]
    return table(["key", "value", "meaning"], rows)


def _value(name: str, field: FieldInfo) -> str:
    allowed, of = _allowed(field.annotation, field.metadata), unit(name)
    default = "required" if field.is_required() else _shown(field.get_default(call_default_factory=True))
    told = [f"{allowed} {of}".rstrip(), default if default in ("", "required") else f"default {default}"]
    return "; ".join(filter(None, told))


def _with_choices(field: FieldInfo) -> str:
    """The description, in which a choice that is explained ("peak: ...") is code."""
    text = field.description or ""
    for choice in _choices(field.annotation):
        text = re.sub(rf"(?<![\w`-]){re.escape(choice)}(?=:)", f"`{choice}`", text)
    return text


def _choices(annotation: Any) -> Iterator[str]:
    if isinstance(annotation, TypeAliasType):
        yield from _choices(annotation.__value__)
    for part in get_args(annotation):
        yield from [part] if isinstance(part, str) else _choices(part)


def _sentence(text: str) -> str:
    return text[:1].upper() + text[1:]


def _shown(value: Any) -> str:
    if value is None or value is PydanticUndefined or value in ("", (), {}):
        return ""
    if isinstance(value, _DISTRIBUTIONS):
        return value.words()
    if isinstance(value, Known):
        return f"{value.value:g}"
    if isinstance(value, priors.Pair):
        return "; ".join(f"{name}: {_shown(each)}" for name, each in value)
    if isinstance(value, BaseModel):
        return ""
    return code({True: "true", False: "false"}.get(value, value) if isinstance(value, bool) else _toml(value))


def _toml(value: Any) -> str:
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_toml, value))}]"
    return f'"{value}"' if isinstance(value, str) else f"{value:g}"


def _allowed(annotation: Any, metadata: Any = ()) -> str:
    """The values that a key may have, in words."""
    if isinstance(annotation, TypeAliasType):
        return _allowed(annotation.__value__, metadata)
    arguments = get_args(annotation)
    origin = get_origin(annotation)
    if origin is Annotated:
        inner = arguments[1:]
        return _allowed(arguments[0], [*metadata, *(m for each in inner for m in _constraints(each))])
    if origin is Literal:
        return ", ".join(code(_toml(each)) for each in arguments)
    if origin in (Union, types.UnionType):
        return ", ".join(dict.fromkeys(_allowed(each) for each in arguments if each is not types.NoneType))
    if origin is dict:
        return f"a table of names and {_several(arguments[1])}"
    if origin in (list, tuple):
        return f"a list of {_several(arguments[0])}"
    if issubclass(annotation, BaseModel):
        return _of_table(annotation)
    named = {bool: "`true`, `false`", str: "text", int: "a whole number", float: "a number"}
    return " ".join([named[annotation], *_limits(metadata)])


def _constraints(each: Any) -> list[Any]:
    return list(each.metadata) if isinstance(each, FieldInfo) else [each]


def _limits(metadata: Any) -> Iterator[str]:
    words = {Gt: "above {}", Ge: "from {}", Lt: "below {}", Le: "to {}"}
    for each in metadata:
        for kind, said in words.items():
            if isinstance(each, kind):
                yield said.format(f"{getattr(each, kind.__name__.lower()):g}")


def _several(annotation: Any) -> str:
    if _inner_table := next(_inner(annotation), None):
        return "distributions" if issubclass(_inner_table[0], _IN_ONE_LINE) else "tables"
    words = _allowed(annotation)
    return {"text": "texts", "a number": "numbers"}.get(words, words.replace("a number", "numbers", 1))


def _of_table(annotation: type[BaseModel]) -> str:
    if issubclass(annotation, Known):
        return "a number"
    if issubclass(annotation, _DISTRIBUTIONS):
        return code(annotation.__doc__.split('"')[1])
    return "`K` and `C`, a distribution each" if issubclass(annotation, priors.Pair) else "a table"


def _after(text: str) -> str:
    return text.split("``")[2].lstrip(": ").strip()
