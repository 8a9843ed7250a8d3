"""A finished fit, just made or read back from its folder: one object, and the files of a run."""

from __future__ import annotations

import os
import shutil
from contextlib import suppress
from datetime import datetime
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any
from zipfile import BadZipFile

import pandas as pd
import xarray as xr

from bayestissue.base import runtime
from bayestissue.base.errors import InputError, path_argument
from bayestissue.base.outline import Rows, short, span
from bayestissue.base.result import Made, Result, Say
from bayestissue.base.results.files import write_json, write_tree
from bayestissue.base.results.manifest import require_file
from bayestissue.base.results.tables import wrong_in
from bayestissue.inference.checking.findings import verdict_in_words
from bayestissue.inference.results.meanings import UNITS, symbols
from bayestissue.model.hierarchy.specification import ModelSpecification, specification_of
from bayestissue.reports.pages.fit.fit_run import TABLES, FitRun
from bayestissue.reports.pages.run_folder import read_about
from bayestissue.reports.paper import WIDTH_MM

if TYPE_CHECKING:
    from bayestissue.inference.answers.predictions import Predicted
    from bayestissue.inference.chain.results import ChainEnd
    from bayestissue.model.hierarchy.recorded import Condition
    from bayestissue.reports.pages.fit.figures import Plots

# Where its chains ended.
CHAIN = "chain.npz"
_AGAIN = "Give the folder of a finished run of `bayestissue fit`."


