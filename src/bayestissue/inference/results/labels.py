"""Names, units and dimensions of posterior quantities, put on arrays at the edge."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from functools import cache
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
import xarray as xr

from bayestissue.base.declarations import declared
from bayestissue.base.outcome_table import DECLARED
from bayestissue.inference.results.meanings import (
    LEVEL_WORDS,
    LEVEL_WORDS_OF_ONE_PERSON,
    LEVELS,
    NAMES,
    UNITS,
)
from bayestissue.mechanics.elements import element, element_names
from bayestissue.model.hierarchy.design import Design
from bayestissue.model.hierarchy.formulas.group_terms import MASS_TERM, common_coefficient, stem_of
from bayestissue.model.hierarchy.responses import intercept

_ONE_COLUMN = ("subject", "trial")

_DECLARED = declared(__package__, "variables.toml")
# Of posterior.nc: what each group holds, and the variables that are in it alone; others are in the posterior.
GROUPS: dict[str, tuple[str, tuple[str, ...]]] = {
    name: (group["holds"], tuple(group.get("alone", "").split()))
    for name, group in _DECLARED["groups"].items()
}


class Variable(NamedTuple):
    """What is said of a variable of ``posterior.nc``.

    Attributes:
        attrs: ``unit`` and ``long_name``, its meaning, and what else stands beside it.
        dims: what follows chain and draw.
    """

    attrs: dict[str, str]
    dims: tuple[str, ...] = ()


def _worded(table: str, *each: Mapping[str, str], **words: str) -> dict[str, Variable]:
    """The variables of a table of ``variables.toml``, with these words in its braces.

    Of ``each`` of several such words, if there are any: a name without braces stands there once.
    """
    kind, _, name = table.partition(".")
    return {
        pattern.format(**values): Variable(
            {"unit": unit.format(**values), "long_name": long_name.format(**values)},
            tuple(dimension.format(**values) for dimension in dims),
        )
        for pattern, (unit, long_name, *dims) in (_DECLARED[kind][name] if name else _DECLARED[kind]).items()
        for values in each or [words]
    }


@cache
def variables() -> Mapping[str, Variable]:
    """Those of any fit, of elements' further parameters and of outcomes too."""
    table = _levels(LEVEL_WORDS)
    table |= _worded("variables", *({"q": q, "name": NAMES[q], "unit": UNITS[q]} for q in UNITS))
    table |= _worded("elements")
    for name, one in DECLARED.items():
        table[name] = Variable({"unit": one.unit, "long_name": one.meaning}, ("impact",))
    for extra in (extra for name in element_names() for extra in element(name).extra):
        table |= _worded("parameter", symbol=extra.name, unit=extra.unit, meaning=extra.meaning)
    return MappingProxyType(table)


def _levels(words: Mapping[str, str]) -> dict[str, Variable]:
    """K and C of an impact and of the population's levels, by the words of what each is of."""
    return {
        q + suffix: Variable({"unit": unit, "long_name": f"{NAMES[q]} of {of}"}, tuple(LEVELS[suffix].dims))
        for q, unit in UNITS.items()
        for suffix, of in words.items()
    }


def unit_of(name: str) -> str:
    """The unit of a variable, an outcome, or a parameter of an element."""
    return variables()[name].attrs["unit"]


def design_variables(design: Design) -> dict[str, Variable]:
    """What a design has besides the effects of subject and trial on K and C."""
    known = variables()
    words_of = {
        q: {"q": q, "name": NAMES.get(q, q), "unit": known[q].attrs["unit"]} for q in design.responses
    }
    table: dict[str, Variable] = {}
    for name in design.groupings:
        table |= _worded("design.grouping", stem=stem_of(name), grouping=name)
        table[f"impact_{stem_of(name)}"] = Variable({"long_name": f"the impact's {name}"}, ("impact",))
        at_reference = f"each {name} at the reference mass"
        of_levels = LEVELS[f"_{name}"].of if name in _ONE_COLUMN else at_reference
        for words in words_of.values():
            table |= _worded("design.level", stem=stem_of(name), level=of_levels, grouping=name, **words)
    for q, part in design.responses.items():
        if q not in UNITS:
            table |= _worded("design.further", intercept=intercept(part.parameter), **words_of[q])
        for column in part.names:
            table |= _worded(
                "design.covariate", effect=common_coefficient(column, q), column=column, **words_of[q]
            )
        for name in design.recorded.response(q).named_by:
            of_levels = f"a typical person at the reference mass, of each {name}"
            table |= _worded(
                "design.level", stem=stem_of(name), level=of_levels, grouping=name, **words_of[q]
            )
            table |= _worded("design.named", stem=stem_of(name), column=name)
    for term in design.terms:
        for q, words in words_of.items():
            names = {"term": (term.coefficient if term.slope else term.effect)(q), "sd": term.sd(q)}
            kind = "design.slope" if term.slope else "design.effect"
            which = "mass exponent of" if term.slope == MASS_TERM else f"effect of {term.slope} on log"
            table |= _worded(kind, which=which, grouping=term.grouping, **names, **words)
    # People and conditions have words of their own for K and C, and of a study of one person all levels.
    table = {name: one for name, one in table.items() if name not in known}
    if len(design.subjects) == 1:
        table |= _levels(LEVEL_WORDS_OF_ONE_PERSON)
    return table | _averaged(design, {**known, **table})


def _averaged(design: Design, known: Mapping[str, Variable]) -> dict[str, Variable]:
    """What is averaged over categories that its name does not give, and ``averaged_over`` which."""
    table = {}
    for q in design.responses:
        groupings = design.groupings.items()
        columns_of: dict[str, tuple[str, ...]] = {stem_of(name): group.factors for name, group in groupings}
        columns_of |= {stem_of(name): (name,) for name in design.recorded.response(q).named_by}
        for stem, columns in (columns_of | {"typical_person": (), "new": ()}).items():
            over = " and ".join(design.recorded.response(q).averaged(columns))
            if over and (one := known.get(f"{q}_{stem}")):
                long_name = f"{one.attrs['long_name']}, averaged over {over} with equal weight"
                attrs = {**one.attrs, "long_name": long_name, "averaged_over": over}
                table[f"{q}_{stem}"] = one._replace(attrs=attrs)
    return table


def labelled(
    arrays: Mapping[str, np.ndarray],
    coordinates: Mapping[str, list[str] | np.ndarray] = MappingProxyType({}),
    further: Mapping[str, Variable] = MappingProxyType({}),
    *,
    sampled: bool = True,
    thinned: Collection[str] = (),
) -> xr.Dataset:
    """``arrays`` [chain, draw, ...] as a Dataset with named dimensions, units and meanings.

    Besides `variables` those ``further`` are known; any other is a scalar without unit. With ``sampled``
    false the arrays have no chain and draw; those named in ``thinned`` have some draws only, "kept_draw".
    """
    labelled_arrays, known = {}, {**variables(), **further}
    for name, values in arrays.items():
        leading = ("chain", "kept_draw" if name in thinned else "draw") if sampled else ()
        one = known.get(name, Variable({"unit": "1"}))
        labelled_arrays[name] = xr.Variable((*leading, *one.dims), np.asarray(values), one.attrs)
    used = {dimension for variable in labelled_arrays.values() for dimension in variable.dims}
    coords = {name: list(values) for name, values in coordinates.items() if name in used}
    dataset = xr.Dataset(labelled_arrays, coords)
    numbered = [name for name in ("chain", "draw") if name in used]
    return dataset.assign_coords({name: np.arange(dataset.sizes[name]) for name in numbered})
