"""What of a model file, a dataset and a command does not go together: ``combinations.toml``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from bayestissue.base.declarations import declared
from bayestissue.base.errors import Problem

# What is stated, by name: keys of a model file, what a dataset has, and what a command does.
type Facts = Mapping[str, Any]


class Combination(NamedTuple):
    """Facts that do not go together.

    Attributes:
        facts: by name the values that take part in it.
        at: the key that is named; empty where the whole is.
        message: of ``remedies.toml``.
        words: or a clause.
    """

    facts: Mapping[str, Sequence[Any]]
    at: str = ""
    message: str = ""
    words: str = ""


COMBINATIONS = tuple(Combination(**one) for one in declared(__package__, "combinations.toml")["combination"])


def refused(facts: Facts, at: str) -> list[Combination]:
    """The combinations of ``facts`` that are refused at a key."""
    return [
        one
        for one in COMBINATIONS
        if one.at == at and all(facts.get(name) in some for name, some in one.facts.items())
    ]


def unsuited(facts: Facts, at: str, source: str) -> list[Problem]:
    """A problem for each combination of ``facts`` that is refused at a key of ``source``."""
    return [Problem.stated(one.message, source, None, at, facts[at], **facts) for one in refused(facts, at)]
