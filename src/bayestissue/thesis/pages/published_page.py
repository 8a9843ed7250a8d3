"""The whole page of the published analysis; words of its first screen follow from the numbers."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

from bayestissue.dataset.published import PublishedTables, read_published
from bayestissue.inference.samplers.diagnostics import warned_codes
from bayestissue.remedies import Code, codes_in
from bayestissue.report import posterior
from bayestissue.report import tables as shared_tables
from bayestissue.report.comparison import comparison_figure
from bayestissue.report.page import render_page
from bayestissue.report.posterior import (
    CONSTANT,
    FIXED,
    SURE,
    effects_figure,
    exponent,
    exponent_figure,
    hypothesis_probability,
)
from bayestissue.report.tables import settings_table
from bayestissue.report.wording import listed, percent, relative, significant
from bayestissue.thesis.pages.published_figures import (
    correlations_plot,
    inside_share,
    kept_share,
    mass_plot,
    posterior_mass_figure,
    predictive_figure,
    shrinkage_figure,
)
from bayestissue.thesis.pages.published_run import (
    PublishedRun,
    agreement,
    checks_table,
    comparison_table,
    estimates_table,
    findings,
    findings_by_severity,
    lines_table,
    read_published_run,
    reproduction_table,
    severities,
)
from bayestissue.thesis.reproduction.conditions import Quantity
from bayestissue.thesis.reproduction.relations import printed_line


def natural_frequencies(run: PublishedRun) -> np.ndarray:
    """sqrt(K / M) of a typical person in each condition, posterior median [trial], rad/s."""
    return np.sqrt(np.median(run.draws("K_trial"), axis=0) / run.constant("mass_kg"))


def mass_conclusion(run: PublishedRun) -> str:
    """What the exponent of K says about where its dependence on mass comes from."""
    beta = exponent(run, "K")
    if beta is None:
        return "This model has no mass exponent, so it can't tell where a dependence on mass comes from."
    constant = hypothesis_probability(run, "K", CONSTANT)
    fixed = hypothesis_probability(run, "K", FIXED)
    if constant > SURE and constant_frequency_finding(run) is not None:
        omega = natural_frequencies(run)
        same = relative(np.sqrt(omega.max() / omega.min()) - 1)
        return (
            f"Made by the method: ωₙ is the same to {same} at every mass, so K = Mωₙ² is only the mass "
            "rescaled. A constant ωₙ means that the fit carried no information on the tissue."
        )
    if constant > SURE:
        return (
            "K grows in proportion to mass: that is what a method gives whose ωₙ carries no information on "
            "the tissue, since K = Mωₙ²."
        )
    if fixed > SURE:
        return "K does not depend on mass in practice: the estimates behave as a tissue of fixed stiffness."
    if beta.holds(0) or beta.holds(1):
        return "The data do not decide between a fixed stiffness and a constant natural frequency."
    if beta.high < 0:
        return "K falls as mass grows, which neither a fixed stiffness nor a constant ωₙ explains."
    if beta.low > 1:
        return "K grows faster than the mass, which neither a fixed stiffness nor a constant ωₙ explains."
    return (
        "K grows with mass, but more slowly than K = Mωₙ² with a constant ωₙ would: "
        "neither explanation suffices alone."
    )


def constant_frequency_finding(run: PublishedRun) -> int | None:
    """The row of the audit that finds K/M (or ωₙ) constant, or None if the audit doesn't say so."""
    text = run.audit["what"] + " " + run.audit["explanation"]
    about_ratio = text.str.contains(r"K\s*/\s*M\b|ω_?n|ωₙ|omega_n|natural frequency", flags=re.IGNORECASE)
    says_constant = text.str.contains(
        r"constant|hardly|no information|does not vary|one curve|same", flags=re.IGNORECASE
    )
    rows = run.audit.index[about_ratio & says_constant & (run.audit["severity"] == "major")]
    return int(rows[0]) if len(rows) else None


def doubt_words(run: PublishedRun) -> str:
    """What the audit says of the published figures, to stand after "which the audit"."""
    majors = int((run.audit["severity"] == "major").sum())
    return "doubts" if majors else "has nothing major against"


def frequency_sentence(run: PublishedRun) -> str:
    """How much ωₙ varies over the conditions, beside how much the mass does."""
    omega, mass = natural_frequencies(run), run.constant("mass_kg")
    return (
        f"Over the {len(mass)} conditions the mass varies by a factor of "
        f"{significant(mass.max() / mass.min(), 2)}, ωₙ = √(K/M) of a typical person by one of "
        f"{significant(omega.max() / omega.min(), 3)}, from {significant(omega.min())} to "
        f"{significant(omega.max())} rad/s."
    )


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


