"""The whole page of the published analysis; words of its first screen follow from the numbers."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from bayestissue.base.remedies import Code, codes_in
from bayestissue.inference.checking.findings import warned_codes
from bayestissue.recordings.dataset.published import read_published
from bayestissue.reports.figures.theme import Figure
from bayestissue.reports.pages import posterior
from bayestissue.reports.pages.comparison import comparison_figure
from bayestissue.reports.pages.page import render_page, worded
from bayestissue.reports.pages.posterior import (
    CONSTANT,
    FIXED,
    QUANTITIES,
    SURE,
    differing,
    exponent,
    hypothesis_probability,
    sureness,
)
from bayestissue.reports.pages.wording import relative
from bayestissue.thesis.audit import TEXTS
from bayestissue.thesis.pages import published_figures, published_run
from bayestissue.thesis.pages.published_run import PublishedRun
from bayestissue.thesis.reproduction.conditions import Quantity
from bayestissue.thesis.reproduction.relations import printed_line


def natural_frequencies(run: PublishedRun) -> np.ndarray:
    """sqrt(K / M) of a typical person in each condition, posterior median [trial], rad/s."""
    return np.sqrt(np.median(run.draws("K_trial"), axis=0) / run.constant("mass_kg"))


def headline(run: PublishedRun) -> str:
    """What K does with the mass, in a few words."""
    return worded("published", "headline", exponent(run, "K"), *_decided(run))


def _decided(run: PublishedRun) -> list[bool]:
    """Whether K is as good as surely fixed, and whether in proportion to the mass."""
    return [hypothesis_probability(run, "K", hypothesis) > SURE for hypothesis in (FIXED, CONSTANT)]


def first_findings(run: PublishedRun) -> list[dict[str, Any]]:
    """The worst findings of the audit but that which the headline says."""
    said = constant_frequency_finding(run)
    return [one for at, one in enumerate(published_run.findings(run)) if at != said][:_FIRST]


def mass_conclusion(run: PublishedRun) -> str:
    """What the exponent of K says about where its dependence on mass comes from."""
    omega = natural_frequencies(run)
    same = relative(np.sqrt(omega.max() / omega.min()) - 1)
    found = constant_frequency_finding(run) is not None
    return worded("published", "mass", exponent(run, "K"), *_decided(run), same if found else "")


def constant_frequency_finding(run: PublishedRun) -> int | None:
    """The row of the audit that finds K/M (or ωₙ) constant, or None if the audit doesn't say so."""
    rows = run.audit.index[run.audit["what"] == TEXTS["plausibility"]["constant_natural_frequency"]["what"]]
    return int(rows[0]) if len(rows) else None


def people_sentence(run: PublishedRun) -> str:
    """By how much people differ in K and in C, and who by a 90 % interval."""
    between = [f"{row['subject']} in {row['quantity']}" for row in sureness(run) if "subject" in row]
    people = {person for of_quantity in differing(run, "subject").values() for person in of_quantity}
    return worded("published", "people", between, sorted(people))


# Findings on the first screen, and pixels of its figure.
_FIRST, _LOW = 4, 200
POPULATION = (
    *(f"{stem}_{q}" for stem in ("intercept", "mass_exponent") for q in QUANTITIES),
    *(f"sd_{level}_{q}" for level in ("subject", "trial", "impact") for q in QUANTITIES),
    "residual_correlation",
)


def published_page(folder: Path, record: dict[str, Any]) -> str:
    """The HTML of the report of the `reproduce` run in ``folder``: its template has each section made.

    Raises:
        InputError: a file of the run lacks or isn't what a run writes.
    """
    run = PublishedRun.read(folder, record).complete()
    published = read_published()
    lines = {quantity: printed_line(published, quantity) for quantity in QUANTITIES}
    return render_page(
        "published.html",
        page=sys.modules[__name__],
        figures=published_figures,
        run_tables=published_run,
        posterior=posterior,
        first_codes=warned_codes(run.diagnostics),
        codes=[*warned_codes(run.diagnostics), *_further_codes(run)],
        record=record,
        run=run,
        published=published,
        lines=lines,
    )


def of_quantities(
    figure: Callable[..., Figure], source: Any, *, needs: str = "", **options: Any
) -> list[Figure]:
    """A figure of K, and the same of C, of a run or the tables.

    ``needs`` is how the name of the variable begins without which a run has no such figure.
    """
    return [figure(source, q, **options) for q in QUANTITIES if not needs or source.has(needs + q)]


def mass_figures(run: PublishedRun, lines: Mapping[Quantity, tuple[float, float]]) -> list[Figure]:
    """K and C over the mass, each with the thesis's line; that of K is low, for the first screen."""
    of_k, of_c = (published_figures.posterior_mass_figure(run, q, lines[q]) for q in QUANTITIES)
    return [replace(of_k, chart=of_k.chart | {"height": _LOW}), of_c]


def comparison_figures(run: PublishedRun) -> list[Figure]:
    """How well each explanation predicts, a figure for each scheme of leaving out."""
    return [comparison_figure(run.comparison, name) for name in run.comparison["scheme"].unique()]


def _further_codes(run: PublishedRun) -> list[Code]:
    """The codes of the warnings in sections below the first screen."""
    failed = any(row.mark for row in published_run.checks_table(run).rows)
    said = "; ".join([posterior.prior_remark(run.sensitivity), *run.comparison["warning"]])
    return [*(("predictive-check",) if failed else ()), *codes_in(said)]
