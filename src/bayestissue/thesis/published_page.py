"""The whole page of the published analysis: its tables, and words that follow from the numbers."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np

from bayestissue.base.outline import counted
from bayestissue.base.remedies import codes_in
from bayestissue.inference.checking.findings import warned_codes
from bayestissue.inference.results.meanings import UNITS
from bayestissue.recordings.dataset.published import read_published
from bayestissue.reports.figures.theme import Figure
from bayestissue.reports.pages import posterior
from bayestissue.reports.pages.comparison import comparison_figure
from bayestissue.reports.pages.page import render_page, worded
from bayestissue.reports.pages.page_tables import Field, Table, shown, table_of_cells, tag
from bayestissue.reports.pages.posterior import (
    CONSTANT,
    FIXED,
    QUANTITIES,
    SURE,
    differing,
    exponent,
    hypothesis_probability,
    spread,
    sureness,
)
from bayestissue.reports.pages.wording import listed, relative, significant
from bayestissue.thesis import published_run
from bayestissue.thesis.audit import SEVERITIES, TEXTS
from bayestissue.thesis.published_run import PublishedRun
from bayestissue.thesis.reproduction.conditions import Quantity
from bayestissue.thesis.reproduction.relations import printed_line


def checks_table(run: PublishedRun) -> Table:
    """`predictive_checks.csv`: statistics of the published numbers beside what the model predicts."""
    return shown(
        "predictive_checks",
        run.predictive_checks,
        mark=lambda row: (
            "" if row["predicted_low"] <= row["observed"] <= row["predicted_high"] else "disagrees"
        ),
    )


def estimates_table(run: PublishedRun) -> Table:
    """Each published impact beside the posterior of that person in that condition."""
    columns = {"impact": run.labels("impact")}
    for q in QUANTITIES:
        spreads = [spread(draws) for draws in run.draws(q).T]
        observed = run.observed(f"{q}_observed")
        columns[f"published {q} ({UNITS[q]})"] = [significant(value, 5) for value in observed]
        columns[f"posterior {q}"] = [one.value for one in spreads]
        columns[f"{q}, 90 %"] = [one.range for one in spreads]
    return table_of_cells(zip(*columns.values(), strict=True), *columns, number=list(columns)[1:])


def lines_table(run: PublishedRun, printed: Mapping[Quantity, tuple[float, float]]) -> Table:
    """The thesis's regression lines over mass beside those through the posterior means."""
    rows = []
    for quantity, line in printed.items():
        for name, per, value in zip(("intercept", "slope"), ("", " per kg"), line, strict=True):
            if run.has(variable := f"linear_{name}_{quantity}"):
                drawn = spread(run.draws(variable))
                title, inside = f"{name} of {quantity} ({UNITS[quantity]}{per})", drawn.holds(value)
                thesis, answer = f"{value:g}".replace("-", "−"), "yes" if inside else "no"
                rows.append((title, thesis, drawn.value, drawn.range, answer))
    titles = ("straight line over mass", "thesis", "posterior", "90 %", "thesis inside")
    return table_of_cells(rows, *titles, number=titles[1:4])


def agreement(run: PublishedRun) -> dict[str, int]:
    """How many published numbers were recomputed, agree, differ, fill a lost cell, and can't be derived."""
    agree, differ = (int((run.reproduction["agrees"] == word).sum()) for word in ("true", "false"))
    derived = int((run.reproduction["reproduced"] != "").sum())
    return {
        "agree": agree,
        "differ": differ,
        "derived": derived,
        "filled_in": derived - agree - differ,
        "not_derived": len(run.reproduction) - derived,
        "all": len(run.reproduction),
    }


def reproduction_table(run: PublishedRun) -> Table:
    """Every published number beside the recomputed one."""
    return shown(
        "reproduction",
        run.reproduction.assign(reproduced=run.reproduction["reproduced"].map(_shortened)),
        fields={"agrees": Field("agrees", _agreement_tag)},
        mark=lambda row: "disagrees" if row["agrees"] == "false" else "",
    )


def _agreement_tag(row: Mapping[str, Any]) -> str:
    missing = ("note-level", "not printed" if row["reproduced"] else "not derivable")
    return tag(*{"true": ("yes", "agrees"), "false": ("no", "differs")}.get(row["agrees"], missing))


def _shortened(text: str) -> str:
    try:
        return significant(float(text), 6)
    except ValueError:
        return text


def severities(run: PublishedRun) -> str:
    """How many findings of which severity, in words."""
    counts = run.audit["severity"].value_counts()
    return listed([counted(counts[name], f"{name} finding") for name in SEVERITIES if name in counts])


def findings(run: PublishedRun) -> list[dict[str, Any]]:
    """Every finding of the audit, worst first: the columns of `audit.csv`, a coloured tag and an anchor."""
    rows = cast("list[dict[str, Any]]", run.audit.replace("ω_n", "ωₙ", regex=True).to_dict("records"))
    for position, row in enumerate(rows, start=1):
        severity = row["severity"]
        row["anchor"] = f"finding-{position}"
        row["tag"] = tag("note-level" if severity == "note" else severity, severity)
    return rows


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
    return [one for at, one in enumerate(findings(run)) if at != said][:_FIRST]


def mass_conclusion(run: PublishedRun) -> str:
    """What the exponent of K says about where its dependence on mass comes from."""
    omega = natural_frequencies(run)
    same = relative(np.sqrt(omega.max() / omega.min()) - 1)
    confirmed = constant_frequency_finding(run) is not None
    return worded("published", "mass", exponent(run, "K"), *_decided(run), same if confirmed else "")


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
    first_codes = warned_codes(run.diagnostics)
    misfit = any(row.mark for row in checks_table(run).rows)
    warnings = "; ".join([posterior.prior_remark(run.sensitivity), *run.comparison["warning"]])
    return render_page(
        "published.html",
        page=sys.modules[__name__],
        figures=published_run,
        posterior=posterior,
        first_codes=first_codes,
        codes=[*first_codes, *(["predictive-check"] * misfit), *codes_in(warnings)],
        record=record,
        run=run,
        published=published,
        lines={quantity: printed_line(published, quantity) for quantity in QUANTITIES},
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
    of_k, of_c = (published_run.posterior_mass_figure(run, q, lines[q]) for q in QUANTITIES)
    return [replace(of_k, chart=of_k.chart | {"height": _LOW}), of_c]


def comparison_figures(run: PublishedRun) -> list[Figure]:
    """How well each explanation predicts, a figure for each scheme of leaving out."""
    return [comparison_figure(run.comparison, name) for name in run.comparison["scheme"].unique()]
