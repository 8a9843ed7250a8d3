"""What an interval of K or C is of: one impact, these impacts, one person, a typical person, a new person.

The one table of these words; labels, tables, figures and pages take them from here.
"""

from __future__ import annotations

from collections.abc import Container, Hashable, Mapping, Sequence
from typing import NamedTuple

from bayestissue.base.declarations import declared
from bayestissue.base.errors import Coded
from bayestissue.base.outcome_table import REFERENCE_OUTCOMES

QUANTITIES = ("K", "C")
NAMES = {"K": "stiffness K", "C": "damping C"}
UNITS = {"K": "N/m", "C": "N s/m"}
# In tables of impacts.
COLUMNS = {"K": "K_N_per_m", "C": "C_N_s_per_m"}
# Measures of repeatability, by the names that tables have.
ICC, SEM, MDC = "intraclass correlation", "standard error of measurement", "minimal detectable change (95 %)"
REPEATS = "repeats"
# Above this overlap with the prior more than half of what is said of a quantity was said before the data.
MOSTLY = 0.5


class LevelWords(NamedTuple):
    """Of whom K and C are where a name is followed so: an entry of ``levels`` in ``variables.toml``."""

    of: str
    of_one_person: str = ""
    dims: Sequence[str] = ()


LEVELS = {
    suffix: LevelWords(**entry) for suffix, entry in declared(__package__, "variables.toml")["levels"].items()
}
# Of whom, and the same of the data of one person.
LEVEL_WORDS = {suffix: level.of for suffix, level in LEVELS.items()}
LEVEL_WORDS_OF_ONE_PERSON = {suffix: level.of_one_person or level.of for suffix, level in LEVELS.items()}
# Outcomes are those of the reference impact, which has the reference mass.
_OF_OUTCOMES = ("_typical_person", "_new", "_subject")
# Secant stiffness and equivalent damping mean the same for every element.
_COMPARABLE = {"K": ("K_secant", "secant K"), "C": ("C_equivalent", "equivalent C")}
# Of these K there is a mass exponent where K depends on depth.
SECANTS = {"K_common_depth": "K at the common depth", "K_secant": "K at each impact's greatest depth"}
# Beside a discrepancy the tissue's stiffness, of all recorded impacts; no other run has it.
TOGETHER = "K_secant_of_impacts"
# "These impacts" are those recorded, each person counting as often as hit.
_OF_IMPACTS = {
    "{name}_of_impacts": "these impacts together (geometric mean)",
    "{name}_of_subject": "a person's own impacts (geometric mean)",
}
ONE_IMPACT = Coded.stated("one-impact")


def element_alone(variables: Container[Hashable]) -> bool:
    """Whether K of a run with these variables is the element's own part of the force beside a discrepancy."""
    return TOGETHER in variables


def symbols(variables: Container[Hashable]) -> dict[str, str]:
    """The variables of an impact that are the tissue's stiffness and damping, by "K" and "C"."""
    return {"K": "K_secant" if element_alone(variables) else "K", "C": "C"}


def few_valued_words(columns: Mapping[str, Sequence[str]]) -> list[str]:
    """Of each column of few whole numbers that it is a straight line, and how it would be categories."""
    return [
        Coded.stated("few-values", name=name, values=", ".join(values[:-1]), last=values[-1])
        for name, values in columns.items()
    ]


class Meaning(NamedTuple):
    """Of a variable: ``what`` it is, and what the ``level`` that its interval is of."""

    what: str
    level: str

    def __str__(self) -> str:
        return f"{self.what} of {self.level}" if self.level else self.what


def meaning(variable: str, *, people: int = 2) -> Meaning:
    """What the interval of a variable is of, in words.

    Args:
        variable: by the name that it has in ``posterior.nc`` or in a table.
        people: how many the data have; of one, nothing is said of a new or a typical person.
    """
    return (_of_one_person if people == 1 else _of_several)[variable]


def heading_words(variable: str, level: str = "", label: str = "") -> str:
    """A variable with what its interval is of, such as "K of person s3 at the reference mass".

    Args:
        variable: by its name; one that this table lacks keeps it.
        level: as a table's own column has it; else as `meaning` has it.
        label: the name of the person, where it is one's.
    """
    known = _of_several.get(variable, Meaning(variable, ""))
    words = Meaning(known.what, level or known.level)
    if not label:
        return str(words)
    return str(words._replace(level=words.level.replace("a person", f"person {label}", 1) or label))


def outcome_name(name: str) -> str:
    """An outcome in words, such as "peak force"."""
    return name.replace("_", " ")


def _table(levels: Mapping[str, str]) -> dict[str, Meaning]:
    table = {f"{q}{level}": Meaning(q, words) for q in QUANTITIES for level, words in levels.items()}
    for name, what in _COMPARABLE.values():
        table |= {pattern.format(name=name): Meaning(what, words) for pattern, words in _OF_IMPACTS.items()}
    for name in REFERENCE_OUTCOMES:
        for level in _OF_OUTCOMES:
            words = levels[level].replace("reference mass", "reference impact")
            table[f"{name}{level}"] = Meaning(outcome_name(name), words)
    powers = {q: q for q in QUANTITIES} | SECANTS
    return table | {
        f"mass_exponent_{q}": Meaning(f"mass exponent of {what}", "") for q, what in powers.items()
    }


_of_several, _of_one_person = _table(LEVEL_WORDS), _table(LEVEL_WORDS_OF_ONE_PERSON)
