"""The dataset as the rest of the program sees it: a table of impacts, and recordings in SI units."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pandas as pd
from jaxtyping import Float64

from bayestissue.errors import Problem
from bayestissue.outline import Outlined, Rows, counted, short, span

Quantity = Literal["deceleration", "acceleration", "displacement"]
STANDARD_GRAVITY = 9.80665


@dataclass(frozen=True, eq=False)
class Trace:
    """The recording of one impact.

    Attributes:
        time_s: the recorder's own time, s; 0 need not be the moment of contact.
        value: deceleration or acceleration in m/s², or displacement in m, after scale and offset. Of an
            impact along gravity a deceleration is force over mass, whatever the sensor's zero was: see
            `Dataset.gravity`.
    """

    time_s: Float64[np.ndarray, " sample"]
    value: Float64[np.ndarray, " sample"]

    def __repr__(self) -> str:
        return f"Trace of {counted(len(self.time_s), 'sample')}, {span(self.time_s, 's')}"


@dataclass(frozen=True)
class Uncertainty:
    """Standard deviations of the measuring chain; 0 where nothing was stated.

    Attributes:
        relative_mass_sd: of the impactor's mass, as a fraction of it.
        velocity_sd_m_s: of the velocity at contact, m/s.
        relative_gain_sd: of the recorder's sensitivity, as a fraction of it.
        offset_sd: of the recorder's zero, in SI units of the recorded quantity.
    """

    relative_mass_sd: float = 0.0
    velocity_sd_m_s: float = 0.0
    relative_gain_sd: float = 0.0
    offset_sd: float = 0.0

    def settings(self) -> dict[str, float]:
        """The keys of the table ``[uncertainty]`` in ``dataset.toml``."""
        return asdict(self)


FilterKind = Literal["butterworth", "bessel"]
SaeClass = Literal[60, 180, 600, 1000]
NoiseEntry = Literal["before", "after"]
Applied = Literal["analog", "digital"]


@dataclass(frozen=True)
class Recorder:
    """A known low-pass between the sensor and the file.

    Attributes:
        low_pass_hz: its -3 dB corner run once, Hz.
        order: number of its poles.
        kind: "butterworth" or "bessel"; alike for an order of 1.
        zero_phase: whether it is run forwards and backwards, which doubles its order.
        sae_class: the channel frequency class of SAE J211-1 that it is, if one was declared.
        noise: whether white noise enters before the filter, and goes through it, or after it; None where
            the quiet parts before contact have to tell.
        applied: "digital" where software ran it over the very samples of the file, "analog" where it acted
            before sampling; None where nothing was said: see `digital`.
    """

    low_pass_hz: float
    order: int = 2
    kind: FilterKind = "butterworth"
    zero_phase: bool = False
    sae_class: SaeClass | None = None
    noise: NoiseEntry | None = None
    applied: Applied | None = None

    @property
    def digital(self) -> bool:
        """Whether it is a digital filter of the samples; one of zero phase can be no other unless stated."""
        return self.zero_phase if self.applied is None else self.applied == "digital"

    def settings(self) -> dict[str, Any]:
        """The keys of the table ``[recorder]`` in ``dataset.toml``."""
        names = ("low_pass_hz", "order", "kind", "zero_phase") if self.sae_class is None else ("sae_class",)
        stated = [name for name in ("noise", "applied") if getattr(self, name) is not None]
        return {name: getattr(self, name) for name in (*names, *stated)}

    def __str__(self) -> str:
        stated = f", {self.applied}" if self.applied else ""
        stated += f", noise {self.noise} it" if self.noise else ""
        if self.sae_class is not None:
            return f"SAE class {self.sae_class}{stated}"
        directions = ", forwards and backwards" if self.zero_phase else ""
        return f"{self.kind}, order {self.order}, {self.low_pass_hz:g} Hz{directions}{stated}"


@dataclass(frozen=True, eq=False, repr=False)
class Dataset(Outlined):
    """A checked dataset.

    Attributes:
        name: what ``dataset.toml`` calls it.
        description: free text.
        impacts: one row per impact: ``impact``, ``subject``, ``trial``, ``mass_kg``, ``velocity_m_s``
            (missing where a displacement was recorded without one) and the covariates.
        traces: the recordings, in the order of ``impacts``.
        quantity: what was recorded; the sign of ``traces`` follows from it.
        uncertainty: of the measuring chain.
        warnings: what looks odd but stops nothing.
        left_out: what was wrong with the impacts that ``skip_bad`` left out.
        folder: where it was read from; none if it was made from arrays.
        input_hash: SHA-256 over the files that were read, or over the arrays.
        licence: on what terms others may use it.
        source: where it comes from.
        recorder: a known low-pass that the recordings went through; none where nothing was declared.
        gravity: g, the part of gravity along the motion, m/s², positive into the tissue; 0 of a horizontal
            impact. The impactor obeys x'' = g - F / M, and a deceleration in ``traces`` is F / M = g - x'',
            which is 0 in free fall; an acceleration is its negative. A sensor whose zero is at rest reads
            g less of it, which was added as the recordings were read.
    """

    name: str
    description: str
    impacts: pd.DataFrame
    traces: list[Trace]
    quantity: Quantity
    uncertainty: Uncertainty
    warnings: tuple[Problem, ...]
    left_out: tuple[Problem, ...]
    folder: Path | None
    input_hash: str
    licence: str = ""
    source: str = ""
    recorder: Recorder | None = None
    gravity: float = 0.0

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
        from bayestissue.dataset.write import write_whole

        return write_whole(self, Path(path), overwrite=overwrite)

    def _outline(self) -> tuple[str, Rows]:
        people, trials = (self.impacts[name].nunique() for name in ("subject", "trial"))
        count = [len(trace.time_s) for trace in self.traces]
        steps = [(trace.time_s[-1] - trace.time_s[0]) / (len(trace.time_s) - 1) for trace in self.traces]
        left_out = len({problem.impact for problem in self.left_out})
        said = [counted(len(self.warnings), "warning")] if self.warnings else []
        said += [f"{counted(left_out, 'impact')} left out"] if left_out else []
        rows = [
            ("impacts", f"{len(self.impacts)}; subjects: {people}, trials: {trials}"),
            (
                "recorded",
                f"{self.quantity}, {span(count, 'samples each')}, {span(1 / np.array(steps), 'Hz')}",
            ),
            *([("low-pass", str(self.recorder))] if self.recorder else []),
            *([("gravity along the motion", f"{self.gravity:.4g} m/s²")] if self.gravity else []),
            ("mass", span(self.impacts["mass_kg"], "kg")),
            ("velocity", span(self.impacts["velocity_m_s"], "m/s")),
        ]
        return f"Dataset {short(self.name)}", [*rows, *([("look at", ", ".join(said))] if said else [])]
