"""The pages of `check` and `init`: a small panel for each recording, and what is to be known of it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pandas as pd

from bayestissue.base.errors import Problem, by_cause
from bayestissue.base.outline import first_of
from bayestissue.base.words import Words
from bayestissue.recordings.dataset import Dataset
from bayestissue.recordings.signal import Displacements
from bayestissue.recordings.signal.force import Force
from bayestissue.reports.figures.intervals import intervals
from bayestissue.reports.figures.theme import Figure
from bayestissue.reports.figures.traces import CONTACT, PEAK, TURN, against, panels, thinned
from bayestissue.reports.pages.page import render_page
from bayestissue.reports.pages.page_settings import LIMITS
from bayestissue.reports.pages.page_tables import frame_table, table_of_cells
from bayestissue.reports.pages.wording import SENTENCES, names_in

# Time [ms] and value of each curve and event, by kind.
type Panel = dict[str, tuple[Any, Any]]


def sheets(
    dataset: Dataset,
    which: np.ndarray,
    panel: Callable[[int], Panel],
    time: str,
    value: str,
    words: str,
    *,
    domain: tuple[float, float] | None = None,
) -> list[Figure]:
    """Figures of a panel for each impact, twelve in one.

    Args:
        dataset: of the impacts.
        which: rows of those to show.
        panel: what an impact's shows.
        time: title of the time axes.
        value: title of the others.
        words: what a panel shows, before "for the impacts" and their names.
        domain: ends of the axes of values; each panel's own unless given.
    """
    names = list(dataset.impacts["impact"].astype(str))

    def curves(index: int) -> Iterator[pd.DataFrame]:
        shown = panel(index)
        for kind, (times, values) in shown.items():
            times, values = np.atleast_1d(times), np.atleast_1d(values)
            samples = thinned(values, max(LIMITS.samples // (len(which) * len(shown)), 40))
            yield pd.DataFrame({"time_ms": times[samples], "value": values[samples]}).assign(
                impact=names[index], kind=kind
            )

    def sheet(part: np.ndarray) -> Figure:
        rows = pd.concat([one for index in part for one in curves(int(index))], ignore_index=True)
        shown = ", ".join(names[index] for index in part)
        return panels(rows, time, value, f"{words} for the impacts {shown}.", domain=domain)

    return [sheet(which[begin : begin + LIMITS.panels]) for begin in range(0, len(which), LIMITS.panels)]


MOST_CHECK_PANELS = 216
_UNITS = {"deceleration": "m_s2", "acceleration": "m_s2", "displacement": "m"}


def quality_table(
    dataset: Dataset, signal: Displacements, warnings: Sequence[Problem], force: Force | None = None
) -> pd.DataFrame:
    """How good each recording is, one row per impact.

    Columns: ``impact``, ``subject``, ``trial``; ``n_samples`` recorded and ``sampling_rate_hz``; ``offset``
    (taken off), ``noise_sd`` and ``peak`` (greatest deceleration, or greatest displacement since contact)
    with the unit in their names, and ``noise_to_peak``; ``samples_at_peak``, how many samples share the
    extreme value (many of them mean a recorder near its limit); ``contact_time_s`` on the recorder's clock
    and ``contact_time_sd_s``; ``time_to_peak_s``, ``peak_displacement_m`` and ``samples_in_window`` from
    contact to zero velocity; of a force beside decelerations ``force_ratio``, over mass times deceleration,
    its standard error ``force_ratio_sd`` and ``force_lag_s``; ``warnings``.

    Args:
        dataset: the recordings.
        signal: what the default signal chain made of them, in the same order.
        warnings: what looks odd.
        force: beside it, if there is one.
    """
    highest = [_upwards(dataset, row, offset) for row, offset in enumerate(signal.quiet.offset)]
    peak = np.array([values.max() for values in highest])
    unit = _UNITS[dataset.quantity]
    of_force = {}
    if force is not None:
        of_force = {"force_ratio": force.ratio, "force_ratio_sd": force.ratio_sd, "force_lag_s": force.lag}
    impacts, said = dataset.impacts, Counter(problem.impact for problem in warnings)
    return pd.DataFrame(
        {
            **{name: impacts[name] for name in ("impact", "subject", "trial")},
            "n_samples": [values.size for values in highest],
            "sampling_rate_hz": 1 / dataset.traces.interval,
            f"offset_{unit}": signal.quiet.offset,
            f"noise_sd_{unit}": signal.quiet.noise_sd,
            f"peak_{unit}": peak,
            "noise_to_peak": signal.quiet.noise_sd / peak,
            "samples_at_peak": [int(np.count_nonzero(values == values.max())) for values in highest],
            "contact_time_s": signal.contact_time_s,
            "contact_time_sd_s": signal.contact.sd,
            "time_to_peak_s": signal.time_to_peak,
            "peak_displacement_m": signal.stop.x,
            "samples_in_window": signal.n_samples,
            **of_force,
            "warnings": impacts["impact"].map(said),
        }
    )


def _upwards(dataset: Dataset, row: int, offset: float = 0.0) -> np.ndarray:
    """A recording, its peak pointing up.

    Args:
        dataset: of the recordings.
        row: of its impact.
        offset: what the recorder shows of no deceleration, to be taken off.
    """
    return dataset.traces[[row]].slowing(dataset.quantity).value - offset


def check_page(
    dataset: Dataset,
    signal: Displacements,
    quality: pd.DataFrame,
    *,
    verdict: str,
    warnings: Sequence[Problem],
    force: Force | None = None,
    phantoms: pd.DataFrame | None = None,
) -> str:
    """The whole page: verdict, what was found, a panel per impact, and the table of `quality_table`.

    With more than 216 impacts only the most suspicious ones, by warnings and then by noise, get a panel,
    and the page says so.
    """
    order = quality.sort_values(["warnings", "noise_to_peak"], ascending=False, kind="stable").index
    shown = np.sort(order[:MOST_CHECK_PANELS].to_numpy())
    return render_page(
        "check.html",
        dataset=dataset,
        verdict=verdict,
        nouns=_nouns(dataset),
        total=len(quality),
        shown=len(shown),
        sheets=sheets(
            dataset,
            shown,
            partial(_check_panel, dataset=dataset, signal=signal),
            "since contact (ms)",
            "share of greatest",
            "Recording, velocity and displacement over time",
            domain=(-0.4, 1.15),
        ),
        force=force,
        force_figure=force and _force_figure(force, list(dataset.impacts["impact"].astype(str)), shown),
        phantoms=phantoms is not None and _control_chart(phantoms),
        phantom_table=phantoms is not None and frame_table(phantoms.rename(columns={"label": "impact"})),
        problems=table_of_cells(
            [*_problems("left out", dataset.left_out), *_problems("warning", warnings)],
            *("severity", "impacts", "what"),
            words=("impacts", "what"),
        ),
        codes=[problem.code for problem in (*dataset.left_out, *warnings)],
        quality=frame_table(quality.loc[shown].rename(columns=lambda name: name.replace("_", " "))),
    )


def _check_panel(index: int, *, dataset: Dataset, signal: Displacements) -> Panel:
    trace, n = dataset.traces[index], int(signal.n_samples[index])
    raw = _upwards(dataset, index, signal.quiet.offset[index])
    time = 1e3 * (trace.time_s - signal.contact_time_s[index])
    inside = 1e3 * signal.since_contact_s[index, :n]
    to_peak = 1e3 * signal.time_to_peak[index]
    last = 3 * to_peak
    near = (time > -to_peak) & (time < last)
    near |= ~near.any()
    curves = {
        f"recorded {dataset.quantity}": (time[near], raw[near]),
        "velocity": (inside, signal.v[index, :n]),
        "displacement": (inside, signal.x[index, :n]),
    }
    for traces in dataset.further:
        recorded = traces[index]
        since = 1e3 * (recorded.time_s - signal.contact_time_s[index])
        around = (since > -to_peak) & (since < last)
        curves["recorded force"] = (since[around], recorded.value[around])
    shown: Panel = {
        kind: (times, values / (np.abs(values).max(initial=0) or 1))
        for kind, (times, values) in curves.items()
    }
    return shown | {CONTACT: (0.0, 0.0), TURN: (to_peak, 0.0)}


def _control_chart(phantoms: pd.DataFrame) -> Figure:
    """K of springs and phantoms over the known one, from the top in their order."""
    limit = float(phantoms["limit"].max())
    return intervals(
        phantoms.drop(columns="limit").dropna().rename(columns={"low": "eti90_low", "high": "eti90_high"}),
        "K as recorded, over the known K",
        "K of each impact of known stiffness over that stiffness, with its 90 % interval.",
        lines=(1.0,),
        band=(1 - limit, 1 + limit),
        straight=True,
    )


def _force_figure(force: Force, names: Sequence[str], rows: np.ndarray) -> Figure:
    """F against M a of these impacts, or their impulses."""
    samples_inside = [(row, np.flatnonzero(force.inside[row])) for row in rows]
    most = max(LIMITS.samples // max(len(samples_inside), 1), 20)
    curves = pd.concat(
        pd.DataFrame(
            {
                "impact": names[row],
                "number": np.arange(len(samples)),
                "expected": force.expected[row, samples],
                "recorded": force.value[row, samples],
            }
        )
        for row, inside in samples_inside
        if len(samples := inside[:: max(1, len(inside) // most)])
    )
    return against(curves, *SENTENCES["force_against"]["impulse" if force.impulse else "force"])


def kinds(problems: Sequence[Problem]) -> list[list[Problem]]:
    """Problems grouped by code, column and remedy: one slip in many impacts or files is one entry."""
    groups: dict[tuple[object, ...], list[Problem]] = {}
    for problem in problems:
        groups.setdefault((problem.code, problem.column, problem.remedy), []).append(problem)
    return list(groups.values())


def _problems(severity: str, problems: Sequence[Problem]) -> list[tuple[str, str, str]]:
    rows = []
    for group in kinds(problems):
        impacts = list(dict.fromkeys(problem.impact for problem in group if problem.impact))
        rows.append((severity, first_of(impacts, 12), str(replace(group[0], impact=None))))
    return rows


MOST_INIT_PANELS = 120


def init_page(
    dataset: Dataset,
    signal: Displacements,
    *,
    understood: Sequence[tuple[str, str]],
    left_out: Sequence[Problem],
    notes: Sequence[str],
) -> str:
    """The whole page: what was understood, a panel for each impact, and the table of impacts.

    Args:
        dataset: as it was read back.
        signal: its decelerations and displacements.
        understood: pairs of a heading and words.
        left_out: what was wrong with recordings that are not in the dataset.
        notes: what somebody should know who does not look at the panels.
    """
    total = len(dataset.impacts)
    which = np.arange(min(total, MOST_INIT_PANELS))
    return render_page(
        "init.html",
        dataset=dataset,
        nouns=_nouns(dataset),
        understood=table_of_cells(understood, "what", "understood as", words=("understood as",)),
        notes=notes,
        left_out=[str(problem) for problem in by_cause(left_out)],
        codes=[problem.code for problem in left_out],
        shown=len(which),
        total=total,
        sheets=sheets(
            dataset,
            which,
            partial(_init_panel, dataset=dataset, signal=signal),
            "recorder's clock (ms)",
            "displacement (mm)" if dataset.quantity == "displacement" else "deceleration (m/s²)",
            "Recording with contact and peak",
        ),
        impacts=frame_table(dataset.impacts.dropna(axis="columns", how="all"), digits=6),
    )


def _nouns(dataset: Dataset) -> Words:
    return Words(dataset.words, {dataset.name, dataset.description, *names_in(dataset.impacts, ())})


def _init_panel(index: int, *, dataset: Dataset, signal: Displacements) -> Panel:
    trace = dataset.traces[index]
    unit = 1e3 if dataset.quantity == "displacement" else 1.0
    time, value = 1e3 * trace.time_s, unit * _upwards(dataset, index)
    contact, to_peak = 1e3 * signal.contact_time_s[index], 1e3 * signal.time_to_peak[index]
    near = (time > contact - 2 * to_peak) & (time < contact + 4 * to_peak)
    near |= ~near.any()
    peak = int(np.argmax(value))
    shown: Panel = {"recorded": (time[near], value[near])}
    channels = zip(dataset.channels, dataset.further, strict=True)
    for channel, traces in channels if dataset.quantity != "displacement" else ():
        force_trace = traces[index]
        then = 1e3 * force_trace.time_s
        around = (then >= time[near][0]) & (then <= time[near][-1])
        behind = float(signal.mass[index]) - channel.tip_mass_kg
        shown["force over mass"] = (then[around], force_trace.value[around] / behind)
    return shown | {CONTACT: (contact, 0.0), PEAK: (time[peak], value[peak])}
