"""What is to be explained: the thesis's published estimates, or a dataset's own."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from bayestissue import runtime
from bayestissue.errors import InputError, Problem
from bayestissue.inference.points.fit import Method
from bayestissue.thesis.causes.design import Design, published_design
from bayestissue.thesis.causes.known import KnownRecorder
from bayestissue.thesis.causes.specification import CausesSpecification
from bayestissue.thesis.causes.statistics import of_campaigns, of_observed

if TYPE_CHECKING:
    from bayestissue.dataset import Dataset

FEWEST_MASSES = 3


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
        known: what a dataset tells of its recorder and tissue; None for published estimates.
    """

    title: str
    setting: Design
    observed: Mapping[str, float]
    level_known: bool
    input_hash: str
    about: dict[str, Any]
    known: KnownRecorder | None = None

    def applicable(self, specification: CausesSpecification) -> CausesSpecification:
        """The specification with what is known of the recorder, and without causes that can't act here."""
        return self.known.informed(specification) if self.known else specification


def subject(target: str, *, method: Method, skip_bad: bool) -> Subject:
    """Read what is to be explained.

    Args:
        target: ``published``, or a dataset's folder.
        method: of a dataset's estimates.
        skip_bad: leave out a dataset's impacts that can't be used.

    Raises:
        InputError: the tables or the dataset can't be used, or its masses do not differ.
    """
    if target == "published":
        return published_subject()
    from bayestissue.dataset import read_dataset

    return dataset_subject(read_dataset(Path(target), skip_bad=skip_bad), method, target)


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


def dataset_subject(dataset: Dataset, method: Method, source: str) -> Subject:
    """A dataset's own estimates, by the method named.

    Raises:
        InputError: displacements were recorded, or there are fewer than three masses.
    """
    from bayestissue.inference.points.estimates import default_options, estimates_table
    from bayestissue.signal import displacements

    impacts = dataset.impacts
    _require_masses(dataset, source)
    tables = {}
    for each in {method, "exact"}:
        signal = displacements(dataset, default_options(each))
        tables[each] = estimates_table(dataset, signal, each)
    table = tables[method]
    known = KnownRecorder.of(dataset, signal, tables["exact"], method)
    design = Design(
        mass=impacts["mass_kg"].to_numpy(float),
        velocity=impacts["velocity_m_s"].to_numpy(float),
        subject=pd.factorize(impacts["subject"])[0],
        trial=pd.factorize(impacts["trial"])[0],
        in_rows=np.ones(len(impacts), bool),
        recorder=known.recorder,
    )
    K, C = (table[name].to_numpy(float)[None] for name in ("K_N_per_m", "C_N_s_per_m"))
    positive = (K > 0) & (C > 0)
    found = of_campaigns(np.where(positive, K, np.nan), np.where(positive, C, np.nan), design)
    return Subject(
        dataset.name,
        design,
        {name: float(value[0]) for name, value in found.items() if np.isfinite(value[0])},
        True,
        dataset.input_hash,
        {
            "name": dataset.name,
            "title": f"the estimates of {dataset.name}",
            "impacts": len(impacts),
            "rows": int(positive.sum()),
            "subjects": design.subjects,
            "trials": design.trials,
            "method": method,
        },
        known,
    )


def _require_masses(dataset: Dataset, source: str) -> None:
    if dataset.quantity == "displacement":
        raise InputError(
            Problem(
                source,
                "recorded decelerations or accelerations",
                "The causes are simulated as decelerations; a dataset of displacements can't be compared.",
                column="signal.quantity",
                value=dataset.quantity,
                code="wrong-quantity",
            )
        )
    if dataset.gravity:
        raise InputError(
            Problem(
                source,
                "impacts across gravity, as the thesis's pendulum made them",
                "The causes are simulated without gravity; a dataset of drops can't be compared.",
                column="signal.gravity",
                value=f"{dataset.gravity:g} m/s²",
                code="wrong-quantity",
            )
        )
    masses = dataset.impacts.groupby("trial")["mass_kg"].mean().round(9).nunique()
    if masses < FEWEST_MASSES:
        raise InputError(
            Problem(
                source,
                f"conditions of at least {FEWEST_MASSES} masses",
                "Where the mass does not vary there is no dependence on it to explain.",
                column="mass_kg",
                value=masses,
                code="one-mass",
            )
        )
