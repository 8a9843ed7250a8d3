"""The whole page of the published analysis."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from bayestissue.dataset.published import PublishedTables, read_published
from bayestissue.inference.samplers.diagnostics import warned_codes
from bayestissue.remedies import Code, codes_in
from bayestissue.report import model_words, posterior, remarks
from bayestissue.report import posterior_tables as shared_tables
from bayestissue.report.comparison.figures import comparison_figure
from bayestissue.report.page import render_page
from bayestissue.report.posterior_figures import effects_figure, exponent_figure
from bayestissue.report.settings import settings_table
from bayestissue.thesis.pages.published import (
    answers,
    check_tables,
    posterior_tables,
    thesis_tables,
)
from bayestissue.thesis.pages.published.check_figures import inside_share, predictive_figure
from bayestissue.thesis.pages.published.posterior_figures import (
    kept_share,
    mass_figure,
    shrinkage_figure,
)
from bayestissue.thesis.pages.published.run import PublishedRun, read_published_run
from bayestissue.thesis.pages.published.thesis_figures import correlations_plot, mass_plot
from bayestissue.thesis.reproduction.conditions import Quantity

ThesisLines = dict[Quantity, tuple[float, float] | None]

_CONTENTS = (
    ("estimates", "Estimates and posteriors"),
    ("mass", "Mass"),
    ("hypotheses", "Hypotheses"),
    ("effects", "People and conditions"),
    ("explanations", "Competing explanations"),
    ("priors", "Priors"),
    ("predictions", "Predictions"),
    ("figures", "The thesis's figures"),
    ("reproduction", "Reproduction"),
    ("audit", "Audit"),
    ("diagnostics", "Diagnostics"),
    ("model", "Model"),
    ("provenance", "Provenance"),
)
_LEVELS = {"subject": "people", "trial": "conditions"}
_POPULATION = tuple(
    f"{stem}_{quantity}"
    for stem in ("intercept", "mass_exponent", "sd_subject", "sd_trial", "sd_impact")
    for quantity in posterior.QUANTITIES
)


def published_page(folder: Path, about: dict[str, Any]) -> str:
    """The HTML of the report of the `reproduce` run in ``folder``.

    Raises:
        InputError: a file of the run lacks or isn't what a run writes.
    """
    run = read_published_run(folder, about)
    # A run of other tables than the thesis's own carries them along.
    own_tables = folder / "published"
    published = read_published(own_tables if own_tables.is_dir() else None)
    lines = {quantity: thesis_line(published, quantity) for quantity in posterior.QUANTITIES}
    return render_page(
        "published.html",
        title="Published K and C, re-analysed",
        subtitle=_subtitle(run),
        contents=_CONTENTS,
        first_codes=warned_codes(run.diagnostics),
        codes=[*warned_codes(run.diagnostics), *_further_codes(run)],
        about=about,
        **_first_screen(run),
        **_posterior(run, lines),
        **_model_checks(run),
        **_published(run, published),
        **_provenance(run),
    )


def _further_codes(run: PublishedRun) -> list[Code]:
    """Of what sections below the first screen warn of."""
    failed = any(row.mark for row in check_tables.checks_table(run).rows)
    said = "; ".join([remarks.prior_remark(run.sensitivity), *run.comparison["warning"]])
    return [*(("predictive-check",) if failed else ()), *codes_in(said)]


def _subtitle(run: PublishedRun) -> str:
    impacts, people, conditions = (len(run.labels(name)) for name in ("impact", "subject", "trial"))
    return f"Stiffness K, damping C: {impacts} impacts, {people} people, {conditions} conditions"


def thesis_line(published: PublishedTables, quantity: str) -> tuple[float, float] | None:
    """Intercept and slope over mass of the thesis's regression (section 5.4), or None if it printed none."""
    terms = published.regressions[published.regressions["quantity"] == quantity].set_index("term")
    if not {"constant", "Mass"} <= set(terms.index):
        return None
    intercept, slope = terms["coefficient"].loc[["constant", "Mass"]]
    return float(intercept), float(slope)


