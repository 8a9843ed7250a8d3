"""The dataset as the rest of the program sees it: a table of impacts, and recordings in SI units."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from bayestissue.base.errors import Problem
from bayestissue.base.outline import Outlined, Rows, counted, short, span
from bayestissue.recordings.dataset.cells import FILE as IMPACTS
from bayestissue.recordings.dataset.dataset_file import (
    ChannelSettings,
    Contact,
    LowPassFilter,
    Quantity,
    Settings,
    SignalSettings,
    Uncertainty,
)
from bayestissue.recordings.dataset.impact_table import counts, of_phantoms
from bayestissue.recordings.dataset.ragged_traces import BoolPerImpact, Traces, at_limit


@dataclass(frozen=True, eq=False, repr=False)
class Dataset(Outlined):
    """A checked dataset.

    A force F beside the first channel is that on what lies behind its sensor: of an impactor of mass M with
    the sensor behind a tip of mass m, F = (M - m) d; below the tissue, F = M d. d is the deceleration that
    ``traces`` have, which along gravity is force over mass.

    Attributes:
        settings: what ``dataset.toml`` says, of recordings in SI units.
        impacts: one row per impact: ``impact``, ``subject``, ``trial``, ``mass_kg``, ``velocity_m_s``
            (missing where a displacement was recorded without one) and the covariates.
        traces: the recordings, in the order of ``impacts``; any sequence of `Trace` will do.
        further: those of each further channel of the same impacts, on the first channel's clock; a force in
            N, positive while the impactor slows.
        warnings: what looks odd but stops nothing.
        left_out: what was wrong with the impacts that ``skip_bad`` left out.
        folder: where it was read from; none if it was made from arrays.
        input_hash: SHA-256 over the files that were read, or over the arrays.
        whole_hash: of a folder, the same but for ``left_out.csv``: it stays when an impact is left out.
        table: what messages call the table that ``impacts`` was read from.
        rows: of each impact, by its name, the row there; none where it was read from no table.
    """

    settings: Settings
    impacts: pd.DataFrame
    traces: Traces
    further: tuple[Traces, ...] = ()
    warnings: tuple[Problem, ...] = ()
    left_out: tuple[Problem, ...] = ()
    folder: Path | None = None
    input_hash: str = ""
    whole_hash: str = ""
    table: str = IMPACTS
    rows: Mapping[str, int] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """What ``dataset.toml`` calls it."""
        return self.settings.name

    @property
    def description(self) -> str:
        """Free text."""
        return self.settings.description

    @property
    def licence(self) -> str:
        """On what terms others may use it."""
        return self.settings.licence

    @property
    def source(self) -> str:
        """Where it comes from."""
        return self.settings.source

    @property
    def site(self) -> str:
        """What was hit, one of `bayestissue.base.literature.SITES`; empty where that was not stated."""
        return self.settings.site

    @property
    def headform(self) -> bool:
        """Whether the impactor stands for a head."""
        return self.settings.impactor.headform

    @property
    def quantity(self) -> Quantity:
        """What was recorded; the sign of ``traces`` follows from it."""
        return self.settings.signal.quantity

    @property
    def contact(self) -> Contact | None:
        """Where contact falls, "between" samples or "on_sample"; None where nothing was declared."""
        return self.settings.signal.contact

    @property
    def gravity(self) -> float:
        """g, the part of gravity along the motion, m/s², positive into the tissue; 0 of a horizontal impact.

        The impactor obeys x'' = g - F / M, and a deceleration in ``traces`` is F / M = g - x'', which is 0 in
        free fall; an acceleration is its negative. A sensor whose zero is at rest reads g less of it, which
        was added as the recordings were read.
        """
        return self.settings.signal.gravity_m_s2

    @property
    def uncertainty(self) -> Uncertainty:
        """Standard deviations of the measuring chain."""
        return self.settings.uncertainty

    @property
    def recorder(self) -> LowPassFilter | None:
        """A known low-pass that the recordings went through; none where nothing was declared."""
        return self.settings.recorder

    @property
    def channels(self) -> tuple[ChannelSettings, ...]:
        """What is declared of each of ``further``."""
        return self.settings.channel

    @property
    def words(self) -> dict[str, str]:
        """What pages call people, conditions and impacts: see `bayestissue.base.words.Words`."""
        return self.settings.words.values()

    def with_settings(self, **stated: Any) -> Dataset:
        """The same recordings of a dataset that states something else, by keys of ``[signal]`` or tables."""
        of_signal = {key: stated.pop(key) for key in SignalSettings.model_fields if key in stated}
        signal = self.settings.signal.model_copy(update=of_signal)
        return replace(self, settings=self.settings.model_copy(update={**stated, "signal": signal}))

    def __post_init__(self) -> None:
        object.__setattr__(self, "traces", Traces.of(self.traces))
        object.__setattr__(self, "further", tuple(map(Traces.of, self.further)))

    def select(self, which: slice | list[int] | BoolPerImpact) -> Dataset:
        """The dataset of some of its impacts, by their position or a truth value each, numbered anew."""
        return replace(
            self,
            impacts=self.impacts.iloc[which].reset_index(drop=True),
            traces=self.traces[which],
            further=tuple(traces[which] for traces in self.further),
        )

    @property
    def people(self) -> Dataset:
        """The dataset without impacts of springs and phantoms of known stiffness."""
        known = of_phantoms(self.impacts)
        return self.select(~known) if known.any() else self

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
        from bayestissue.base.results.output_folder import claim
        from bayestissue.recordings.dataset.write import write_dataset

        names = pd.Index(self.impacts["impact"])
        settings, signal = self.settings.stated(), self.settings.signal
        settings["signal"] |= _limit(self.traces, signal)
        further = {}
        of_channels = zip(settings.get("channel", ()), self.channels, self.further, strict=True)
        for stated, channel, traces in of_channels:
            stated |= _limit(traces, channel.as_signal(signal))
            further[channel.file] = long_table(names, traces)
        tables: Any = {"traces": long_table(names, self.traces), "further": further}
        impacts, folder = self.impacts.drop(columns="trace", errors="ignore"), Path(path)
        with (
            claim(folder, overwrite=overwrite, command="write", inputs=(self.folder,)) as target,
            target.folder() as staging,
        ):
            write_dataset(staging, settings=settings, impacts=impacts, **tables)
        return folder

    def _outline(self) -> tuple[str, Rows]:
        left_out = len({problem.impact for problem in self.left_out})
        said = [counted(len(self.warnings), "warning")] if self.warnings else []
        said += [f"{counted(left_out, 'impact')} left out"] if left_out else []
        samples = span(self.traces.n_samples, "samples each")
        rows = [
            ("impacts", counts(self.impacts)),
            ("recorded", f"{self.quantity}, {samples}, {span(1 / self.traces.interval, 'Hz')}"),
            *(("further channel", str(channel)) for channel in self.channels),
            *([("low-pass", str(self.recorder))] if self.recorder else []),
            *([("gravity along the motion", f"{self.gravity:.4g} m/s²")] if self.gravity else []),
            *([("site", self.site)] if self.site else []),
            *([("impactor", "a headform")] if self.headform else []),
            ("mass", span(self.impacts["mass_kg"], "kg")),
            ("velocity", span(self.impacts["velocity_m_s"], "m/s")),
        ]
        return f"Dataset {short(self.name)}", [*rows, *([("look at", ", ".join(said))] if said else [])]


def _limit(traces: Traces, signal: SignalSettings) -> dict[str, float]:
    """The key ``limit`` of recordings that reach one; none where it is no one limit of all of them.

    Each recording's own is then found again when they are read.
    """
    limited = np.abs(traces.value[traces.clipped != 0])
    if not limited.size:
        return {}
    limit = float(limited.min())

    def gives_the_same(stated: tuple[float, float] | None) -> bool:
        return np.array_equal(at_limit(traces, signal.quantity, stated), traces.clipped)

    of_all = gives_the_same(signal.model_copy(update={"limit": limit}).limits_si)
    return {"limit": limit} if of_all or not gives_the_same(None) else {}


def long_table(impacts: pd.Index, traces: Traces) -> pd.DataFrame:
    """All samples in one table: ``impact``, ``time_s`` and ``value``."""
    codes = pd.Categorical.from_codes(traces.owner, impacts)
    return pd.DataFrame({"impact": codes, "time_s": traces.time_s, "value": traces.value})
