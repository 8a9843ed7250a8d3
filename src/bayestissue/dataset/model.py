"""The dataset as the rest of the program sees it: a table of impacts, and recordings in SI units."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Bool

from bayestissue.dataset.cells import FILE as IMPACTS
from bayestissue.dataset.chain import (
    ChannelQuantity,
    Contact,
    Place,
    Quantity,
    Recorder,
    Uncertainty,
)
from bayestissue.dataset.impacts import counts, of_phantoms
from bayestissue.dataset.traces import Traces
from bayestissue.errors import Problem
from bayestissue.outline import Outlined, Rows, counted, short, span


@dataclass(frozen=True, eq=False)
class Channel:
    """A further channel of the same impacts, as ``[[channel]]`` of ``dataset.toml`` declares it.

    A force F is that on what lies behind the sensor: of an impactor of mass M with the sensor behind a tip of
    mass m, F = (M - m) d; below the tissue, F = M d. d is the deceleration that `Dataset.traces` have, which
    along gravity is force over mass.

    Attributes:
        name: what pages and messages call it.
        quantity: what was recorded.
        place: where: "impactor" or "base".
        traces: the recordings, in the order of the dataset's impacts, on the first channel's clock; a force
            in N, positive while the impactor slows.
        relative_gain_sd: standard deviation of its sensitivity, as a fraction of it; one error for all
            impacts.
        tip_mass_kg: m.
        recorder: a known low-pass that it went through; None where nothing was declared.
    """

    name: str
    quantity: ChannelQuantity
    place: Place
    traces: Traces
    relative_gain_sd: float = 0.0
    tip_mass_kg: float = 0.0
    recorder: Recorder | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "traces", Traces.of(self.traces))

    def part(self, rows: slice | list[int]) -> Channel:
        """Of some of the impacts."""
        return replace(self, traces=self.traces[rows])

    def __str__(self) -> str:
        behind = f", behind a tip of {self.tip_mass_kg:g} kg" if self.tip_mass_kg else ""
        filtered = f", {self.recorder}" if self.recorder else ""
        return f"{self.name}: {self.quantity} at the {self.place}{behind}{filtered}"


@dataclass(frozen=True, eq=False, repr=False)
class Dataset(Outlined):
    """A checked dataset.

    Attributes:
        name: what ``dataset.toml`` calls it.
        description: free text.
        impacts: one row per impact: ``impact``, ``subject``, ``trial``, ``mass_kg``, ``velocity_m_s``
            (missing where a displacement was recorded without one) and the covariates.
        traces: the recordings, in the order of ``impacts``; any sequence of `Trace` will do.
        quantity: what was recorded; the sign of ``traces`` follows from it.
        uncertainty: of the measuring chain.
        warnings: what looks odd but stops nothing.
        left_out: what was wrong with the impacts that ``skip_bad`` left out.
        folder: where it was read from; none if it was made from arrays.
        input_hash: SHA-256 over the files that were read, or over the arrays.
        words: the table ``[words]``, what pages call people, conditions and impacts: see
            `bayestissue.words.Words`.
        whole_hash: of a folder, the same but for ``left_out.csv``: it stays when an impact is left out.
        licence: on what terms others may use it.
        source: where it comes from.
        site: what was hit, one of `bayestissue.literature.SITES`; empty where that was not stated.
        recorder: a known low-pass that the recordings went through; none where nothing was declared.
        gravity: g, the part of gravity along the motion, m/s², positive into the tissue; 0 of a horizontal
            impact. The impactor obeys x'' = g - F / M, and a deceleration in ``traces`` is F / M = g - x'',
            which is 0 in free fall; an acceleration is its negative. A sensor whose zero is at rest reads
            g less of it, which was added as the recordings were read.
        headform: whether the impactor stands for a head.
        contact: where contact falls, "between" samples or "on_sample"; None where nothing was declared.
        table: what messages call the table that ``impacts`` was read from.
        rows: of each impact, by its name, the row there; none where it was read from no table.
        channels: further channels of the same impacts.
    """

    name: str
    description: str
    impacts: pd.DataFrame
    traces: Traces
    quantity: Quantity
    uncertainty: Uncertainty
    warnings: tuple[Problem, ...]
    left_out: tuple[Problem, ...]
    folder: Path | None
    input_hash: str
    licence: str = ""
    source: str = ""
    site: str = ""
    recorder: Recorder | None = None
    gravity: float = 0.0
    headform: bool = False
    whole_hash: str = ""
    words: Mapping[str, str] = field(default_factory=dict)
    contact: Contact | None = None
    table: str = IMPACTS
    rows: Mapping[str, int] = field(default_factory=dict)
    channels: tuple[Channel, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "traces", Traces.of(self.traces))

    def part(self, rows: slice | list[int]) -> Dataset:
        """The dataset of some of its impacts, by their position."""
        return replace(
            self,
            impacts=self.impacts.iloc[rows],
            traces=self.traces[rows],
            channels=tuple(channel.part(rows) for channel in self.channels),
        )

    @property
    def people(self) -> Dataset:
        """The dataset without impacts of springs and phantoms of known stiffness."""
        known = of_phantoms(self.impacts)
        return self.of(~known) if known.any() else self

    def of(self, chosen: Bool[np.ndarray, " impact"]) -> Dataset:
        """The dataset of the chosen impacts alone, numbered anew."""
        part = self.part(np.flatnonzero(chosen).tolist())
        return replace(part, impacts=part.impacts.reset_index(drop=True))

    def cell(self, key: str, impact: str, column: str, value: object, **numbers: object) -> Problem:
        """What is wrong with a cell of the table of impacts, with its row there.

        Args:
            key: of the message, whose sentences are of ``numbers`` too: see `Problem.stated`.
            impact: whose cell it is.
            column: of the cell.
            value: what was found.
            numbers: in the message.
        """
        row = self.rows.get(impact)
        return Problem.stated(key, self.table, row, column, value, impact=impact, **numbers)

    def write(self, path: str | Path, *, overwrite: bool = False) -> Path:
        """Write the dataset as a folder that `read_dataset` reads back equal, whole or not at all.

        Recordings go into one long table, in SI units; so a column ``trace`` of ``impacts`` is left out.

        Args:
            path: a folder that is new or empty.
            overwrite: replace what an earlier `write` put there, if it was not changed since.

        Returns:
            ``path``.

        Raises:
            InputError: ``path`` is taken, or is no place for a dataset.
        """
        from bayestissue.dataset.write import write_dataset
        from bayestissue.results import claim

        free_text = {
            name: getattr(self, name) for name in ("name", "description", "licence", "source", "site")
        }
        unit = "m" if self.quantity == "displacement" else "m/s^2"
        settings = {name: text for name, text in free_text.items() if text} | {
            "signal": {"quantity": self.quantity, "unit": unit, "gravity": self.gravity or "none"},
            "uncertainty": self.uncertainty.settings(),
        }
        if self.headform:
            settings["impactor"] = {"headform": True}
        if self.words:
            settings["words"] = dict(self.words)
        if self.contact is not None:
            settings["signal"] |= {"contact": self.contact}
        settings["signal"] |= _limit(self.traces)
        if self.recorder is not None:
            settings["recorder"] = self.recorder.settings()
        names = pd.Index(self.impacts["impact"])
        further = {
            f"{channel.quantity}.csv.gz": long_table(names, channel.traces) for channel in self.channels
        }
        if further:
            settings["channel"] = [
                channel_settings(channel) | {"file": file}
                for channel, file in zip(self.channels, further, strict=True)
            ]
        traces = long_table(names, self.traces)
        impacts, folder = self.impacts.drop(columns="trace", errors="ignore"), Path(path)
        with (
            claim(folder, overwrite=overwrite, command="write", inputs=(self.folder,)) as target,
            target.folder() as staging,
        ):
            write_dataset(staging, settings=settings, impacts=impacts, traces=traces, further=further)
        return folder

    def _outline(self) -> tuple[str, Rows]:
        left_out = len({problem.impact for problem in self.left_out})
        said = [counted(len(self.warnings), "warning")] if self.warnings else []
        said += [f"{counted(left_out, 'impact')} left out"] if left_out else []
        rows = [
            ("impacts", counts(self.impacts)),
            (
                "recorded",
                f"{self.quantity}, {span(self.traces.n_samples, 'samples each')}, "
                f"{span(1 / self.traces.interval, 'Hz')}",
            ),
            *(("further channel", str(channel)) for channel in self.channels),
            *([("low-pass", str(self.recorder))] if self.recorder else []),
            *([("gravity along the motion", f"{self.gravity:.4g} m/s²")] if self.gravity else []),
            *([("site", self.site)] if self.site else []),
            *([("impactor", "a headform")] if self.headform else []),
            ("mass", span(self.impacts["mass_kg"], "kg")),
            ("velocity", span(self.impacts["velocity_m_s"], "m/s")),
        ]
        return f"Dataset {short(self.name)}", [*rows, *([("look at", ", ".join(said))] if said else [])]


def _limit(traces: Traces) -> dict[str, float]:
    """The key ``limit`` of recordings that reach one."""
    if traces.clipped is None or not traces.clipped.any():
        return {}
    return {"limit": float(np.abs(traces.value[traces.clipped != 0]).min())}


def long_table(impacts: pd.Index, traces: Traces) -> pd.DataFrame:
    """All samples in one table: ``impact``, ``time_s`` and ``value``."""
    codes = pd.Categorical.from_codes(traces.owner, impacts)
    return pd.DataFrame({"impact": codes, "time_s": traces.time_s, "value": traces.value})


def channel_settings(channel: Channel) -> dict[str, Any]:
    """The keys of a table ``[[channel]]``, but for where its values stand."""
    known = {name: getattr(channel, name) for name in ("relative_gain_sd", "tip_mass_kg")}
    stated = {"name": channel.name, "quantity": channel.quantity, "place": channel.place, "unit": "N"}
    recorder = {} if channel.recorder is None else {"recorder": channel.recorder.settings()}
    return stated | _limit(channel.traces) | {n: value for n, value in known.items() if value} | recorder
