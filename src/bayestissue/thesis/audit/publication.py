"""A publication: its tables, the numbers of its text, and what it says in words."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import pandas as pd

from bayestissue.dataset.published import PublishedTables
from bayestissue.errors import InputError, Problem
from bayestissue.thesis.audit.registry import Registry
from bayestissue.thesis.reproduction.reproduce import reproduce_published

_COLUMNS = ("topic", "place", "position", "weight", "sentence")

PUBLISHED: Registry[Publication] = Registry()
"""Checks of a publication: its tables against each other and against its text."""


def each(frame: pd.DataFrame) -> Iterator[Any]:
    """The rows of ``frame`` as named tuples, whose fields no type checker knows."""
    return iter(frame.itertuples())


@dataclass(frozen=True)
class Publication:
    """What a check of a publication gets to see.

    Attributes:
        tables: the published tables.
        statements: what the text says in words: topic, place, position (two positions on one topic
            contradict each other), weight (the severity of that) and sentence; may be empty.
    """

    tables: PublishedTables
    statements: pd.DataFrame

    @cached_property
    def reproduction(self) -> pd.DataFrame:
        """Every printed number beside the recomputed one; see `reproduce_published`."""
        return reproduce_published(self.tables)

    def claims(self, quantity: str, statistic: str) -> pd.DataFrame:
        """The claims of the text about one figure, in the order of the text."""
        claims = self.tables.claims
        return claims[(claims["quantity"] == quantity) & (claims["statistic"] == statistic)]


def thickness(claims: pd.DataFrame) -> tuple[float, pd.DataFrame]:
    """The greatest skin and muscle thickness that the text states, together, in m, and the claims of it."""
    layers = claims[claims["quantity"].str.endswith("thickness") & claims["statistic"].eq("maximum (mm)")]
    return float(layers["value"].sum()) / 1000, layers


def read_publication(tables: PublishedTables) -> Publication:
    """Add ``statements.csv``, where it lies beside the tables.

    Raises:
        InputError: the file lacks a column.
    """
    path = tables.folder / "statements.csv"
    if not path.is_file():
        return Publication(tables, pd.DataFrame(columns=list(_COLUMNS)))
    statements = pd.read_csv(path, dtype=str, keep_default_na=False)
    missing = [column for column in _COLUMNS if column not in statements]
    if missing:
        remedy = "Compare it with data/published."
        raise InputError(
            Problem(str(path), "this column", remedy, column=column, code="published-table")
            for column in missing
        )
    return Publication(tables, statements)
