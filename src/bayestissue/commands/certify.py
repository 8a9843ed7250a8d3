"""``certify``: whether a finished fit is calibrated about its own study, and what journals ask of it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bayestissue import results, runtime
from bayestissue.certificate import FEWEST_REFITS, MOST_REFITS, REFITS
from bayestissue.commands.options import FAILED_DIAGNOSTICS, FinishedFit, Overwrite, Quiet, Seed

if TYPE_CHECKING:
    from bayestissue.certificate.certificate import Certificate


def run(
    run: FinishedFit,
    out: Annotated[Path | None, typer.Option("--out")] = None,
    refits: Annotated[int, typer.Option(min=FEWEST_REFITS, max=MOST_REFITS)] = REFITS,
    dataset: Annotated[Path | None, typer.Option(metavar="DATASET")] = None,
    seed: Seed = 0,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
) -> None:
    """Certify a finished fit: draw its study anew from its own posterior, fit it each time, and compare.

    Of a fit that samples its posterior, nine in ten 90 % intervals of such refits hold the truth that was
    drawn, and its ranks are uniform (posterior simulation-based calibration). The certificate also says which
    results the priors move, and has the checklists BARG and GRRAS, answered where the run knows the answer.
    It tests the program on this study, not the model: for that see the report's section on residuals.

    The example takes about five minutes. An interrupted certificate goes on where it stopped when the same
    command is given again. Exit status 3: not calibrated, or the fit's own diagnostics failed.

    Args:
        out: Folder for the certificate; RUN-certificate beside the run unless given.
        refits: Studies that are drawn and fitted. Twenty show gross faults, a hundred finer ones.
        dataset: The recordings that were fitted, where they are no longer where the run says.
    """
    runtime.configure(one_core=True)
    if not certified(run, out, refits=refits, dataset=dataset, seed=seed, overwrite=overwrite, quiet=quiet):
        raise typer.Exit(FAILED_DIAGNOSTICS)


def certified(
    run: Path,
    out: Path | None = None,
    *,
    refits: int = REFITS,
    dataset: Path | None = None,
    seed: int = 0,
    overwrite: bool = False,
    quiet: bool = False,
) -> bool:
    """Write the certificate of a run; whether it passed."""
    path = run.resolve().with_name(f"{run.resolve().name}-certificate") if out is None else out
    inputs = (run, dataset)
    with results.claim(path, overwrite=overwrite, command="certify", inputs=inputs) as target:
        from bayestissue.certificate.certificate import Study, certificate_of, write_certificate
        from bayestissue.commands.console import Stages

        study = Study.of_run(run, dataset)
        with Stages(quiet=quiet) as say, target.unfinished(study.job(refits, seed)) as parts:
            certificate = certificate_of(study, refits, seed, say, parts=parts)
            with target.folder() as folder:
                write_certificate(certificate, folder)
        _say(certificate, target.path, quiet=quiet)
    return certificate.passed


def _say(certificate: Certificate, folder: Path, *, quiet: bool) -> None:
    from bayestissue.commands.console import echo
    from bayestissue.words import Words

    nouns = Words(certificate.about["words"])
    echo(nouns(certificate.words))
    if not quiet:
        items = certificate.checklists
        echo(nouns(certificate.about["verdict"]["prior"]))
        answered = int(items["answered"].sum())
        echo(f"checklists: {answered} of {len(items)} items answered; the others are questions")
        echo(f"wrote {folder / 'report.html'} and {folder / 'certificate.md'}")
