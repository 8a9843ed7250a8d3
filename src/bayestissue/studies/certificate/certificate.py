"""The certificate of a finished fit, from its folder or from memory."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pandas as pd

from bayestissue.base import runtime
from bayestissue.base.errors import InputError
from bayestissue.base.outline import Rows, short
from bayestissue.base.result import Result, Say, silent
from bayestissue.base.results.files import whole_file
from bayestissue.base.results.tables import read_table, table_of_rows
from bayestissue.inference.chain.draws import ChainJob, chain_draws
from bayestissue.inference.fit import sample
from bayestissue.model.hierarchy.specification import Sampler
from bayestissue.model.hierarchy.trace_data import Prepared, with_discrepancy
from bayestissue.recordings.dataset import Dataset, read_dataset
from bayestissue.reports.pages.page import part, render_page, worded
from bayestissue.reports.pages.page_tables import Field, Table, shown, table_of_cells, tag
from bayestissue.reports.pages.wording import names_in, nouns_of
from bayestissue.reports.paper.checklists import checklists, checklists_markdown
from bayestissue.reports.paper.text import text_of
from bayestissue.studies.certificate import FEWEST_REFITS, MOST_REFITS, REFITS
from bayestissue.studies.certificate.augmented import Truth, augmented, reason_against, truths
from bayestissue.studies.certificate.ranks import calibration_table, ranks_of
from bayestissue.studies.finished import Fit, read_run
from bayestissue.studies.fitting import FitRequest, fit_job

type Recordings = Dataset | str | Path | None
# Of a refit: enough for ranks among 99 draws.
_SAMPLER = Sampler(chains=2, draws=1000, effective=150)
_CHECK = "\N{CHECK MARK}"


@dataclass(frozen=True, eq=False, repr=False)
class Certificate(Result):
    """What a fit is worth: its calibration about this very study, its priors' part, the journals' checklists.

    Attributes:
        about: the content of ``run.json``, with the ``verdict``: ``passed`` and ``words``.
        calibration: a row a quantity: ``calibration.csv``; empty where the study can't be drawn anew, for a
            reason that the verdict says.
        ranks: every rank of every refit: ``ranks.csv``.
        sensitivity: how much prior and data move each quantity of the population: ``sensitivity.csv``.
        checklists: the items of BARG and GRRAS, answered or asked: ``checklists.csv``.
    """

    command = "certify"
    files = ("report.html", "certificate.md")
    table_names = ("calibration", "ranks", "sensitivity", "checklists")
    about: dict[str, Any]
    calibration: pd.DataFrame
    ranks: pd.DataFrame
    sensitivity: pd.DataFrame
    checklists: pd.DataFrame

    def _outline(self) -> tuple[str, Rows]:
        items = self.checklists
        rows = [
            ("verdict", self.words),
            ("checklists", f"{int(items['answered'].sum())} of {len(items)} items answered"),
            ("more in", ".calibration, .sensitivity, .checklists, .report(path)"),
        ]
        return f"Certificate of the fit of {short(str(self.about['dataset']))}", rows

    @property
    def passed(self) -> bool:
        """Whether the fit's own diagnostics passed, and its calibration if it could be made."""
        return bool(self.about["verdict"]["passed"])

    @property
    def words(self) -> str:
        """The verdict in words."""
        return str(self.about["verdict"]["words"])

    def page(self) -> str:
        """The HTML of the page."""
        return render_page(
            "certificate.html",
            nouns=nouns_of(self.about, names_in(self.calibration)),
            record=self.about,
            calibration=self.calibration,
            calibration_table=_calibration_table(self.calibration),
            moved=self._moved_by_priors(),
            sensitivity=self.sensitivity,
            checklists=self.checklists,
        )

    def write(self, folder: Path) -> None:
        """Write every file of a certificate but the page."""
        super().write(folder)
        about, lists = self.about, "\n".join(checklists_markdown(self.checklists))
        facts = {"fit of": about["dataset"], "fitted": about["run"]["started"], "certified": about["started"]}
        tables = {
            "facts": table_of_cells((facts | about["versions"]).items(), "", ""),
            "calibration": shown("calibration", self.calibration, "attached"),
            "moved": self._moved_by_priors(),
        }
        lines = {name: "\n".join(table.markdown()) if table.rows else "" for name, table in tables.items()}
        attached = str(part("words/certificate.jinja").attached(about, lines, lists))
        (folder / "certificate.md").write_text(attached, encoding="utf-8")

    def _moved_by_priors(self) -> Table:
        """The quantities in which the prior has a part."""
        return shown("sensitivity", self.sensitivity[self.sensitivity["diagnosis"] != _CHECK])


