"""The whole page of a fit of recorded traces."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from bayestissue.base.errors import codes_of
from bayestissue.inference.checking.findings import warned_codes
from bayestissue.inference.results.meanings import ONE_IMPACT
from bayestissue.model.hierarchy.columns import untried_words
from bayestissue.model.hierarchy.formulas.formula import left_out_words
from bayestissue.reports.figures.impacts import factors
from bayestissue.reports.pages import posterior
from bayestissue.reports.pages.fit import answers, trace_predictions
from bayestissue.reports.pages.fit.fit_run import FitRun
from bayestissue.reports.pages.page import render_page


def fit_page(folder: Path, record: dict[str, Any]) -> str:
    """The HTML of the report of the `fit` run in ``folder``.

    Raises:
        InputError: a file of the run lacks or isn't what a run writes.
    """
    return page_of(FitRun.read(folder, record).complete())


def page_of(run: FitRun, **served: Any) -> str:
    """The HTML of the report of a `fit`: its template has each section's words, tables and figures made.

    ``served`` is what the template takes besides where a server answers the page.
    """
    prior_remark, record = posterior.prior_remark(run.sensitivity), run.record
    model, one_alone = record.get("model", {}), [ONE_IMPACT] * (len(run.impacts) == 1)
    untried = untried_words(record.get("columns_not_used", []))
    terms_left_out = left_out_words(record.get("terms_left_out", []))
    # Of the first screen's warnings, the verdict's first; columns in no formula have a note there.
    first_codes = [*warned_codes(run.diagnostics), *codes_of(one_alone or [terms_left_out])]
    return render_page(
        "fit.html",
        nouns=run.nouns,
        first_codes=first_codes,
        codes=[*first_codes, *codes_of([terms_left_out, *untried, prior_remark])],
        run=run,
        record=record,
        model=model,
        prior_remark=prior_remark,
        untried=untried,
        one_impact=ONE_IMPACT,
        terms_left_out=terms_left_out,
        factors=factors(run.impacts_table),
        residuals=trace_predictions.residuals(run),
        exponent_plots=[
            posterior.exponent_figure(run, quantity)
            for quantity in dict.fromkeys((*answers.answering(run).values(), posterior.OWN_DEPTH))
            if run.has(f"mass_exponent_{quantity}")
        ],
        **served,
    )
