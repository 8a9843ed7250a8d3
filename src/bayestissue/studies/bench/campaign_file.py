"""The campaign file: how a recorder's files are read while they come in, which drops are wanted, how well."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from bayestissue.base.errors import InputError, Problem, refuse
from bayestissue.base.settings import TomlTable, checked, parse_toml, read_text
from bayestissue.recordings.dataset.cells import read_cells
from bayestissue.recordings.dataset.dataset_file import FILE as SETTINGS
from bayestissue.recordings.dataset.dataset_file import (
    ImpactorSettings,
    LowPassFilter,
    Positive,
    Settings,
    SignalSettings,
    Uncertainty,
    WordSettings,
)
from bayestissue.recordings.dataset.impact_table import required_columns
from bayestissue.recordings.dataset.recorders import SUFFIXES
from bayestissue.recordings.dataset.sample_tables import TEXT_SUFFIXES
from bayestissue.recordings.dataset.source_files import Source
from bayestissue.recordings.intake.facts import Cells
from bayestissue.recordings.intake.names import Pattern, columns, fills


class Wanted(TomlTable):
    """The table ``[wanted]``: what a drop, and the drops of a person together, have to be.

    Attributes:
        velocity_m_s: the velocity at contact of every drop; a drop with another one is repeated.
        velocity_within: by how much it may be another, as a fraction of it.
        relative_width: how well each person's K is to be known: the square root of high over low of its 90 %
            interval, less 1; 0.05 is 5 % to either side.
    """

    velocity_m_s: Positive | None = None
    velocity_within: Annotated[float, Field(gt=0, lt=1)] = 0.05
    relative_width: Positive | None = None


class CampaignSpecification(TomlTable):
    """A whole campaign file.

    Attributes:
        name: what the dataset is called.
        like: a dataset that `bayestissue init` made of the same recorder's files, relative to the campaign
            file; signal, recorder, uncertainty, impactor and words are as there unless a table here says
            otherwise.
        pattern: how file names are read, as by `init --pattern`: "{subject}_{side}_{mass_kg}kg_{n}".
        facts: what holds for every drop of which name and order say nothing, as by `init --set`:
            drop_height_cm = 12.
        order: a table of the drops in their order, a row each, relative to the campaign file: a column for
            each fact, and `file` where rows say of which recording they are.
        files_by: what says in which order files were recorded that come together; left out, they are refused
            where their times and their names disagree.
        signal: as in dataset.toml.
        uncertainty: as in dataset.toml.
        recorder: as in dataset.toml.
        impactor: as in dataset.toml.
        words: as in dataset.toml: what lines and page call people, conditions and impacts; those of the
            dataset of `like` unless given.
        wanted: what a drop has to be, and how well K is known.
    """

    name: Annotated[str, Field(min_length=1)]
    like: str | None = None
    pattern: str | None = None
    facts: dict[str, str | float] = Field(default={})
    order: str | None = None
    files_by: Literal["times", "names"] | None = None
    signal: SignalSettings | None = None
    uncertainty: Uncertainty | None = None
    recorder: LowPassFilter | None = None
    impactor: ImpactorSettings | None = None
    words: WordSettings | None = None
    wanted: Wanted = Wanted()


@dataclass(frozen=True, eq=False)
class WatchedCampaign:
    """A campaign that can begin.

    Attributes:
        settings: what `dataset.toml` will say, as a dictionary and as it was checked.
        pattern: of file names.
        facts: that hold for all drops, as text.
        order: the facts of the drops that are wanted, in their order, as text.
        order_file: where these stand, which is no recording.
        files_by: what says in which order files were recorded that come together; None if that was not said.
        wanted: what a drop has to be.
        like: a dataset of the same recorder.
    """

    content: dict[str, Any]
    settings: Settings
    pattern: Pattern | None
    facts: dict[str, str]
    order: tuple[dict[str, str], ...]
    order_file: Path | None
    files_by: str | None
    wanted: Wanted
    like: Path | None

    @property
    def suffixes(self) -> tuple[str, ...]:
        """How names of recordings end: as the pattern does, if it says."""
        text = self.pattern.text.lower() if self.pattern else ""
        ends = [end for end in (*SUFFIXES, *TEXT_SUFFIXES) if text.endswith(end)]
        return (max(ends, key=len),) if ends else SUFFIXES

    def unknown(self, order: Sequence[Mapping[str, Any]]) -> list[str]:
        """The columns of `impacts.csv` that neither names nor order nor facts fill."""
        known = {*self.facts, *(self.pattern.fields if self.pattern else ())}
        known |= set.intersection(*map(set, order)) if order else set()
        filled = {*map(fills, known), "impact"}
        return [name for name in required_columns() if name not in filled]

    def cells(self, file: str, *further: Mapping[str, Any]) -> Cells:
        """The cells of `impacts.csv` of a recording.

        Args:
            file: its path relative to the folder.
            further: what holds of it besides, such as its row of the order; the last counts most. What its
                name says counts more than all of that, and the campaign's facts less.

        Raises:
            InputError: its name does not fit the pattern, or a number is none.
        """
        facts = dict(self.facts)
        for source in (*further, self.read(file)):
            filled = set(map(fills, source))
            facts = {name: text for name, text in facts.items() if fills(name) not in filled}
            facts |= {name: str(value) for name, value in source.items()}
        return columns(facts, file)

    def read(self, file: str) -> dict[str, str]:
        """What the name of a recording says, as text.

        Raises:
            InputError: it does not fit the pattern.
        """
        return self.pattern.read(Source(Path(file), file)) if self.pattern else {}

    def named(self, file: str) -> Cells:
        """The cells that the name of a recording fills; none where it does not fit the pattern."""
        try:
            return columns(self.read(file), file)
        except InputError:
            return {}


def read_campaign(path: Path) -> WatchedCampaign:
    """Read and check a campaign file; one without ``name`` has the file's.

    Raises:
        InputError: everything that is wrong with it, or the dataset or the order that it names.
    """
    text = read_text(path, str(path))
    raw = {"name": path.stem} | parse_toml(text, str(path))
    spec = checked(raw, CampaignSpecification, file=str(path), text=text)
    content: dict[str, Any] = {}
    like = None if spec.like is None else path.parent / spec.like
    if like is not None:
        label = str(like / SETTINGS)
        if not (like / SETTINGS).exists():
            raise InputError.stated("no-campaign.like", str(path), None, "like", spec.like)
        content = parse_toml(read_text(like / SETTINGS, label), label)
    content |= {"name": spec.name, "source": "bayestissue watch"}
    tables = ("signal", "uncertainty", "recorder", "impactor", "words")
    content |= {key: raw[key] for key in tables if key in raw}
    if "signal" not in content:
        raise InputError.stated("no-campaign.signal", str(path), None, "signal", "no table of that name")
    settings = checked(content, Settings, file=str(path), text=text)
    if settings.signal.quantity == "displacement":
        raise InputError.stated("no-campaign.quantity", str(path), None, "signal.quantity", "displacement")
    pattern = Pattern.parse(spec.pattern) if spec.pattern else None
    order_file = path.parent / spec.order if spec.order else None
    order = _order(order_file, str(spec.order)) if order_file else ()
    facts = {
        name: f"{value:.12g}" if isinstance(value, float) else str(value)
        for name, value in spec.facts.items()
    }
    columns(facts, str(path))
    return WatchedCampaign(
        content, settings, pattern, facts, order, order_file, spec.files_by, spec.wanted, like
    )


def _order(path: Path, label: str) -> tuple[dict[str, str], ...]:
    source = Source.at(path, label, remedy="Write one: a header and a row for each drop.")
    cells, rows = read_cells(source)
    records = [{str(k): str(v) for k, v in row.items() if v} for row in cells.to_dict("records")]
    problems: list[Problem] = []
    for row, record in zip(rows, records, strict=True):
        try:
            columns(record, label)
        except InputError as error:
            problems += (replace(problem, row=int(row)) for problem in error.problems)
    refuse(problems)
    return tuple(records)