def certificate_page(folder: Path, record: dict[str, Any]) -> str:
    """The HTML of the page of the certificate in ``folder``, whose ``run.json`` holds ``record``.

    Raises:
        InputError: a file of it lacks or isn't what `certify` writes.
    """
    return Certificate(record, **{name: read_table(folder, name) for name in Certificate.table_names}).page()


def _calibration_table(calibration: pd.DataFrame) -> Table:
    """What the ranks of each quantity say."""
    passed = Field("ranks", lambda row: tag("yes", "uniform") if row["passed"] else tag("no", "NOT UNIFORM"))
    return shown(
        "calibration",
        calibration,
        fields={"passed": passed},
        mark=lambda row: "" if row["passed"] else "failed",
    )


def certify(
    run: Fit | str | Path,
    *,
    refits: int = REFITS,
    seed: int = 0,
    dataset: Dataset | str | Path | None = None,
    say: Say = silent,
) -> Certificate:
    """Certify a finished fit: draw its study anew from its own posterior so often, and fit it each time.

    Of a fit that samples its posterior, the truth of each refit has a uniform rank among the refit's draws
    (posterior simulation-based calibration, arXiv:2502.03279). Besides: what the priors do to each result
    (power scaling), and the checklists BARG and GRRAS, answered as far as the run knows the answer.

    Args:
        run: a fit, or the folder of a run.
        refits: studies drawn and fitted, from 10 on; each takes a third of the fit's own time or more.
        seed: of all that is drawn. A whole number from 0.
        dataset: the recordings or their folder, where they are no longer where the run says.
        say: told the stage, how much of it is done, and its total.

    Returns:
        The certificate: ``.passed``, ``.words``, ``.calibration``, ``.sensitivity``, ``.checklists``, and the
        method ``.report(folder)``.

    Raises:
        InputError: ``run`` is no finished fit, its recordings are not found, have changed, or are another's;
            or its chains were not kept.

    Example:
        >>> certificate = bt.certify("runs/drops")
        >>> certificate.passed
        >>> certificate.report("runs/drops-certificate")
    """
    if not FEWEST_REFITS <= refits <= MOST_REFITS:
        raise InputError.stated(
            "option-value.refits", "arguments", None, "refits", refits, least=FEWEST_REFITS, most=MOST_REFITS
        )
    return CertificateJob.of_run(run, dataset, refits=refits, seed=seed).certificate(say)


