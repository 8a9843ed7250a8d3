"""The drops that are still to come: by the order of a campaign, or by a plan."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from bayestissue.bench.campaign import Campaign
from bayestissue.errors import InputError
from bayestissue.intake.facts import Cells
from bayestissue.intake.names import columns
from bayestissue.planning.candidates import grid
from bayestissue.planning.plan import PLAN
from bayestissue.planning.specification import plan_of


@dataclass(frozen=True)
class Order:
    """Drops that are wanted, in their order.

    Attributes:
        rows: the cells that each fills.
        people_named: whether its people are those of the dataset. A plan's are numbers: the first is whoever
            is hit first.
    """

    rows: tuple[Cells, ...]
    people_named: bool = True

    def left(self, drops: Iterable[Cells]) -> list[Cells]:
        """The rows that no drop has filled yet; a drop fills the first one that it agrees with."""
        drops = list(drops)
        left = self._with_people(list(dict.fromkeys(str(drop["subject"]) for drop in drops)))
        for drop in drops:
            match = next((row for row in left if row.items() <= drop.items()), None)
            if match is not None:
                left.remove(match)
        return left

    def _with_people(self, people: Sequence[str]) -> list[Cells]:
        rows = list(self.rows)
        if self.people_named:
            return rows
        planned = list(dict.fromkeys(str(row["subject"]) for row in rows))
        names = dict(zip(planned, people, strict=False))
        # Who comes next is not known: such a row leaves the person open.
        unnamed = [{k: v for k, v in row.items() if k != "subject"} for row in rows]
        return [
            {**open_row, "subject": names[str(row["subject"])]} if str(row["subject"]) in names else open_row
            for row, open_row in zip(rows, unnamed, strict=True)
        ]


def order_of(campaign: Campaign, plan: Path | None) -> Order:
    """The order of a campaign; without one, that of the design that a plan chose, if there is a plan.

    Raises:
        InputError: the folder holds no finished plan.
    """
    if campaign.order or plan is None:
        return Order(tuple(columns(record, "order") for record in campaign.order))
    try:
        content = json.loads((plan / PLAN).read_text(encoding="utf-8"))
        planned = plan_of(content["plan"], str(plan))
        design = grid(planned.candidates)[content["chosen"] - 1]
    except (OSError, ValueError, KeyError, IndexError):
        raise InputError.stated("no-campaign.plan", str(plan), value="no finished plan") from None
    rows = replace(design, lost=0.0, lost_people=0.0).rows().drop(columns="trial")
    return Order(tuple({str(k): v for k, v in row.items()} for row in rows.to_dict("records")), False)
