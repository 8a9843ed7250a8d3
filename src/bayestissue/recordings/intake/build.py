"""From files and facts to a dataset folder, read back and checked before anybody sees it."""

from __future__ import annotations

import shutil
from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
import pandas as pd

from bayestissue.base.errors import InputError, Problem, collected, refuse
from bayestissue.base.outline import counted, first_of
from bayestissue.recordings.dataset import Dataset, Trace, read_dataset, write_dataset
from bayestissue.recordings.dataset.dataset_file import FILE as SETTINGS
from bayestissue.recordings.dataset.dataset_file import Settings, parse_settings, reworded
from bayestissue.recordings.dataset.dialect import Stated
from bayestissue.recordings.dataset.left_out import NEVER_READ, reason_of, write_left_out
from bayestissue.recordings.dataset.ragged_traces import MIN_SAMPLES
from bayestissue.recordings.dataset.recorders import read_one
from bayestissue.recordings.dataset.recordings import CROP, ends_of
from bayestissue.recordings.dataset.source_files import Source
from bayestissue.recordings.intake.choices import PLACES, Choices, Cutting, require_steady, said
from bayestissue.recordings.intake.facts import Facts
from bayestissue.recordings.intake.folder import RecorderFile, RecorderFolder
from bayestissue.recordings.signal.displacement import Displacements, displacements
from bayestissue.recordings.signal.padded_traces import noise_sd, stack
from bayestissue.recordings.signal.signal_settings import CONTACT

RECORDINGS = "recordings"
FIRST = ("impact", "subject", "trial", "mass_kg", "velocity_m_s")
_OPTIONS = {
    **{key: f"--{name.replace('_', '-')}" for name, key in PLACES.items()},
    **{f"signal.{key}": f"--text {key}" for key in Stated.model_fields},
}
# Of a key of dataset.toml in a sentence: there is no such file yet.
_NAMES = {
    before + key + where: f"by {option}" if before else option
    for key, option in _OPTIONS.items()
    if "." in key
    for before, where in (("as ", f" in {SETTINGS}"), ("", f" in {SETTINGS}"), ("", ""))
}


@dataclass(frozen=True, eq=False)
class Built:
    """A dataset that was written and read back.

    Attributes:
        dataset: as it was read.
        signal: its decelerations and displacements.
        left_out: what was wrong with files and impacts that are not in it.
        notes: what somebody should know who did not look at the recordings.
    """

    dataset: Dataset
    signal: Displacements
    left_out: tuple[Problem, ...]
    notes: tuple[str, ...]


def build(folder: Path, recordings: RecorderFolder, facts: Facts, choices: Choices) -> Built:
    """Write ``dataset.toml``, ``impacts.csv`` and the recordings, byte for byte as they are, and check them.

    Args:
        folder: where the dataset goes.
        recordings: the files.
        facts: what is known of each.
        choices: with no question left, and a name of the dataset.

    Raises:
        InputError: everything that is wrong, with the files, with what is known of them, and with the dataset
            that they make.
    """
    problems = [*recordings.problems, *facts.problems]
    settings = choices.content(f"bayestissue init, from {counted(len(recordings.files), 'recorder file')}")
    try:
        parsed = parse_settings(settings)
    except InputError as error:
        options = [replace(p, file="init", column=_option_of(p.column or "")) for p in error.problems]
        raise InputError([*problems, *options]) from None
    plan = _Plan(recordings, facts, choices, settings, parsed)
    rows = list(plan.rows(problems))
    if not rows:
        raise InputError(problems)
    try:
        dataset = plan.dataset(folder, rows)
    except InputError as error:
        if mended := _of_another_force(choices, error.problems):
            revised, notes = mended
            built = build(folder, recordings, facts, revised)
            return replace(built, notes=(*built.notes, *notes))
        problems += plan.in_terms_of_init(error.problems, rows)
    if problems:
        rows = plan.fit_to_use(rows, problems) if choices.skip_bad else []
        if not rows:
            raise InputError(problems)
        dataset = plan.dataset(folder, rows, problems)
    signal = displacements(dataset)
    return Built(dataset, signal, tuple(problems), tuple(_notes(dataset, signal, choices)))


def _of_another_force(choices: Choices, problems: Iterable[Problem]) -> tuple[Choices, list[str]] | None:
    """Choices with the force turned or left out, and what to say of that; None where it is not to blame.

    A force that nobody asked for must not cost an impact.
    """
    unfit = [problem for problem in problems if problem.column == choices.beside.get("value_column", "")]
    if choices.force or not unfit:
        return None
    if {problem.code for problem in unfit} == {"channel-unfit"} and "scale" not in choices.beside:
        return choices.stating(beside=choices.beside | {"scale": -1.0}), []
    note = said("notes.unfit", channel=unfit[0].column, why=_in_terms_of_init(unfit[0]))
    return choices.stating(beside={}), [note]


