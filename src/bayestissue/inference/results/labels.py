"""Names, units and dimensions of posterior quantities, put on arrays at the edge."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from types import MappingProxyType

import numpy as np
import xarray as xr

from bayestissue.base.declarations import declared
from bayestissue.inference.results.meanings import NAMES, UNITS, meaning
from bayestissue.mechanics.elements import element, element_names
from bayestissue.mechanics.elements.outcomes import DECLARED
from bayestissue.model.hierarchy.derived import effect_dimensions
from bayestissue.model.hierarchy.design import Design
from bayestissue.model.hierarchy.formulas.group_terms import MASS_TERM, common_coefficient, stem_of
from bayestissue.model.hierarchy.responses import intercept

STIFFNESS, DAMPING = UNITS.values()
_OF = ("cell", "subject", "trial", "new", "typical_person")
_ONE_COLUMN = ("subject", "trial")

_DECLARED = declared(__package__, "variables.toml")
# Of posterior.nc: what each group holds, and the variables that are in it alone; others are in the posterior.
GROUPS: dict[str, tuple[str, tuple[str, ...]]] = {
    name: (group["holds"], tuple(group.get("alone", "").split()))
    for name, group in _DECLARED["groups"].items()
}


def _worded(table: str, *each: Mapping[str, str], **words: str) -> dict[str, dict[str, str]]:
    """Unit and meaning of the variables of a table of ``variables.toml``, with these words in its braces.

    Of ``each`` of several such words, if there are any: a name without braces stands there once.
    """
    kind, _, name = table.partition(".")
    return {
        pattern.format(**of): {"unit": unit.format(**of), "long_name": long_name.format(**of)}
        for pattern, (unit, long_name) in (_DECLARED[kind][name] if name else _DECLARED[kind]).items()
        for of in each or [words]
    }


def _levels() -> dict[str, dict[str, str]]:
    """Of K and C of an impact, and at the levels of the population."""
    return {
        variable: {"unit": unit, "long_name": f"{NAMES[q]} of {meaning(variable).level}"}
        for q, unit in UNITS.items()
        for variable in (q, *(f"{q}_{level}" for level in _OF))
    }


_OF_EACH = [{"q": q, "name": NAMES[q], "unit": UNITS[q]} for q in UNITS]
ATTRIBUTES = _levels() | _worded("variables", *_OF_EACH)


def element_attributes() -> dict[str, dict[str, str]]:
    """Unit and meaning of the variables that elements have besides K and C."""
    table = _worded("elements")
    table |= {name: {"unit": one.unit, "long_name": one.meaning} for name, one in DECLARED.items()}
    for parameter in (extra for name in element_names() for extra in element(name).extra):
        symbol, log = parameter.name, f"log_{parameter.name}"
        table[symbol] = {"unit": parameter.unit, "long_name": parameter.meaning}
        table[f"{log}_mean"] = {"unit": "1", "long_name": f"mean over impacts of the log of {symbol}"}
        between = f"standard deviation between impacts of the log of {symbol}"
        table[f"sd_{log}"] = {"unit": "1", "long_name": between}
    return table


def unit_of(name: str) -> str:
    """The unit of a variable, an outcome, or a parameter of an element."""
    return (ATTRIBUTES | element_attributes())[name]["unit"]


def outcome_column(name: str, which: str = "") -> str:
    """The column of an outcome, its unit in the name: "peak_force_N", "peak_force_low_N", "restitution"."""
    unit = DECLARED[name].unit.replace("/", "_").replace(" ", "_").replace("^", "")
    return "_".join(part for part in (name, which, unit) if part not in ("", "1"))


def design_attributes(design: Design) -> dict[str, dict[str, str]]:
    """Unit and meaning of what a design has besides the effects of subject and trial on K and C."""
    words_of = {q: {"q": q, "name": NAMES.get(q, q), "unit": unit_of(q)} for q in design.responses}
    table: dict[str, dict[str, str]] = {}
    for name in design.groupings:
        table |= _worded("design.grouping", stem=stem_of(name), grouping=name)
        table[f"impact_{stem_of(name)}"] = {"long_name": f"the impact's {name}"}
        of_levels = f"each {name} at the reference mass"
        if name in _ONE_COLUMN:
            of_levels = meaning(f"K_{name}").level
        for words in words_of.values():
            table |= _worded("design.level", stem=stem_of(name), level=of_levels, **words)
    for q, part in design.responses.items():
        if q not in UNITS:
            table |= _worded("design.further", intercept=intercept(part.parameter), **words_of[q])
        for column in part.names:
            table |= _worded(
                "design.covariate", effect=common_coefficient(column, q), column=column, **words_of[q]
            )
        for name in design.recorded.response(q).named_by:
            of_levels = f"a typical person at the reference mass, of each {name}"
            table |= _worded("design.level", stem=stem_of(name), level=of_levels, **words_of[q])
            table |= _worded("design.named", stem=stem_of(name), column=name)
    for term in design.terms:
        for q, words in words_of.items():
            names = {"term": (term.coefficient if term.slope else term.effect)(q), "sd": term.sd(q)}
            kind = "design.slope" if term.slope else "design.effect"
            which = "mass exponent of" if term.slope == MASS_TERM else f"effect of {term.slope} on log"
            table |= _worded(kind, which=which, grouping=term.grouping, **names, **words)
    # People and conditions have words of their own for K and C.
    table = {name: words for name, words in table.items() if name not in ATTRIBUTES}
    return table | _averaged(design, ATTRIBUTES | table)


def _averaged(design: Design, known: Mapping[str, dict[str, str]]) -> dict[str, dict[str, str]]:
    """Words of what is averaged over categories that its name does not give, and ``averaged_over`` which."""
    table = {}
    for q in design.responses:
        groupings = design.groupings.items()
        columns_of: dict[str, tuple[str, ...]] = {stem_of(name): group.factors for name, group in groupings}
        columns_of |= {stem_of(name): (name,) for name in design.recorded.response(q).named_by}
        for stem, columns in (columns_of | {"typical_person": (), "new": ()}).items():
            over = " and ".join(design.recorded.response(q).averaged(columns))
            if over and (words := known.get(f"{q}_{stem}")):
                long_name = f"{words['long_name']}, averaged over {over} with equal weight"
                table[f"{q}_{stem}"] = {**words, "long_name": long_name, "averaged_over": over}
    return table


def design_dimensions(design: Design) -> dict[str, tuple[str, ...]]:
    """Of each response of the levels of a grouping, and of the effects of each group term."""
    dimensions: dict[str, tuple[str, ...]] = {
        f"{q}_{stem_of(name)}": (name,)
        for q in design.responses
        for name in (*design.groupings, *design.recorded.response(q).named_by)
    }
    return dimensions | {name: (grouping,) for name, grouping in effect_dimensions(design).items()}


def of_one_person(draws: xr.Dataset) -> None:
    """Say of "this person" what is said of a typical or a new one where there are several."""
    for q in UNITS:
        for variable in (f"{q}_{level}" for level in _OF):
            if variable in draws:
                words = draws[variable].attrs
                over = words.get("averaged_over", "")
                words["long_name"] = f"{NAMES[q]} of {meaning(variable, people=1).level}" + (
                    f", averaged over {over} with equal weight" if over else ""
                )


def labelled(
    arrays: Mapping[str, np.ndarray],
    dimensions: Mapping[str, tuple[str, ...]],
    coordinates: Mapping[str, list[str] | np.ndarray],
    *,
    sampled: bool = True,
    thinned: Collection[str] = (),
    attributes: Mapping[str, Mapping[str, str]] = MappingProxyType({}),
) -> xr.Dataset:
    """``arrays`` [chain, draw, ...] as a Dataset with named dimensions, units and meanings.

    ``dimensions`` gives what follows chain and draw; a name that it lacks is a scalar. With ``sampled``
    false the arrays have no chain and draw; those named in ``thinned`` have some draws only, "kept_draw".
    ``attributes`` are of names that no other data have.
    """
    variables, known = {}, ATTRIBUTES | element_attributes() | dict(attributes)
    for name, values in arrays.items():
        leading = ("chain", "kept_draw" if name in thinned else "draw") if sampled else ()
        dims = (*leading, *dimensions.get(name, ()))
        variables[name] = xr.Variable(dims, np.asarray(values), known.get(name, {"unit": "1"}))
    used = {dimension for variable in variables.values() for dimension in variable.dims}
    coords = {name: list(values) for name, values in coordinates.items() if name in used}
    for name in ("chain", "draw"):
        if name in used:
            coords[name] = list(range(next(v.sizes[name] for v in variables.values() if name in v.dims)))
    return xr.Dataset(variables, coords)
