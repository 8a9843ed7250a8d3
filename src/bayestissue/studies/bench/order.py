"""The drops that are still to come, by a campaign's order or a plan, and the row that a file takes."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import Any

from bayestissue.base.errors import InputError, Problem, refuse
from bayestissue.recordings.dataset.cells import in_case_of, standard_names
from bayestissue.recordings.intake.facts import FILE, Cells
from bayestissue.recordings.intake.names import columns
from bayestissue.studies.bench.campaign_file import WatchedCampaign
from bayestissue.studies.planning.candidates import grid
from bayestissue.studies.planning.plan import PLAN
from bayestissue.studies.planning.plan_file import plan_of


@dataclass(frozen=True)
class Order:
    """Drops that are wanted, in their order.

    Attributes:
        rows: the cells that each fills.
        people_named: whether its people are those of the dataset. A plan's are numbers: the first is whoever
            is hit first.
        files: of each row the recorder's file, with or without its ending, where the order names them.
    """

    rows: tuple[Cells, ...]
    people_named: bool = True
    files: tuple[str, ...] = ()

    def left(
        self, drops: Sequence[Cells], held: Iterable[int] = (), people: Iterable[str] = ()
    ) -> dict[int, Cells]:
        """The rows that no drop has filled yet, by their numbers.

        Args:
            drops: whose row isn't known; each fills the first one that it agrees with.
            held: rows that are known to be filled.
            people: who was hit; those of ``drops`` without them.
        """
        left = self.named(list(people) or dict.fromkeys(str(drop["subject"]) for drop in drops))
        for at in held:
            left.pop(at, None)
        for drop in drops:
            match = next((at for at, row in left.items() if row.items() <= drop.items()), None)
            if match is not None:
                del left[match]
        return left

    def named(self, people: Iterable[str]) -> dict[int, Cells]:
        """All rows by their numbers, those of a plan with the names of its first people."""
        rows = dict(enumerate(self.rows))
        if self.people_named:
            return rows
        planned = dict.fromkeys(str(row["subject"]) for row in self.rows)
        # Who comes next is not known: such a row leaves the person open.
        named: dict[str, Cells] = {
            plan: {"subject": name} for plan, name in zip(planned, people, strict=False)
        }
        return {
            at: {k: v for k, v in row.items() if k != "subject"} | named.get(str(row["subject"]), {})
            for at, row in rows.items()
        }

    def row_for(self, file: str, open_rows: Mapping[int, Cells], *facts: Cells) -> int | None:
        """The row that a new file takes: the one that names it, else the first open one.

        Args:
            file: its path relative to the folder.
            open_rows: that nobody has, by their numbers.
            facts: that it has to agree with, as far as there is a row that does: the last may be passed over.
        """
        names = {file, PurePosixPath(file).name, PurePosixPath(file).stem, file.rpartition(".")[0]}
        if any(self.files):
            return next((at for at in open_rows if self.files[at] in names), None)
        for agreed in (facts, facts[:-1]):
            wanted = {k: v for part in agreed for k, v in part.items()}
            for at, row in open_rows.items():
                if all(row[k] == wanted[k] for k in row.keys() & wanted.keys()):
                    return at
        return None

    def require_same(self, before: Sequence[Cells], held: Mapping[str, int]) -> None:
        """Refuse an order whose rows of files that were taken have other facts than when they were taken.

        Raises:
            InputError: every such row, with both values.
        """
        problems = []
        for file, at in held.items() if self.rows else ():
            now = self.rows[at] if at < len(self.rows) else {}
            was = before[at] if at < len(before) else {}
            said = self.files[at] if self.files and at < len(self.files) else ""
            pairs = {k: (now.get(k, "nothing"), was.get(k, "nothing")) for k in {**was, **now}}
            if said and self.row_for(file, {at: {}}) is None:
                pairs[FILE] = said, file
            differing = [(name, value, other) for name, (value, other) in pairs.items() if value != other]
            for name, value, other in differing[:1]:
                words: dict[str, Any] = {"name": name, "other": other, "drop": file}
                problems.append(Problem.stated("no-campaign.order", "order", at + 2, name, value, **words))
        refuse(problems)


def order_of(campaign: WatchedCampaign, plan: Path | None) -> Order:
    """The order of a campaign; without one, that of the design that a plan chose, if there is a plan.

    What the campaign's facts say was measured, and counts more than what a plan supposes.

    Raises:
        InputError: the folder holds no finished plan, or one that has drops which the facts rule out.
    """
    if campaign.order or plan is None:
        plain = [
            {k: v for k, v in _as_named(record, campaign).items() if k != FILE} for record in campaign.order
        ]
        files = tuple(record.get(FILE, "") for record in campaign.order)
        return Order(tuple(columns(record, "order") for record in plain), files=files)
    try:
        content = json.loads((plan / PLAN).read_text(encoding="utf-8"))
        planned = plan_of(content["plan"], str(plan))
        designs = grid(planned.candidates, tuple(planned.recordings))
        design = dict(enumerate(designs, 1))[content["chosen"]]
    except (OSError, ValueError, LookupError, TypeError, RecursionError):
        raise InputError.stated("no-campaign.plan", str(plan), value="no finished plan") from None
    table = replace(design, lost=0.0, lost_people=0.0).rows().drop(columns="trial")
    rows = [_as_named(row, campaign) for row in table.to_dict("records")]
    return Order(tuple(_measured(rows, campaign, plan)), people_named=False)


def _as_named(row: Mapping[Any, Any], campaign: WatchedCampaign) -> dict[str, Any]:
    """A row with the campaign's names of its columns, in whatever case it has them: they are one column."""
    names = [*campaign.facts, *(campaign.pattern.fields if campaign.pattern else ())]
    return dict(zip(in_case_of(names, standard_names(list(map(str, row)))), row.values(), strict=True))


def _measured(rows: list[dict[str, Any]], campaign: WatchedCampaign, plan: Path) -> list[Cells]:
    """The rows of a plan without the velocity that the campaign's facts have measured."""
    facts = columns(campaign.facts, "[facts]")
    problems = [
        Problem.stated("no-campaign.ruled-out", "[facts]", None, k, facts[k], other=row[k], plan=plan)
        for row in rows
        for k in row.keys() & facts.keys() - {"velocity_m_s", "subject"}
        if row[k] != facts[k]
    ]
    refuse(dict.fromkeys(problems))
    return [{k: v for k, v in row.items() if k == "subject" or k not in facts} for row in rows]
