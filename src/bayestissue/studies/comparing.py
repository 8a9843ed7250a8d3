"""Finished fits of the same recordings beside each other: scores, posteriors, answers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import pandas as pd

from bayestissue.base import runtime
from bayestissue.base.errors import InputError, Problem, all_of, refuse
from bayestissue.base.outline import Rows, short
from bayestissue.base.result import Result
from bayestissue.base.results.tables import wrong_in
from bayestissue.inference.answers.questions import ask_what_can_be, numbered, require_parsed
from bayestissue.inference.model_comparison import (
    compare_runs,
    observed_by,
    posteriors_by_run,
    same_questions,
)
from bayestissue.reports.pages.comparison import page_of
from bayestissue.reports.pages.run_folder import require_groups
from bayestissue.studies.finished import Fit, read_run

_AGAIN = "Give folders of finished runs of `bayestissue fit`."
_unfit = partial(Problem, code="runs-to-compare")


@dataclass(frozen=True, eq=False, repr=False)
class Comparison(Result):
    """Finished fits of the same recordings beside each other.

    Attributes:
        about: the content of ``run.json``.
        comparison: a row a scheme and run, the best first: ``comparison.csv``.
        posteriors: median and 90 % interval of what every run estimates: ``posteriors.csv``.
        answers: what every run answers to the same: ``answers.csv``.
        asked: the questions.
    """

    command = "compare"
    table_names = ("comparison", "posteriors", "answers")
    about: dict[str, Any]
    comparison: pd.DataFrame
    posteriors: pd.DataFrame
    answers: pd.DataFrame
    asked: tuple[str, ...] = ()

    def _outline(self) -> tuple[str, Rows]:
        best = self.comparison.groupby("scheme", sort=False).first()
        rows = [(str(scheme), f"{row['model']} predicts best") for scheme, row in best.iterrows()]
        names = ", ".join(run["name"] for run in self.about["runs"])
        more = ("more in", ".comparison, .posteriors, .answers, .page(), .report(path)")
        return f"Comparison of {short(names, 200)}", [*rows, more]

    def page(self) -> str:
        """The HTML of the page."""
        return page_of(self.tables, self.about)


def compare(*runs: Fit | str | Path, ask: str | Sequence[str] = ()) -> Comparison:
    """Which finished fit predicts best what it has not seen, and whether the fits agree on K and C.

    Args:
        runs: two or more fits of the same recordings, or folders of runs.
        ask: questions that each run answers, as `Fit.ask` takes them.

    Returns:
        The comparison: ``.comparison`` (a row a scheme and run), ``.posteriors``, ``.answers``, and the
        methods ``.page()`` and ``.report(folder)``.

    Raises:
        InputError: some are no finished fits, or not of the same recordings; or a question can't be read.

    Example:
        >>> compared = bt.compare("runs/impact", "runs/maxwell", ask="peak_force[mass_kg=5, velocity_m_s=2]")
        >>> compared.comparison[["scheme", "model", "elpd_difference", "weight"]]
    """
    start = runtime.CommandStart()
    if len(runs) < 2:
        named = ", ".join(map(str, runs)) or "none"
        raise InputError(_unfit("compare", "at least two folders", _AGAIN, value=named))
    _require_distinct([Path(run) for run in runs if not isinstance(run, Fit)])
    questions = numbered([ask] if isinstance(ask, str) else ask)
    require_parsed(questions)
    fits = dict(zip(_names(read := all_of(_read, runs)), read, strict=True))
    _require_same_data(fits)
    all_of(_require_densities, read)
    compared = compare_runs(
        {name: fit.posterior for name, fit in fits.items()},
        {name: fit.about["model"] for name, fit in fits.items()},
    )
    posteriors = posteriors_by_run({name: fit.study for name, fit in fits.items()})
    answers = same_questions(
        {name: _answers(fit) | {"asked": ask_what_can_be(fit.study, questions)} for name, fit in fits.items()}
    )
    first = read[0].about
    record = start.record(
        "compare",
        "comparison",
        dataset=first.get("dataset", ""),
        words=first.get("words", {}),
        input_hash=first["input_hash"],
        runs=[_of_run(name, fit) for name, fit in fits.items()],
    )
    return Comparison(record, compared, posteriors, answers, tuple(question.text for question in questions))


def _of_run(name: str, fit: Fit) -> dict[str, Any]:
    """What ``run.json`` says of a run."""
    stored = {k: fit.about.get(k) for k in ("model", "seed", "started", "verdict")}
    if fit.dataset is not None or fit.folder is None:
        return {"name": name, **stored}
    posterior_hash = runtime.content_hash([fit.folder / "posterior.nc"])
    return {"name": name, "folder": str(fit.folder), "posterior_hash": posterior_hash, **stored}


def _answers(fit: Fit) -> dict[str, pd.DataFrame]:
    tables = {}
    for name in ("contrasts", "questions"):
        with suppress(KeyError):
            tables[name] = fit.table(name)
    return tables


def _read(run: Fit | str | Path) -> Fit:
    fit = run if isinstance(run, Fit) else read_run(run)
    if lacking := [key for key in ("input_hash", "model") if not fit.about.get(key)]:
        path = _file(fit, "run.json")
        raise InputError(wrong_in(path, "what every fit writes", _AGAIN, column=lacking[0]))
    return fit


def _require_densities(fit: Fit) -> None:
    """Raise an `InputError` of a fit that lacks what is compared."""
    needed = {
        "log_likelihood": ("trace",),
        "log_likelihood_of_groups": ("traces_of_subject", "traces_of_trial"),
        "constant_data": ("impact_subject", "mass_kg", "velocity_m_s"),
        "observed_data": (observed_by(fit.about["model"]),),
    }
    require_groups(fit.posterior, needed, _file(fit, "posterior.nc"), _AGAIN)


def _file(fit: Fit, name: str) -> Path:
    return (fit.folder or Path()) / name


def _require_distinct(runs: Sequence[Path]) -> None:
    places = [path.resolve() for path in runs]
    first = [runs[places.index(folder)] for folder in places]
    refuse(
        _unfit(str(path), f"another run than {earlier}", "Name each run once.", value="the same run")
        for path, earlier in zip(runs, first, strict=True)
        if earlier is not path
    )


def _require_same_data(fits: Mapping[str, Fit]) -> None:
    first, *others = fits.values()
    hashes = [
        f"{fit.about['input_hash'][:16]}… (dataset “{fit.about.get('dataset')}”)" for fit in fits.values()
    ]
    where = None, "input_hash"
    refuse(
        Problem.stated(
            "other-data", str(_file(fit, "run.json")), *where, words, first=hashes[0], run=first.folder
        )
        for fit, words in zip(others, hashes[1:], strict=True)
        if fit.about["input_hash"] != first.about["input_hash"]
    )


def _names(fits: Sequence[Fit]) -> list[str]:
    """As many of the last parts of each folder as it takes to tell the runs apart; else models by number."""
    stored = [fit.folder for fit in fits if fit.folder is not None and fit.dataset is None]
    if len(stored) < len(fits):
        return [
            f"{number} {fit.about['model'].get('name', '')}".strip() for number, fit in enumerate(fits, 1)
        ]
    paths = [folder.resolve().parts for folder in stored]
    for count in range(1, max(map(len, paths))):
        names = ["/".join(parts[-count:]) for parts in paths]
        if len(set(names)) == len(names):
            return names
    return [str(folder.resolve()) for folder in stored]