class Fit(FitRun, Result):
    """A finished fit, with all that a run folder tells of it, and what can be asked of it."""

    command = "fit"

    def _outline(self) -> tuple[str, Rows]:
        posterior = self.posterior["posterior"].dataset
        chains, draws = (posterior.sizes[name] for name in ("chain", "draw"))
        over = [name for name in posterior["K"].dims if name != "impact"]
        medians = [
            (f"{name} of the impacts", f"posterior medians {span(posterior[name].median(over), UNITS[q])}")
            for q, name in symbols(posterior).items()
        ]
        rows = [
            ("impacts", f"{posterior.sizes['impact']} of {short(str(self.about.get('dataset', '')))}"),
            *medians,
            ("draws", f"{chains} chains of {draws}, seed {self.seed}, {self.wall_time_s:.0f} s"),
            ("diagnostics", short(self.verdict, 160)),
            (
                "more in",
                ".summary, .posterior, .diagnostics, .ask(question), .predict(table), .plot, .report(path)",
            ),
        ]
        return f"Fit by the model {short(str(self.about['model'].get('name', '')))}", rows

    @property
    def seed(self) -> int:
        """Of all draws."""
        return int(self.about["seed"])

    @property
    def started(self) -> datetime:
        """When sampling began."""
        return datetime.fromisoformat(self.about["started"])

    @property
    def wall_time_s(self) -> float:
        """How long the fit took, s."""
        return float(self.about["wall_time_s"])

    @property
    def dataset_folder(self) -> Path | None:
        """The folder of the fitted recordings, as far as it is known; it may have moved since.

        ``run.json`` has it relative to the run's own folder, so that both may move together.
        """
        if self.dataset is not None or self.folder is None:
            return self.folder
        stated = self.about.get("dataset_folder")
        return None if stated is None else (self.folder / stated).resolve()

    @cached_property
    def specification(self) -> ModelSpecification:
        """The model file, its formulas as they were evaluated."""
        return specification_of(self.about["model"], "run.json")

    @property
    def verdict(self) -> str:
        """The diagnostics in a sentence, and in others what the model or its data leave in doubt."""
        return verdict_in_words(self.diagnostics)

    def chain_end(self) -> ChainEnd:
        """Where the chains ended, from which ``fit(..., continue_from=...)`` goes on: ``chain.npz``.

        Raises:
            InputError: the file is missing or damaged.
        """
        if self.end is not None:
            return self.end
        from bayestissue.inference.chain.results import ChainEnd

        path = None if self.folder is None else self.folder / CHAIN
        with suppress(OSError, KeyError, ValueError, BadZipFile):
            if path is not None:
                return ChainEnd.read(path)
        raise InputError.stated("another-run.chain", str(path or "continue_from"))

    def ask(self, *questions: str) -> pd.DataFrame:
        """Answers to questions, as `bayestissue ask` and ``bayestissue ask --help`` have them.

        Args:
            questions: such as ``"K[subject=s01] / K[subject=s02] > 1.1"``, a claim, or ``"K[mass_kg=1.2]"``.

        Returns:
            A row for each: see `bayestissue.inference.answers.questions.ask`.

        Raises:
            InputError: some can't be read, or ask for what this fit does not have: all that is wrong at once.
        """
        from bayestissue.inference.answers.questions import ask, numbered

        for question in questions:
            if not isinstance(question, str):
                raise InputError.of_argument("questions", question, "texts, each by itself: ask(*questions)")
        return ask(self.study, numbered(questions))

    def predict(
        self,
        table: str | Path | pd.DataFrame,
        *,
        draws: str | Path | None = None,
        overwrite: bool = False,
        say: Say | None = None,
    ) -> pd.DataFrame:
        """K, C and the outcomes of new impacts, with 90 % intervals.

        Args:
            table: a CSV file or a pandas table: a row for each new impact, with any of the columns of
                ``impacts.csv``. Numbers and categories not given are at the reference; a person, condition or
                other level that is not given, or was not measured, is a new one of its population. Along
                gravity ``drop_height_cm`` may stand in place of ``velocity_m_s``.
            draws: a file for the joint draws of `predicted_draws`, whose name ends in ``.parquet``, or in
                ``.nc`` for netCDF.
            overwrite: replace that file.
            say: told the stage, how many rows of a long table are done, and of how many.

        Returns:
            A row for each: see `bayestissue.inference.answers.predictions.predicted`.

        Raises:
            InputError: the table is wrong: all that is, by row, column and value; or ``draws`` is taken.
        """
        from bayestissue.inference.answers.predictions import DRAWS_AS, is_draws, predict, write_draws

        if draws is None:
            return runtime.in_float64(predict)(self.study, self._conditions(table), say)
        read = (self.folder, None if isinstance(table, pd.DataFrame) else Path(table))
        require_file(Path(draws), DRAWS_AS, is_draws, overwrite=overwrite, inputs=read)
        predicted = self._predicted(table)
        write_draws(predicted.draws, Path(draws))
        return predicted.table

    def predicted_draws(self, table: str | Path | pd.DataFrame) -> xr.Dataset:
        """Joint draws of all quantities of new impacts, of which any function is as unsure as it is.

        Args:
            table: as of `predict`.

        Returns:
            Variables by the names of ``posterior.nc``, with unit and meaning, [chain, draw, row], ``row``
            being the place in the table, the first 1. All rows of a draw are of one population, of the same
            people, conditions and new levels; the scatter of single impacts is each row's own.

        Raises:
            InputError: the table is wrong.
        """
        return self._predicted(table).draws

    def _predicted(self, table: str | Path | pd.DataFrame) -> Predicted:
        from bayestissue.inference.answers.predictions import predicted

        return runtime.in_float64(predicted)(self.study, self._conditions(table))

    def _conditions(self, table: str | Path | pd.DataFrame) -> list[Condition]:
        from bayestissue.inference.answers.predictions import read_conditions

        return read_conditions(table, self.study)

    @cached_property
    def plot(self) -> Plots:
        """Figures for a notebook, such as ``fit.plot.people("K")`` or ``fit.plot.mass()``.

        Each is a `bayestissue.reports.figures.theme.Figure`: drawn by the notebook, with the rows behind it
        as ``.data`` and Vega-Lite's specification by ``.specification()``.
        """
        from bayestissue.reports.pages.fit.figures import Plots

        return Plots(self)

    @property
    def tables(self) -> dict[str, pd.DataFrame]:
        """Those of the run's folder, by the names of their files."""
        tables = {name: self.table(name) for name in (*TABLES, "agreement")}
        # Few model files have questions.
        with suppress(KeyError):
            tables["questions"] = self.table("questions")
        return tables

    @property
    def passed(self) -> bool:
        """Whether the sampler did its work."""
        return bool(self.diagnostics["passed"])

    @property
    def inputs(self) -> tuple[str | Path | None, ...]:
        """The run that was read back, or the dataset that was fitted."""
        return (self.folder,)

    def page(self) -> str:
        """The HTML of the page, of what is in memory; of a run that was read back, from its folder."""
        from bayestissue.reports.pages.fit.fit_page import page_of

        return page_of(self.complete())

    def write(self, folder: Path) -> None:
        """Write every file of the run into a folder, but for the page that is drawn of them."""
        record, dataset = self.about, self.dataset_folder
        if dataset is not None:
            record = record | {"dataset_folder": _from_folder(dataset, folder)}
        super().write(folder)
        write_json(record, folder / "run.json")
        write_tree(self.posterior, folder / "posterior.nc")
        write_json(self.diagnostics, folder / "diagnostics.json")
        # A simulated dataset knows the truth; the report draws it in.
        copied = ["truth.csv"]
        if self.end is not None:
            self.end.write(folder / CHAIN)
        elif self.dataset is None:
            copied.append(CHAIN)
        for name in copied:
            if self.folder is not None and (path := self.folder / name).is_file():
                shutil.copyfile(path, folder / name)

    def export(
        self,
        path: str | Path,
        *,
        certificate: str | Path | None = None,
        width_mm: float = WIDTH_MM,
        overwrite: bool = False,
    ) -> Path:
        """Write what a paper takes, as `bayestissue export` does: text, tables, figures.

        Args:
            path: a folder that is new or empty.
            certificate: the folder of `bayestissue certify` of this fit, whose verdict the checklists state.
            width_mm: of a figure in print; a journal's column is about 85 mm wide, its page 170.
            overwrite: replace what is there.

        Returns:
            The folder.

        Raises:
            InputError: ``path`` is taken and ``overwrite`` is false, or holds what no command wrote; or
                ``certificate`` is none of this fit.
        """
        return self.paper(certificate, width_mm).report(path, overwrite=overwrite)

    def paper(self, certificate: str | Path | None = None, width_mm: float = WIDTH_MM) -> Made:
        """What a paper takes, not written yet; arguments as of `export`."""
        from bayestissue.reports.paper.export import write_paper

        certified = None if certificate is None else self._certified(Path(certificate))
        return Made(
            further=partial(write_paper, self.complete(), certified=certified, width_mm=width_mm),
            said="wrote methods.md, methods.docx, checklists.md, tables.xlsx and figures/ to {folder}",
            inputs=(self.folder, certificate),
        )

    def _certified(self, folder: Path) -> dict[str, Any]:
        """The verdict of this fit's certificate in a folder."""
        record = read_about(folder)
        certified = record.get("run", {})
        if record["kind"] != "certificate" or certified.get("started") != self.about["started"]:
            raise InputError.stated("not-a-run.certificate", str(folder), value=certified.get("started"))
        verdict: dict[str, Any] = record["verdict"]
        return verdict


def read_run(path: str | Path) -> Fit:
    """Read a finished fit back from its folder.

    Args:
        path: the folder that `bayestissue fit` or `bayestissue.Fit.report` wrote.

    Returns:
        What `bayestissue.fit` returned, but for ``dataset`` and ``prepared``, which hold the recordings.

    Raises:
        InputError: it is not such a folder, or its files are damaged.
    """
    folder = path_argument("path", path, "the folder of a finished fit")
    record = read_about(folder)
    if record["kind"] != "fit" or not isinstance(record.get("model"), dict):
        path, kind = folder / "run.json", record["kind"]
        raise InputError(wrong_in(path, '"fit"', _AGAIN, code="not-a-fit", column="kind", value=kind))
    return Fit.read(folder, record)


def _from_folder(path: Path, folder: Path) -> str:
    """A path as seen from a folder; as it is where they have no drive in common."""
    try:
        return Path(os.path.relpath(path.resolve(), folder.resolve())).as_posix()
    except ValueError:
        return path.resolve().as_posix()
