"""How good a dataset's recordings are, as one object, and what `bayestissue check` shows of it."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from bayestissue.base.errors import Coded, Problem
from bayestissue.base.outline import Rows, counted, first_of, short, span
from bayestissue.base.remedies import entries, flags
from bayestissue.base.result import Result
from bayestissue.base.results.tables import table_of_rows
from bayestissue.inference.points.notes import said_once
from bayestissue.inference.results.meanings import few_valued_words
from bayestissue.inference.single.phantoms import control_chart
from bayestissue.model.hierarchy.columns import few_valued
from bayestissue.recordings.dataset import as_dataset
from bayestissue.recordings.dataset.impact_table import counts
from bayestissue.recordings.signal import Displacements, displacements
from bayestissue.recordings.signal.displacement import FEWEST_SAMPLES
from bayestissue.recordings.signal.filters import white_share
from bayestissue.recordings.signal.force import Force, force_beside
from bayestissue.recordings.signal.quality import Findings, inspect, raised
from bayestissue.recordings.signal.quality.force_laws import suspected
from bayestissue.reports.pages.page import written
from bayestissue.reports.pages.recordings_pages import check_page, kinds, quality_table

if TYPE_CHECKING:
    from bayestissue.recordings.dataset import Dataset


@dataclass(frozen=True, eq=False, repr=False)
class Check(Result):
    """What was found on a dataset that could be read.

    Attributes:
        dataset: what was checked.
        signal: what the default signal chain makes of its recordings.
        quality: one row per impact: see `bayestissue.reports.pages.recordings_pages.quality_table`.
        warnings: what looks odd: of reading, of the signal chain, and of the detectors of spoilt recordings.
        findings: what those detectors found: see `bayestissue.recordings.signal.quality.inspect`.
        force: a force that was recorded beside it, against mass times deceleration, or of displacements its
            impulse against what the mass lost.
        phantoms: K of each impact of known stiffness as recorded: see
            `bayestissue.inference.single.phantoms.control_chart`.
    """

    command = "check"
    page_file = "check.html"
    files = ("check.html",)
    table_names = ("quality", "problems")
    about = {}  # noqa: RUF012
    dataset: Dataset
    signal: Displacements
    quality: pd.DataFrame
    warnings: tuple[Problem, ...]
    findings: Findings = field(default_factory=dict)
    force: Force | None = None
    phantoms: pd.DataFrame | None = None

    def _outline(self) -> tuple[str, Rows]:
        rows = [
            ("impacts", str(len(self.quality))),
            ("time to peak", span(self.quality["time_to_peak_s"] * 1e3, "ms")),
            ("noise over peak", span(self.quality["noise_to_peak"], "")),
            *([("force", self.force.words)] if self.force else []),
            *(("warning", short(str(group[0]), 200)) for group in kinds(self.warnings)),
            *(("note", short(words, 200)) for words in self.notes),
            ("more in", ".quality, .problems, .page()"),
        ]
        return f"Check of {short(self.dataset.name)}: {self.verdict}", rows

    @property
    def verdict(self) -> str:
        """Whether the dataset is fine, in a few words."""
        left_out = len({problem.impact for problem in self.dataset.left_out})
        warned = len(kinds(self.warnings))
        fine = f"no errors, {counted(warned, 'warning')}" if warned else "fine"
        fine += f" without the {counted(left_out, 'impact')} left out" if left_out else ""
        too_short = int((self.signal.n_below_limit < FEWEST_SAMPLES).sum())
        if not too_short:
            return fine
        of_all = counted(len(self.dataset.impacts), "impact")
        return f"{fine}, and {too_short} of {of_all} too short to be fitted (see the warnings)"

    @property
    def notes(self) -> list[str]:
        """What is not wrong, but should be known."""
        impacts = self.dataset.impacts
        one_mass = impacts["mass_kg"].min() == impacts["mass_kg"].max()
        masses = [Coded.stated("one-mass")] if one_mass else []
        codes = few_valued_words(few_valued(impacts))
        noted = raised(self.findings, len(impacts), notes=True)
        rows = zip(self.signal.notes, noted, strict=True)
        said = said_once("; ".join([*chain, *spoilt]) for chain, spoilt in rows)
        return [*masses, *codes, *said]

    @property
    def problems(self) -> pd.DataFrame:
        """What was left out, and warnings: one row each."""
        lists = [("left out", problem) for problem in self.dataset.left_out]
        lists += [("warning", problem) for problem in self.warnings]
        rows = [{"severity": severity, **problem.as_dict()} for severity, problem in lists]
        return table_of_rows("problems", rows).astype({"row": "Int64"})

    @property
    def summary(self) -> Rows:
        """What was recorded, and how well: pairs of a name and words."""
        data, quality = self.dataset, self.quality
        # Of a slow recording the window goes on to the rebound.
        to_peak = quality["time_to_peak_s"] * quality["sampling_rate_hz"] // 1 + 1
        until_peak = quality["samples_in_window"].clip(upper=to_peak)
        white = white_share(data, self.signal) if data.recorder else None
        texts = written("check", "summary", self, counts(data.impacts), until_peak, white, span)
        parts = [text.partition(":") for text in texts]
        return [(heading, words.strip()) for heading, _, words in parts]

    def as_json(self) -> dict[str, Any]:
        """Everything but the page."""
        data = self.dataset
        return {
            "dataset": data.name,
            "verdict": self.verdict,
            "impacts": len(data.impacts),
            "input_hash": data.input_hash,
            "left_out": [problem.as_dict() for problem in data.left_out],
            "warnings": [problem.as_dict() for problem in self.warnings],
            "notes": self.notes,
            **({"force": _plain(self.force)} if self.force else {}),
            "quality": json.loads(self.quality.to_json(orient="records")),
        }

    def page(self) -> str:
        """The HTML of the page with a panel for each impact."""
        return check_page(
            self.dataset,
            self.signal,
            self.quality,
            verdict=self.verdict,
            warnings=self.warnings,
            force=self.force,
            phantoms=self.phantoms,
        )


def _plain(force: Force) -> dict[str, Any]:
    (ratio, scatter), (lag, lag_sd) = force.common, force.common_lag
    lags = {} if force.impulse else {"lag_s": lag, "lag_sd_s": lag_sd}
    return {
        "channel": force.channel.name,
        "ratio": ratio,
        "ratio_sd": force.total_sd,
        "ratio_scatter": scatter,
        **lags,
        "contradicts": force.contradicts,
    }


def check(dataset: Dataset | str | Path) -> Check:
    """Look at every recording of a dataset: how good it is, and whether something spoilt it.

    Args:
        dataset: as `bayestissue.read_dataset` or `bayestissue.dataset` returns it, or its folder.
    """
    dataset = as_dataset(dataset)
    signal = displacements(dataset)
    findings = inspect(dataset)
    force = force_beside(dataset, signal)
    warnings = (
        *dataset.warnings,
        *_raised(dataset, signal, findings),
        *_disagreement(force, dataset.impacts["impact"]),
    )
    quality = quality_table(dataset, signal, warnings, force)
    return Check(dataset, signal, quality, warnings, findings, force, control_chart(dataset))


def _raised(data: Dataset, signal: Displacements, findings: Findings) -> Iterator[Problem]:
    """What the signal chain and the detectors of spoilt recordings say: the flags of `estimate`."""
    names = data.impacts["impact"]
    usable = "a recording that the default signal chain can use"
    for impact, raised_here in zip(names, signal.flags, strict=True):
        for flag in raised_here:
            yield Problem("recording", usable, f"{flag}.", impact=impact, code=flag.code)
    for kind, said in ((flags()[key], said) for key, said in findings.items() if not flags()[key].note):
        wrong = partial(Problem, "recording", kind.expected, entries()[kind.code].advice, code=kind.code)
        pairs = zip(names, said, strict=True)
        yield from (wrong(value=value, impact=impact) for impact, value in pairs if value)
    if data.recorder is None and data.quantity != "displacement":
        yield from _undeclared(names, signal)


def _disagreement(force: Force | None, names: pd.Series) -> Iterator[Problem]:
    """A force that the motion of the declared mass contradicts, with the size of what must be wrong."""
    if force is None:
        return
    stated = partial(Problem.stated, file="recording", column=force.channel.name)
    if force.lags:
        kind = "drifts" if np.isinf(force.corner_hz) else "filtered" if force.corner_hz else "late"
        yield stated(f"channels-disagree.{kind}", value=force.late)
    if force.apart.any():
        named = first_of(names[force.apart].tolist(), 5)
        yield stated("channels-disagree.apart", value=f"{force.between} ({named} apart)")
    if not force.contradicts:
        return
    ratio = force.common[0]
    key = "impulse-disagrees" if force.impulse else f"channels-disagree.{force.channel.place}"
    yield stated(
        key,
        value=f"{ratio:.3g} M V" if force.impulse else f"{ratio:.4g} M a",
        declared=f"{force.declared_sd:.2g}",
        size=f"{100 * abs(ratio - 1):.2g} %",
        mass="more" if ratio > 1 else "less",
        reads="much" if ratio > 1 else "little",
    )


def _undeclared(names: pd.Series, signal: Displacements) -> Iterator[Problem]:
    """A low-pass that the rise at contact shows, where none is declared, and what it costs (median)."""
    suspicion = suspected(signal)
    rows = np.flatnonzero(np.isfinite(suspicion.corner_hz))
    if not rows.size:
        return
    medians = {"K": np.median(suspicion.change_K[rows]), "C": np.median(suspicion.change_C[rows])}
    changes = [f"{q} {abs(by):.0%} too {'small' if by < 0 else 'large'}" for q, by in medians.items()]
    words: dict[str, Any] = {"changes": " and ".join(changes)}
    for row in rows:
        rise = f"a rise as behind a second-order low-pass of {suspicion.corner_hz[row]:.2g} Hz"
        yield Problem.stated("undeclared-low-pass", "recording", value=rise, impact=names.iloc[row], **words)
