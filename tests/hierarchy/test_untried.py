"""Columns that vary and that no formula is of, as questions with the formula to try."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from bayestissue.model.hierarchy.columns import untried
from designs import design_of, impacts


@pytest.fixture(scope="module")
def rows() -> pd.DataFrame:
    """Four people on pads of two materials, at one site each; names, remarks, dates and times besides."""
    table = impacts().drop(columns=["operator", "room", "age", "session"])
    count, rng = len(table), np.random.default_rng(1)
    return table.assign(
        pad=rng.permutation(np.resize(["p1", "p2", "p3", "p4"], count)),
        material=lambda t: t["pad"].map({"p1": "foam", "p2": "foam", "p3": "gel", "p4": "gel"}),
        site=lambda t: t["subject"],
        batch=rng.permutation(np.resize([f"b{n}" for n in range(9)], count)),
        room=rng.uniform(15, 25, count),
        side="left",
        file=[f"r{n}.csv" for n in range(count)],
        number=np.arange(count),
        date=np.resize(["2020-11-11", "2020-11-12"], count),
        day=np.resize([20201111, 20201112], count),
        recorded_at=np.resize(["2020-11-11 13:25:24.320", "2020-11-12T08:00"], count),
        clock=np.resize(["13:25", "08:00:30"], count),
        drop_height_cm=np.resize([12, 20], count),
        repeat=np.resize([1, 2, 3], count),
    )


def test_each_is_tried_in_the_formula_that_these_rows_can_tell(rows: pd.DataFrame) -> None:
    found = {
        column["column"]: column
        for column in untried(design_of("log(mass_kg) + (1|subject)", rows=rows).recorded)
    }
    assert list(found) == ["pad", "material", "site", "batch", "room"]
    assert found["pad"]["varies"] == "4 levels"
    assert found["pad"]["formula"] == "log(mass_kg) + pad + (1|subject)"
    # Each person has one: its effects stand in place of theirs.
    assert found["site"]["formula"] == "log(mass_kg) + site"
    assert found["batch"]["formula"] == "log(mass_kg) + (1|subject) + (1|batch)"
    assert found["room"]["number"]
    assert found["room"]["varies"] == f"{rows['room'].min():.4g} to {rows['room'].max():.4g}"
    for column in found.values():
        design_of(column["formula"], rows=rows)
    used = design_of("pad + site + room + (1|batch)", rows=rows).recorded
    assert [column["column"] for column in untried(used)] == ["material"]
    # Pads tell their material already.
    assert untried(used)[0]["formula"] == ""