def _first_screen(run: PublishedRun) -> dict[str, Any]:
    finding = answers.constant_frequency_finding(run)
    return {
        "reference_mass": f"{run.reference_mass:.3g}",
        "levels": posterior.level_rows(run),
        "sureness": posterior.sureness(run),
        "exponents": posterior.exponent_rows(run),
        "conclusion": answers.mass_conclusion(run),
        "frequency": answers.frequency_sentence(run),
        "constant_frequency": None if finding is None else f"finding-{finding + 1}",
        "worst": thesis_tables.findings(run)[:3],
        "severities": thesis_tables.severities(run),
        "doubt": answers.doubt_words(run),
        "agreement": thesis_tables.agreement(run),
    }


def _posterior(run: PublishedRun, lines: ThesisLines) -> dict[str, Any]:
    kept = {quantity: kept_share(run, quantity) for quantity in posterior.QUANTITIES}
    return {
        "shrinkage_plots": [shrinkage_figure(run, quantity) for quantity in posterior.QUANTITIES],
        "kept": posterior_tables.shares(run, kept),
        "estimates_table": posterior_tables.estimates_table(run),
        "mass_plots": [mass_figure(run, quantity, lines[quantity]) for quantity in posterior.QUANTITIES],
        "lines_table": posterior_tables.lines_table(run, lines),
        "exponent_plots": [
            exponent_figure(run, quantity)
            for quantity in posterior.QUANTITIES
            if run.has(f"mass_exponent_{quantity}")
        ],
        "hypotheses_table": shared_tables.hypotheses_table(run.hypotheses),
        "effects_plots": {
            words: [
                effects_figure(run, quantity, level)
                for quantity in posterior.QUANTITIES
                if run.has(f"{level}_effect_{quantity}")
            ]
            for level, words in _LEVELS.items()
        },
        "differs": {words: remarks.who_differs(run, level) for level, words in _LEVELS.items()},
        "population_table": shared_tables.summary_table(run.summary, (*_POPULATION, "residual_correlation")),
    }


def _model_checks(run: PublishedRun) -> dict[str, Any]:
    schemes = list(dict.fromkeys(run.comparison["scheme"]))
    return {
        "comparison_plots": [comparison_figure(run.comparison, scheme) for scheme in schemes],
        "comparison_table": check_tables.comparison_table(run),
        "best": remarks.best_explanations(run.comparison),
        "prior_remark": remarks.prior_remark(run.sensitivity),
        "sensitivity_table": shared_tables.sensitivity_table(run.sensitivity),
        "predictive_plots": [predictive_figure(run, quantity) for quantity in posterior.QUANTITIES],
        "inside": {quantity: inside_share(run, quantity) for quantity in posterior.QUANTITIES},
        "checks_table": check_tables.checks_table(run),
        "diagnostics_table": shared_tables.diagnostics_table(run.diagnostics),
    }


def _published(run: PublishedRun, published: PublishedTables) -> dict[str, Any]:
    return {
        "correlation_plots": [
            correlations_plot(published, quantity, averages=averages)
            for averages in (False, True)
            for quantity in posterior.QUANTITIES
        ],
        "mass_plots_thesis": [mass_plot(published, quantity) for quantity in posterior.QUANTITIES],
        "reproduction_table": thesis_tables.reproduction_table(run),
        "findings": thesis_tables.findings_by_severity(run),
    }


def _provenance(run: PublishedRun) -> dict[str, Any]:
    described = run.about.get("model", {})
    return {
        "formulas": model_words.formulas(described),
        "priors_table": model_words.priors_table(described),
        "settings_table": settings_table(described, model_words.TOLD_ELSEWHERE),
        "versions": run.about.get("versions", {}),
    }
