"""The whole page of a fit of recorded traces."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from bayestissue.hierarchy.formulas.formula import left_out_words
from bayestissue.hierarchy.formulas.group_terms import stem_of
from bayestissue.inference.results.meanings import ONE_IMPACT, not_used_words
from bayestissue.inference.samplers.diagnostics import warned_codes
from bayestissue.outline import counted
from bayestissue.remedies import Code, codes_in
from bayestissue.report import model_words, posterior, posterior_tables
from bayestissue.report.answers_page import question_lines, questions_table
from bayestissue.report.fit import answers, depth, estimates, predictions, sources, study, tables, words
from bayestissue.report.fit.figures import (
    estimates_figure,
    lag_one_figure,
    mass_figure,
    ranked_figure,
    spreads_figure,
    traces_figure,
    whiteness_figure,
)
from bayestissue.report.fit.groupings import groupings, own_slopes, slope_figure, slope_words
from bayestissue.report.fit.run import FitRun, read_fit_run
from bayestissue.report.model_words import settings_table
from bayestissue.report.page import render_page
from bayestissue.report.posterior_figures import exponent_figure
from bayestissue.report.style import style
from bayestissue.report.tables import Row, Table, columns, table_of
from bayestissue.report.wording import listed

_CONTENTS = (
    ("estimates", "Impacts"),
    ("predictions", "Predictions"),
    ("residuals", "Residuals"),
    ("people", "People and conditions"),
    ("comparisons", "Comparisons"),
    ("reliability", "Reliability"),
    ("mass", "Mass"),
    ("population", "Population"),
    ("sources", "What makes the intervals"),
    ("agreement", "Agreement of methods"),
    ("chain", "Measuring chain"),
    ("left-out", "Leaving out"),
    ("priors", "Priors"),
    ("limits", "Limits"),
    ("diagnostics", "Diagnostics"),
    ("model", "Model"),
    ("provenance", "Provenance"),
)
_FIRST = ("subject", "trial")


def fit_page(folder: Path, record: dict[str, Any]) -> str:
    """The HTML of the report of the `fit` run in ``folder``.

    Raises:
        InputError: a file of the run lacks or isn't what a run writes.
    """
    run = read_fit_run(folder, record)
    with style():
        return render_page(
            "fit.html",
            title=f"K and C from the traces of {record.get('dataset') or folder.name}",
            subtitle=_subtitle(run),
            contents=_CONTENTS,
            first_codes=_codes(run),
            codes=[*_codes(run), *codes_in(posterior.prior_remark(run.sensitivity))],
            record=record,
            **_first_screen(run),
            **_impacts(run),
            **_predictions(run),
            **_population(run),
            **_study(run),
            **_checks(run),
            **_provenance(run),
        )


def _codes(run: FitRun) -> list[Code]:
    """The codes of the first screen's warnings, the verdict's first."""
    said = [*_formula_remarks(run), *[ONE_IMPACT] * (len(run.impacts) == 1)]
    return [*warned_codes(run.diagnostics), *codes_in(" ".join(said))]


def _formula_remarks(run: FitRun) -> list[str]:
    """What the formulas leave out, of what they might be of: terms and columns."""
    record = run.record
    return [
        left_out_words(record.get("terms_left_out", [])),
        not_used_words(record.get("columns_not_used", [])),
    ]


def _subtitle(run: FitRun) -> str:
    counts = (
        counted(len(run.impacts), "impact"),
        counted(run.people, "person", "people"),
        counted(len(run.labels("trial")), "condition"),
    )
    return f"{', '.join(counts)}; model “{run.record.get('model', {}).get('name', '')}”"


def _first_screen(run: FitRun) -> dict[str, Any]:
    return {
        "undescribed": words.undescribed_words(run),
        "contradicted": run.chain.get("passed", True) is False,
        "reference_mass": f"{run.reference_mass:.3g}",
        "levels": posterior.level_rows(run),
        "alone": answers.the_only_impact(run),
        "one_impact": ONE_IMPACT,
        "of": answers.person_words(run),
        "terms_left_out": left_out_words(run.record.get("terms_left_out", [])),
        "formula_words": list(filter(None, _formula_remarks(run))),
        "averaged": answers.averaged_sentence(run),
        "people_averaged": answers.averaged_over(run, "K_subject"),
        "method": answers.method_sentence(run),
        "sureness": [
            {**row, "one": answers.impact_sureness(run, row["quantity"])} for row in posterior.sureness(run)
        ],
        "held": answers.held_sentence(run),
        "exponents": posterior.exponent_rows(run, depth.answering(run)),
        "common_depth": depth.depth_words(run),
        "own_depth": depth.depth_sentence(run),
        "conclusion": answers.mass_conclusion(run),
        "contrast": answers.contrast_sentence(run),
        "first_contrasts": study.first_contrasts(run),
        "questions": question_lines(run.questions),
        "questions_table": questions_table(run.questions),
    }


def _impacts(run: FitRun) -> dict[str, Any]:
    held = [row for quantity in posterior.QUANTITIES for row in estimates.held_by_intervals(run, quantity)]
    return {
        "simulated": run.truth is not None,
        "estimate_plots": [estimates_figure(run, quantity) for quantity in posterior.QUANTITIES],
        "estimates_table": estimates.estimates_table(run),
        "held_table": table_of(held, *tables.COVERAGE),
        "thinned": words.thinned(run),
    }


def _predictions(run: FitRun) -> dict[str, Any]:
    chosen, left = predictions.chosen_impacts(run), predictions.residuals(run)
    one_step, tested = predictions.one_step_p(run), np.array(list(run.tested.values()))
    return {
        "recorded": run.shown,
        "chosen": len(chosen),
        "traces_plot": traces_figure(run, chosen),
        "other_noise": words.other_noise(run, left),
        "residual_words": words.residual_words(run, left, one_step),
        "residual_plots": [
            whiteness_figure(np.array(list(run.tested.values())), one_step),
            lag_one_figure(left),
        ],
        "tested": tested.size or len(left.which),
        "total": len(run.impacts),
    }


def _population(run: FitRun) -> dict[str, Any]:
    levels = {level: posterior.group_words(level)[1] for level in dict.fromkeys((*_FIRST, *groupings(run)))}
    slopes = own_slopes(run)
    ranked = {
        level: [q for q in run.responses if run.has(f"{stem_of(level)}_effect_{q}")] for level in levels
    }
    return {
        "ranked_plots": {
            name: [ranked_figure(run, quantity, level) for quantity in ranked[level]]
            for level, name in levels.items()
        },
        "responses": {name: listed(ranked[level]) for level, name in levels.items()},
        "differs": {name: posterior.who_differs(run, level, run.responses) for level, name in levels.items()},
        "slope_words": [slope_words(run, slope) for slope in slopes],
        "slope_plots": [slope_figure(run, slope) for slope in slopes],
        "slopes_table": posterior_tables.summary_table(run.summary, [slope.name for slope in slopes]),
        "mass_plots": [mass_figure(run, quantity) for quantity in posterior.QUANTITIES]
        if estimates.mass_varies(run)
        else [],
        "exponent_plots": [
            exponent_figure(run, quantity)
            for quantity in dict.fromkeys((*depth.answering(run).values(), posterior.OWN_DEPTH))
            if run.has(f"mass_exponent_{quantity}")
        ],
        "depth_words": depth.further_words(run),
        "hypotheses_table": posterior_tables.hypotheses_table(run.hypotheses),
        "spreads_plot": spreads_figure(run),
        "population_table": posterior_tables.summary_table(run.summary, tables.population_names(run)),
    }


def _study(run: FitRun) -> dict[str, Any]:
    return {
        "contrasts_table": study.contrasts_table(run),
        "contrasts_in_all": 0 if run.contrasts is None else len(run.contrasts),
        "equivalence": study.equivalence(run),
        "conditions_words": study.conditions_words(run),
        "matrices": study.matrices(run),
        "reliability_words": study.reliability_words(run),
        "another_day": study.another_day(run),
        "prior_words": study.prior_words(run),
        "reliability_table": study.reliability_table(run),
        "agreement_table": study.agreement_table(run),
        "agreement_plots": [study.agreement_figure(run, quantity) for quantity in posterior.QUANTITIES],
    }


def _checks(run: FitRun) -> dict[str, Any]:
    return {
        "sources_words": sources.sources_words(run),
        "sources_table": sources.sources_table(run),
        "declared": tables.declared_words(run),
        "chain_words": words.chain_words(run),
        "chain_table": tables.chain_table(run),
        "left_out_summary": tables.left_out_summary(run),
        "left_out_table": tables.left_out_table(run),
        "prior_remark": posterior.prior_remark(run.sensitivity),
        "sensitivity_table": posterior_tables.sensitivity_table(run.sensitivity),
        "limits": words.limits(run),
        "coverage_table": words.coverage_table(run),
        "diagnostics_table": posterior_tables.diagnostics_table(run.diagnostics),
        "route": run.diagnostics.get("route", {}).get("words", ""),
    }


def _provenance(run: FitRun) -> dict[str, Any]:
    described = run.record.get("model", {})
    left_out = [str(problem) for problem in run.record.get("left_out", [])]
    return {
        "likelihood_words": words.likelihood_words(run),
        "signal_words": words.signal_words(run),
        "formulas": model_words.formulas(described),
        "priors_table": model_words.priors_table(described, words.unused_priors(run)),
        "settings_table": settings_table(described, model_words.SHOWN_ELSEWHERE),
        "excluded": Table(
            columns("impact and reason", words=("impact and reason",)), [Row([reason]) for reason in left_out]
        ),
        "versions": run.record.get("versions", {}),
    }