def _impact_name(file: Source) -> str:
    """What the impact of a recording is called."""
    return f"{file.stem}_{file.part}" if file.part else file.stem


def _option_of(key: str) -> str | None:
    """The option that states a key or an entry of [recorder] or [[channel]]; of others the key."""
    table, _, name = key.partition(".")
    if table == "channel":
        return f"--force {name.removeprefix('0').removeprefix('.')}".strip()
    return _OPTIONS.get(key) or (f"--recorder {name}" if table == "recorder" else key or None)


def _in_terms_of_init(problem: Problem) -> Problem:
    """A problem of the dataset in the words of who has not seen it yet: their files, their options."""
    files = {"impacts.csv": "impacts.csv as init would write it"}
    problem = reworded(problem, files, _NAMES)
    return replace(problem, file=problem.file.removeprefix(f"{RECORDINGS}/"))


def _notes(dataset: Dataset, signal: Displacements, choices: Choices) -> Iterator[str]:
    oriented = dataset.traces.slowing(dataset.quantity)
    traces = dict(zip(map(str, dataset.impacts["impact"]), oriented, strict=True))
    several = [] if choices.several else [impact for impact, trace in traces.items() if len(cut(trace)) > 1]
    if several:
        yield said("notes.several", impacts=first_of(several, 5))
    threshold = choices.threshold if choices.several else Cutting.threshold
    later = {name: blow_again(traces[name], threshold=threshold) for name in traces if name not in several}
    again = {impact: seconds for impact, seconds in later.items() if seconds is not None}
    if again:
        soonest = min(again.values())
        yield said("notes.again", impacts=first_of(list(again), 5), seconds=soonest, apart=soonest / 2)
    if not any(dataset.uncertainty.model_dump().values()):
        yield said("notes.chain")
    if choices.beside and not choices.force:
        force = choices.beside
        words = said("notes.force", channel=force["value_column"], place=force["place"])
        yield words + (said("notes.turned") if "scale" in force else "")
    if _contact_untold(dataset, signal):
        yield said("notes.contact")


def _contact_untold(dataset: Dataset, signal: Displacements) -> bool:
    """Whether somebody has to say where contact falls within a sampling interval, as the recordings do not.

    Most that begin at contact do not, whatever they look like: a force that jumps may have jumped earlier.
    """
    if dataset.contact or dataset.recorder or dataset.quantity == "displacement":
        return False
    begins_there = np.median(signal.before.n_samples) < CONTACT.quiet_samples
    return signal.phase.kind == "undecided" or bool(begins_there and not signal.phase.known)