@dataclass(frozen=True, eq=False)
class CertificateJob:
    """A finished fit with its model and its data, and how often its study is drawn anew.

    Attributes:
        fit: the fit.
        prepared: its model and its data.
        refits: studies that are drawn and fitted.
        seed: of all that is drawn.
    """

    fit: Fit
    prepared: Prepared
    refits: int
    seed: int

    @classmethod
    def of_run(
        cls, run: Fit | str | Path, dataset: Recordings = None, *, refits: int = REFITS, seed: int = 0
    ) -> CertificateJob:
        """The job of a fit, whose recordings are read again where it is not in memory.

        Raises:
            InputError: as of `certify`.
        """
        fit = run if isinstance(run, Fit) else read_run(run)
        if fit.prepared is not None:
            return cls(fit, fit.prepared, refits, seed)
        recordings, request = _recordings(fit, dataset), FitRequest(fit.specification, continue_from=fit)
        job = fit_job(recordings, request, fit.seed, skip_short=bool(fit.about.get("left_out")))
        prepared = job.prepared
        if "score_without" in fit.about.get("discrepancy", {}):
            prepared = with_discrepancy(job.dataset, job.specification, prepared)
        return cls(fit, prepared, refits, seed)

    def fingerprint(self) -> str:
        """Of all that the refits depend on."""
        content = [self.fit.about["input_hash"], self.fit.about["model"], self.fit.seed]
        end = np.asarray(self.fit.chain_end().state.y).tolist()
        content += [end, self.refits, self.seed, runtime.versions()]
        return hashlib.sha256(json.dumps(content).encode()).hexdigest()

    def certificate(self, say: Say, parts: Path | None = None) -> Certificate:
        """`certify` of what was read; ``parts`` is an existing folder for finished refits."""
        start, fit = runtime.CommandStart(), self.fit
        against = reason_against(self.prepared)
        refits = [] if against else self.refitted(say, parts)
        rows = [
            (number, int(one["passed"]), name, element, rank)
            for number, one in enumerate(refits, start=1)
            for name, ranks in one["ranks"].items()
            for element, rank in enumerate(ranks, start=1)
        ]
        calibration = calibration_table([refit["ranks"] for refit in refits])
        sensitivity = fit.table("sensitivity")
        failed, sound = sum(not refit["passed"] for refit in refits), bool(fit.diagnostics["passed"])
        moved = sensitivity.loc[sensitivity["diagnosis"] != "\N{CHECK MARK}", "variable"].tolist()
        verdict = {
            "passed": sound and bool(calibration["passed"].all()),
            "words": worded("certificate", "verdict", sound, calibration.to_dict("records"), failed, against),
            "prior": worded("certificate", "priors", moved),
        }
        record = start.record(
            "certify",
            "certificate",
            dataset=str(fit.about.get("dataset", "")),
            run={"started": fit.about["started"], "input_hash": fit.about["input_hash"], "seed": fit.seed},
            refits=len(refits),
            refits_failed=failed,
            against=against,
            seed=self.seed,
            words=dict(fit.about.get("words", {})),
            verdict=verdict,
        )
        items = checklists(fit, text_of(fit, fit.study), verdict)
        return Certificate(record, calibration, table_of_rows("ranks", rows), sensitivity, items)

    def refitted(self, say: Say, parts: Path | None) -> list[dict[str, Any]]:
        """Of each refit the ranks, and whether its chains passed; earlier ones of the job are read."""

        @cache
        def drawn() -> list[Truth]:
            say("drawing from the posterior", 0, 1)
            effective = max(50, 2 * self.refits)
            sampler = self.fit.specification.sampler.model_copy(update={"effective": effective})
            folder = parts and parts / "posterior"
            if folder:
                folder.mkdir(exist_ok=True)
            job = ChainJob(self.prepared, sampler, self.seed, checkpoints=folder)
            return truths(next(chain_draws(job, self.fit.chain_end())), self.refits)

        def refit(number: int) -> dict[str, Any]:
            path = parts and parts / f"refit-{number:04d}.json"
            if path and path.is_file():
                return json.loads(path.read_text(encoding="utf-8"))
            truth = drawn()[number]
            say("fitting the study drawn anew", number, self.refits)
            one = self._one(truth, number)
            if path:
                with whole_file(path) as staging:
                    staging.write_text(json.dumps(one), encoding="utf-8")
            return one

        return [refit(number) for number in range(self.refits)]

    def _one(self, truth: Truth, number: int) -> dict[str, Any]:
        """One refit."""
        key = jax.random.fold_in(jax.random.PRNGKey(self.seed), number)
        rng = np.random.default_rng([self.seed, number])
        drawn, whole = augmented(self.prepared, truth, key, rng)
        chains = sample(drawn, _SAMPLER, int(rng.integers(2**31)))
        ranks = ranks_of(drawn, chains, whole, len(self.prepared.impacts))
        passed = chains.verdict.passed
        return {"ranks": {name: rank.tolist() for name, rank in ranks.items()}, "passed": passed}


def _recordings(fit: Fit, dataset: Recordings) -> Dataset:
    """The recordings of a run that was read back."""
    if isinstance(dataset, Dataset):
        return dataset
    folder = fit.dataset_folder if dataset is None else Path(dataset)
    if folder is None or not folder.is_dir():
        raise InputError.stated("another-run.gone", str(fit.folder), value=str(folder or "not stated"))
    return read_dataset(folder, skip_bad=bool(fit.about.get("left_out")))