def published_page(folder: Path, record: dict[str, Any]) -> str:
    """The HTML of the report of the `reproduce` run in ``folder``.

    Raises:
        InputError: a file of the run lacks or isn't what a run writes.
    """
    run = read_published_run(folder, record)
    # A run of other tables than the thesis's own carries them along.
    own_tables = folder / "published"
    published = read_published(own_tables if own_tables.is_dir() else None)
    lines = {quantity: printed_line(published, quantity) for quantity in posterior.QUANTITIES}
    return render_page(
        "published.html",
        title="Published K and C, re-analysed",
        subtitle=_subtitle(run),
        contents=_CONTENTS,
        first_codes=warned_codes(run.diagnostics),
        codes=[*warned_codes(run.diagnostics), *_further_codes(run)],
        record=record,
        **_first_screen(run),
        **_posterior(run, lines),
        **_model_checks(run),
        **_published(run, published, lines),
        **_provenance(run),
    )


def _further_codes(run: PublishedRun) -> list[Code]:
    """The codes of the warnings in sections below the first screen."""
    failed = any(row.mark for row in checks_table(run).rows)
    said = "; ".join([posterior.prior_remark(run.sensitivity), *run.comparison["warning"]])
    return [*(("predictive-check",) if failed else ()), *codes_in(said)]


def _subtitle(run: PublishedRun) -> str:
    impacts, people, conditions = (len(run.labels(name)) for name in ("impact", "subject", "trial"))
    return f"Stiffness K, damping C: {impacts} impacts, {people} people, {conditions} conditions"


def _first_screen(run: PublishedRun) -> dict[str, Any]:
    finding = constant_frequency_finding(run)
    return {
        "reference_mass": f"{run.reference_mass:.3g}",
        "levels": posterior.levels(run),
        "sureness": posterior.sureness(run),
        "exponents": posterior.exponent_rows(run),
        "conclusion": mass_conclusion(run),
        "frequency": frequency_sentence(run),
        "constant_frequency": None if finding is None else f"finding-{finding + 1}",
        "worst": findings(run)[:3],
        "severities": severities(run),
        "doubt": doubt_words(run),
        "agreement": agreement(run),
    }


def _posterior(run: PublishedRun, lines: ThesisLines) -> dict[str, Any]:
    shares = [f"{percent(kept_share(run, quantity))} for {quantity}" for quantity in posterior.QUANTITIES]
    return {
        "shrinkage_plots": [shrinkage_figure(run, quantity) for quantity in posterior.QUANTITIES],
        "kept": listed(shares),
        "estimates_table": estimates_table(run),
        "mass_plots": [
            posterior_mass_figure(run, quantity, lines[quantity]) for quantity in posterior.QUANTITIES
        ],
        "lines_table": lines_table(run, lines),
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
        "differs": {words: posterior.who_differs(run, level) for level, words in _LEVELS.items()},
        "population_table": shared_tables.summary_table(run.summary, (*_POPULATION, "residual_correlation")),
    }


def _model_checks(run: PublishedRun) -> dict[str, Any]:
    schemes = list(dict.fromkeys(run.comparison["scheme"]))
    return {
        "comparison_plots": [comparison_figure(run.comparison, scheme) for scheme in schemes],
        "comparison_table": comparison_table(run),
        "best": posterior.best_explanations(run.comparison),
        "prior_remark": posterior.prior_remark(run.sensitivity),
        "sensitivity_table": shared_tables.sensitivity_table(run.sensitivity),
        "predictive_plots": [predictive_figure(run, quantity) for quantity in posterior.QUANTITIES],
        "inside": {quantity: inside_share(run, quantity) for quantity in posterior.QUANTITIES},
        "checks_table": checks_table(run),
        "diagnostics_table": shared_tables.diagnostics_table(run.diagnostics),
    }


def _published(run: PublishedRun, published: PublishedTables, lines: ThesisLines) -> dict[str, Any]:
    return {
        "correlation_plots": [
            correlations_plot(published, quantity, averages=averages)
            for averages in (False, True)
            for quantity in posterior.QUANTITIES
        ],
        "mass_plots_thesis": [
            mass_plot(published, quantity, lines[quantity]) for quantity in posterior.QUANTITIES
        ],
        "reproduction_table": reproduction_table(run),
        "findings": findings_by_severity(run),
    }


def _provenance(run: PublishedRun) -> dict[str, Any]:
    described = run.record.get("model", {})
    return {
        "formulas": shared_tables.formulas(described),
        "priors_table": shared_tables.priors_table(described),
        "settings_table": settings_table(described, shared_tables.SHOWN_ELSEWHERE),
        "versions": run.record.get("versions", {}),
    }