@dataclass(frozen=True, eq=False)
class _Plan:
    """All that the rows of ``impacts.csv`` are made of."""

    recordings: RecorderFolder
    facts: Facts
    choices: Choices
    settings: dict[str, Any]
    parsed: Settings

    def dataset(self, folder: Path, rows: list[dict[str, Any]], problems: Iterable[Problem] = ()) -> Dataset:
        """The dataset of these rows, written and read back; ``problems`` say why others are left out."""
        table = pd.DataFrame(rows)
        order = dict.fromkeys([*(name for name in FIRST if name in table), *table.columns])
        write_dataset(folder, settings=self.settings, impacts=table[list(order)])
        if "uncertainty" not in self.settings:
            with (folder / SETTINGS).open("a", encoding="utf-8") as settings_file:
                settings_file.write(said("written.uncertainty"))
        used = set(table["trace"])
        shutil.rmtree(folder / RECORDINGS, ignore_errors=True)
        for file in self.recordings.files:
            if f"{RECORDINGS}/{file.name}" in used:
                copy = folder / RECORDINGS / file.source.name
                copy.parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(file.source.path, copy)
        write_left_out(folder, self._reasons(problems, set(table["impact"])))
        return read_dataset(folder)

    @cached_property
    def files(self) -> set[str]:
        """The names of all files of the folder, those that could not be read too."""
        unread = (problem.file for problem in self.recordings.problems)
        return {*(file.name for file in self.recordings.files), *unread}

    def fit_to_use(self, rows: list[dict[str, Any]], problems: list[Problem]) -> list[dict[str, Any]]:
        """The rows with nothing wrong; none where a problem is not of an impact or one of the files alone."""
        bad, table = {problem.impact for problem in problems}, self.choices.table
        files = self.files | ({table.name} if table else set())
        of_all = any(problem.impact is None and problem.file not in files for problem in problems)
        return [] if of_all else [row for row in rows if row["impact"] not in bad]

    def _reasons(self, problems: Iterable[Problem], used: set[str]) -> dict[str, str]:
        """For each recording or impact that is left out why, as `left_out.csv` has it."""
        reasons: dict[str, list[str]] = {}
        for problem in problems:
            name = problem.impact or _impact_name(Source.at(Path(problem.file), problem.file))
            name = problem.file if name in used else name
            if problem.impact or problem.file in self.files:
                reasons.setdefault(name, []).append(reason_of(problem))
        return {name: f"{NEVER_READ}{'; '.join(dict.fromkeys(why))}" for name, why in reasons.items()}

    def rows(self, problems: list[Problem]) -> Iterator[dict[str, Any]]:
        """The rows; what is wrong with a file goes to ``problems``."""
        files = self.recordings.files
        bare = {file.name: _impact_name(file.source) for file in files}
        short = Counter(PurePosixPath(name).name for name in bare.values())
        known = *map(self.choices.stated, ("channel", "time")), self.choices.beside.get("value_column")
        # The unit that most of the files state.
        usual = {
            name: Counter(channel.unit for channel in channels).most_common(1)[0][0]
            for name, channels in self.recordings.candidates().items()
            if name in known
        }
        for file in files:
            if file.name not in self.facts.of_file:
                continue
            name = PurePosixPath(bare[file.name]).name
            name = name if short[name] == 1 else bare[file.name]
            base: dict[str, Any] = {"impact": name, "trace": f"{RECORDINGS}/{file.name}"}
            if self.choices.rate_hz is not None:
                base["sampling_rate_hz"] = self.choices.rate_hz
            with collected(problems):
                _require_unit(file, usual)
                if self.choices.stated("time") is None and np.isfinite(rate := self._rate(file)):
                    require_steady(file, rate)
                for number, row in enumerate(self._impacts(file), 1):
                    impact = row.get("impact", name)
                    yield {**base, **row, "impact": f"{impact}-{number}" if self.choices.several else impact}

    def _impacts(self, file: RecorderFile) -> list[dict[str, Any]]:
        """What is known of each impact of a recording, with its stretch if several are cut apart."""
        common = self.facts.of_file[file.name]
        numbers = [number for name, number in self.facts.of_number if name == file.name]
        if not self.choices.several:
            if len(numbers) > 1:
                count = f"{len(numbers)} rows of the table"
                raise InputError.stated("several-impacts.one", file.name, value=count)
            return [dict(common)]
        trace, (first, last) = self.oriented(file), ends_of(self.parsed.signal)
        if bad := int(np.count_nonzero(~np.isfinite(trace.value))):
            words = f"no number at {bad} of {trace.value.size} samples"
            raise InputError.stated("not-a-number.recording", file.name, value=words)
        how = {"threshold": self.choices.threshold, "separation_s": self.choices.separation_s}
        stretches = cut(trace, **how)
        if not stretches or (numbers and sorted(numbers) != list(range(1, len(stretches) + 1))):
            key = "several-impacts.table" if numbers else "several-impacts.none"
            actual = counted(len(stretches), "impact")
            raise InputError.stated(key, file.name, value=actual, count=len(numbers))
        return [
            self.facts.of_number.get((file.name, number), common)
            | {CROP[0]: max(start, first), CROP[1]: min(stop, last)}
            for number, (start, stop) in enumerate(stretches, 1)
        ]

    def oriented(self, file: RecorderFile) -> Trace:
        """A recording, as far as it is read, positive while the impactor slows or into the tissue."""
        signal = self.parsed.signal
        whole = read_one(file.source, self.parsed, self._rate(file)).slowing(signal.quantity)
        start, stop = ends_of(signal)
        return whole.at((whole.time_s >= start) & (whole.time_s <= stop))[0]

    def _rate(self, file: RecorderFile) -> float:
        """The stated sampling rate, Hz; not a number where none was."""
        return float(self.facts.of_file[file.name].get("sampling_rate_hz", self.choices.rate_hz or np.nan))

    def in_terms_of_init(
        self, problems: Iterable[Problem], rows: Iterable[dict[str, Any]]
    ) -> Iterator[Problem]:
        """What is wrong with the dataset, in the words of who has not seen it yet."""
        by_trace = {f"{RECORDINGS}/{file.name}": file for file in self.recordings.files}
        by_impact = {row["impact"]: by_trace[row["trace"]] for row in rows}
        for problem in map(_in_terms_of_init, problems):
            file = by_impact.get(problem.impact or "")
            if file is not None and problem.file == file.name and not self.choices.several:
                with suppress(InputError):
                    if (count := len(cut(self.oriented(file)))) > 1:
                        more = f" The recording seems to hold {count} impacts: --several cuts them apart."
                        problem = replace(problem, remedy=problem.remedy + more)
            yield problem


