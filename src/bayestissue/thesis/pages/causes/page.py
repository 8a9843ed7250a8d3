"""The page of a test of causes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from bayestissue.report.page import render_page
from bayestissue.report.settings import settings_table
from bayestissue.report.wording import number
from bayestissue.thesis.pages.causes import answers, figures, tables
from bayestissue.thesis.pages.causes.run import read_causes_run

_CONTENTS = (
    ("causes", "Causes"),
    ("predictive", "Predicted and observed"),
    ("confusion", "What can be told apart"),
    ("calibration", "Calibration"),
    ("assumptions", "Assumptions"),
    ("provenance", "Provenance"),
)


def causes_page(folder: Path, about: dict[str, Any]) -> str:
    """The HTML of the run in ``folder``, whose ``run.json`` holds ``about``.

    Raises:
        InputError: a file lacks or isn't what `bayestissue causes` writes.
    """
    run = read_causes_run(folder, about)
    subject = about["subject"]
    score, guess = about.get("log_score", (float("nan"), float("nan")))
    return render_page(
        "causes.html",
        title="Why does K grow with mass?",
        subtitle=f"{len(run.causes)} proposed causes against {subject['title']}: "
        f"{about['campaigns']} simulated campaigns",
        contents=_CONTENTS,
        about=about,
        versions=about.get("versions", {}),
        subject=subject,
        answer=answers.answer(run),
        standing=[
            {"title": row["title"], "p": answers.p_words(row), "probability": number(row["probability"], 2)}
            for row in answers.standing(run)
        ],
        ruled_out=answers.ruled_out(run),
        cannot_tell=answers.cannot_tell(run),
        alike=answers.alike_words(run),
        causes_table=tables.causes_table(run),
        probability_plot=figures.probability_figure(run),
        predictive_plots=[figures.predictive_figure(run, name) for name in run.statistics],
        statistics_table=tables.statistics_table(run),
        p_table=tables.p_table(run),
        confusion_table=tables.confusion_table(run),
        calibration_table=tables.calibration_table(run),
        reliability_table=tables.reliability_table(run),
        score=number(score, 2),
        guess=number(guess, 2),
        published=subject["name"] == "published",
        settings_table=settings_table(about["model"]),
    )
