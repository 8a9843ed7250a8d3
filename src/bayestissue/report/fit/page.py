"""The whole page of a fit of recorded traces."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from bayestissue.errors import codes_of
from bayestissue.figures.impacts import factors
from bayestissue.hierarchy.formulas.formula import left_out_words
from bayestissue.hierarchy.formulas.group_terms import stem_of
from bayestissue.hierarchy.untried import untried_words
from bayestissue.inference.results.meanings import ONE_IMPACT
from bayestissue.inference.samplers.diagnostics import warned_codes
from bayestissue.outline import counted
from bayestissue.remedies import Code
from bayestissue.report import posterior, tables
from bayestissue.report.answers_page import question_lines, questions_table
from bayestissue.report.fit import (
    answers,
    checks,
    estimates,
    explorer,
    figures,
    population,
    study,
    traces,
    words,
)
from bayestissue.report.fit.run import FitRun, read_fit_run
from bayestissue.report.page import render_page
from bayestissue.report.wording import listed

_CONTENTS = (
    ("estimates", "Impacts"),
    ("people", "People, sides and conditions"),
    ("reliability", "Repeatability"),
    ("mass", "Mass"),
    ("residuals", "Does the model fit?"),
    ("more", "More"),
)
_FIRST = ("subject", "trial")
# What the template calls for the words, tables and figures of a section.
_SECTIONS: dict[str, Any] = {
    **{"answers": answers, "checks": checks, "estimates": estimates, "explorer": explorer},
    **{"figures": figures, "population": population, "posterior": posterior, "study": study},
    **{"tables": tables, "traces": traces, "words": words},
    **{"question_lines": question_lines, "questions_table": questions_table},
}


def fit_page(folder: Path, record: dict[str, Any]) -> str:
    """The HTML of the report of the `fit` run in ``folder``.

    Raises:
        InputError: a file of the run lacks or isn't what a run writes.
    """
    return page_of(read_fit_run(folder, record))


def page_of(run: FitRun, **served: Any) -> str:
    """The HTML of the report of a `fit`: its template has each section's words, tables and figures made.

    ``served`` is what the template takes besides where a server answers the page.
    """
    prior_remark, model = posterior.prior_remark(run.sensitivity), run.record.get("model", {})
    return render_page(
        "fit.html",
        title=f"K and C from the traces of {run.record['dataset']}",
        subtitle=_subtitle(run),
        nouns=run.nouns,
        contents=_CONTENTS,
        first_codes=_codes(run),
        codes=[*_codes(run), *codes_of([prior_remark])],
        run=run,
        record=run.record,
        model=model,
        prior_remark=prior_remark,
        untried=_untried(run),
        one_impact=ONE_IMPACT,
        terms_left_out=left_out_words(run.record.get("terms_left_out", [])),
        # The thesis's estimates stand first where the model file asks for a comparison, and folded elsewhere.
        thesis=bool(model.get("comparison", {}).get("formulas")),
        factors=factors(run.impacts_table),
        residuals=traces.residuals(run),
        one_step_p=traces.one_step_p(run),
        **_SECTIONS,
        **_population(run),
        **served,
    )


def _codes(run: FitRun) -> list[Code]:
    """The codes of the first screen's warnings, the verdict's first."""
    left_out = left_out_words(run.record.get("terms_left_out", []))
    said = [*_untried(run), left_out, *[ONE_IMPACT] * (len(run.impacts) == 1)]
    return [*warned_codes(run.diagnostics), *codes_of(said)]


def _untried(run: FitRun) -> list[str]:
    """Columns that vary and that no formula is of, each as a question."""
    return untried_words(run.record.get("columns_not_used", []))


def _subtitle(run: FitRun) -> str:
    counts = (
        counted(len(run.impacts), "impact"),
        counted(run.people_count, "person", "people"),
        counted(len(run.labels("trial")), "condition"),
    )
    return f"{', '.join(counts)}; model “{run.record.get('model', {}).get('name', '')}”"


def _population(run: FitRun) -> dict[str, Any]:
    slopes = population.own_slopes(run)
    ranked = {
        level: [
            q for q in run.responses if run.has(f"{stem_of(level)}_effect_{q}") and run.of_levels(q, level)
        ]
        for level in dict.fromkeys((*_FIRST, *population.groupings(run)))
    }
    return {
        "groups": [
            {
                "name": posterior.group_words(level)[1],
                "plots": [figures.people(run, quantity, level) for quantity in quantities],
                "responses": listed([run.symbols.get(q, q) for q in quantities]),
                "differs": posterior.who_differs(run, level, run.of_tissue),
            }
            for level, quantities in ranked.items()
            if quantities
        ],
        "repeat_plots": [
            plot
            for quantity in posterior.QUANTITIES
            if len((plot := figures.repeatability(run, quantity)).data) > 1
        ],
        "slopes": slopes,
        "slope_plots": [figures.slope(run, slope) for slope in slopes],
        "exponent_plots": [
            figures.exponent(run, quantity)
            for quantity in dict.fromkeys((*answers.answering(run).values(), posterior.OWN_DEPTH))
            if run.has(f"mass_exponent_{quantity}")
        ],
    }