def cut(
    trace: Trace, *, threshold: float = Cutting.threshold, separation_s: float = Cutting.separation_s
) -> list[tuple[float, float]]:
    """When each impact of a recording begins and ends, in order, s on the recorder's clock.

    Samples that rise above the median by more than ``threshold`` standard deviations of the noise, and by
    more than a tenth of the highest, belong to impacts. Two of them that lie at least ``separation_s`` apart
    belong to two impacts. An impact is cut out from a tenth of that time before its first such sample to half
    of it after its last one, so that no two stretches meet. The noise is the greater of the white noise that
    third differences show and the scatter about the median (the median absolute deviation over 0.6745).

    Args:
        trace: positive while the impactor slows, or into the tissue.
        threshold: in standard deviations of the noise.
        separation_s: the least time between two impacts; a rebound that follows sooner stays with its impact.

    Returns:
        One stretch for each impact; none where nothing rises above the noise.
    """
    moments = trace.time_s[_loud(trace, threshold)]
    if not moments.size:
        return []
    gap = np.flatnonzero(np.diff(moments) >= separation_s)
    starts = np.append(moments[:1], moments[gap + 1]) - Cutting.before * separation_s
    ends = np.append(moments[gap], moments[-1:]) + Cutting.after * separation_s
    return [(start, stop) for start, stop in np.stack([starts, ends], axis=1).round(Cutting.digits).tolist()]


def _loud(trace: Trace, threshold: float) -> np.ndarray:
    """The samples that rise above the noise and a tenth of the highest, in order; see `cut`."""
    value = trace.value
    if value.size < MIN_SAMPLES or not (np.isfinite(value).all() and np.isfinite(trace.time_s).all()):
        return np.empty(0, int)
    above = value - np.median(value)
    noise = max(float(noise_sd(stack([trace]))[0]), float(np.median(np.abs(above))) / 0.6745)
    return np.flatnonzero(above > max(threshold * noise, Cutting.share * above.max()))


def blow_again(trace: Trace, *, threshold: float = Cutting.threshold) -> float | None:
    """The time in s between the highest blow of a recording and another one nearly as high; None without.

    A blow is a run of samples as `cut` takes them. Runs less than twice the longest one apart are one blow,
    as the swings of a tissue are. Another blow has half of the height or more, and the recording comes down
    to half of that between the two; it may be a rebound.

    Args:
        trace: positive while the impactor slows, or into the tissue.
        threshold: in standard deviations of the noise.
    """
    loud, time = _loud(trace, threshold), trace.time_s
    if not loud.size:
        return None
    runs = np.split(loud, np.flatnonzero(np.diff(loud) > 1) + 1)
    longest = max(time[run[-1]] - time[run[0]] for run in runs)
    blows = [runs[0]]
    for run in runs[1:]:
        apart = time[run[0]] - time[blows[-1][-1]] > 2 * longest
        blows = [*blows, run] if apart else [*blows[:-1], np.append(blows[-1], run)]
    value = trace.value - np.median(trace.value)
    peaks = [int(blow[np.argmax(value[blow])]) for blow in blows]
    first, *others = sorted(peaks, key=lambda at: -value[at])
    # A flat top comes down by no more than its noise, wherever the threshold is.
    valleys = [value[min(at, first) : max(at, first)].min() - value.min() for at in others]
    apart = [2 * valley < value[at] - value.min() for at, valley in zip(others, valleys, strict=True)]
    high = [at for at, down in zip(others, apart, strict=True) if down and value[at] >= value[first] / 2]
    return float(min(abs(time[at] - time[first]) for at in high)) if high else None


def _require_unit(file: RecorderFile, usual: dict[str, str]) -> None:
    """Refuse a file whose channel has another unit than that of the others: one unit holds for a dataset."""
    problems = []
    for name, usual_unit in usual.items():
        if name in file.channels and (unit := file.channels[name].unit) != usual_unit:
            where = file.name, None, name, unit or "no unit"
            problems.append(Problem.stated("mixed-units", *where, unit=usual_unit or "which state none"))
    refuse(problems)
