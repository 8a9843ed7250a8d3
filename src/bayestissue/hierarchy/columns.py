"""What a column of the impacts may be: codes of categories, or labels that tell impacts apart and no more."""

from __future__ import annotations

from dataclasses import dataclass

import pandas as pd

from bayestissue.dataset.impacts import REFERENCE, RESERVED
from bayestissue.hierarchy.formulas.group_terms import labels_of

# What every study has, and what `bayestissue init` fills besides: counts of repeats, and heights of drops.
USUAL = (
    *(
        "subject",
        "trial",
        "mass_kg",
        "velocity_m_s",
        "energy_J",
        "diameter_m",
        "sampling_rate_hz",
        *REFERENCE,
    ),
    *("n", "drop_height_m", "drop_height_cm", "drop_height_mm"),
)
_DATE = r"(19|20)\d{6}|\d{4}-\d\d?-\d\d?([T ].*)?|\d\d?[./]\d\d?[./]\d{2,4}( .*)?|\d\d?:\d\d(:\d\d.*)?"


@dataclass(frozen=True)
class ColumnSettings:
    """How a column is judged by its values.

    Attributes:
        categories: so many different values at the most are categories: more whole numbers are no codes, and
            of more texts a group has an effect for each, where fewer are a covariate. As many as a person
            has fingers and conditions of a trial seldom exceed.
        codes: so many at the least: two whole numbers make the same effect as two categories.
        repeated: a label stands on average in so many impacts at the least, or it is a mere label.
    """

    categories: int = 6
    codes: int = 3
    repeated: int = 2


SETTINGS = ColumnSettings()


def few_valued(rows: pd.DataFrame) -> dict[str, list[str]]:
    """The columns, and their values, that may be codes: few whole numbers, and no count."""
    known = {
        str(name): rows[name].dropna()
        for name in rows
        if name not in (*USUAL, *RESERVED) and pd.api.types.is_numeric_dtype(rows[name])
    }
    return {
        name: labels_of(values.drop_duplicates().sort_values()).tolist()
        for name, values in known.items()
        if SETTINGS.codes <= values.nunique() <= SETTINGS.categories and (values % 1 == 0).all()
    }


def is_label(column: pd.Series) -> bool:
    """Whether a column tells impacts apart and no more: a name or a remark of nearly each, or a date."""
    labels = pd.Series(labels_of(column))
    if labels.str.fullmatch(_DATE).all():
        return True
    counted = not pd.api.types.is_numeric_dtype(column) or pd.api.types.is_integer_dtype(column)
    return counted and labels.nunique() > max(len(labels) / SETTINGS.repeated, SETTINGS.repeated)
