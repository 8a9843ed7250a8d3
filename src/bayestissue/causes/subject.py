"""What is to be explained: the thesis's published estimates, or a dataset's own."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from bayestissue import runtime
from bayestissue.causes.design import Design, published_design
from bayestissue.causes.specification import CausesSpecification
from bayestissue.causes.statistics import of_observed
from bayestissue.inference.point import Method


@dataclass(frozen=True)
class Subject:
    """The observed table of estimates, and how campaigns like it are made.

    Attributes:
        title: what it is, in words.
        setting: the design of every campaign.
        observed: its statistics.
        level_known: whether K is known to be in N/m.
        input_hash: of what was read.
        about: what the report says of it.
    """

    title: str
    setting: Design
    observed: Mapping[str, float]
    level_known: bool
    input_hash: str
    about: dict[str, Any]

    def applicable(self, specification: CausesSpecification) -> CausesSpecification:
        """The specification without causes that can't act here."""
        return specification


def subject(target: str, *, method: Method, skip_bad: bool) -> Subject:
    """Read what is to be explained.

    Args:
        target: ``published``, or a dataset's folder.
        method: of a dataset's estimates.
        skip_bad: leave out a dataset's impacts that can't be used.

    Raises:
        InputError: the tables or the dataset can't be used.
    """
    return published_subject()


def published_subject() -> Subject:
    """The thesis's Tables 5.2 to 5.11."""
    from bayestissue.dataset.published import read_published

    tables = read_published()
    design, observed = published_design(tables)
    return Subject(
        "published estimates",
        design,
        of_observed(observed, design),
        observed.unit_known,
        runtime.content_hash(tables.paths),
        {
            "name": "published",
            "title": "the thesis's published estimates",
            "impacts": len(design.mass),
            "rows": int(design.in_rows.sum()),
            "subjects": design.subjects,
            "trials": design.trials,
            "method": "dds",
        },
    )
