"""The model, its settings and its priors in words, from the model as the run resolved it."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from typing import Any

from bayestissue.report.tables import Row, Table, columns


def settings_table(content: Mapping[str, Any], shown_elsewhere: Collection[str] = ()) -> Table:
    """Every key of ``content`` and its value, one a row; inner tables' keys are joined with a dot.

    The top-level keys in ``shown_elsewhere`` are left out.
    """
    remaining = {key: value for key, value in content.items() if key not in shown_elsewhere}
    return Table(columns("setting", "value", words=("value",)), [Row(pair) for pair in _flat(remaining)])


def _flat(content: Mapping[str, Any], above: str = "") -> Iterator[tuple[str, str]]:
    for key, value in content.items():
        name = f"{above}{key}"
        if isinstance(value, Mapping):
            yield from _flat(value, f"{name}.")
        else:
            yield name, plain(value)


def plain(value: Any) -> str:
    """One value of a TOML or JSON file as a reader would write it."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:g}".replace("-", "−")
    if isinstance(value, list):
        return ", ".join(plain(item) for item in value)
    return "not set" if value is None else str(value)


_MEANINGS = {
    "intercept": "log of a typical person's value at the reference mass",
    "mass_exponent": "slope of the log on log mass",
    "covariate": "change of the log for one standard deviation of another covariate",
    "sd_subject": "spread between people, log scale",
    "sd_trial": "spread between conditions beyond the covariates, log scale",
    "sd_group": "spread between the levels of another grouping, log scale",
    "sd_slope": "spread between levels of the mass exponent, or of the change of the log for one standard "
    "deviation of another covariate",
    "sd_impact": "spread of one person's impacts in one condition, log scale",
    "residual_correlation": "correlation of K and C from impact to impact",
    "noise": "mean over impacts of the log of the noise, as a fraction of the trace's peak",
    "sd_noise": "spread of that log between impacts",
    "atanh_theta1": "mean over impacts of artanh θ₁: 0 is white, minus infinity is θ₁ = −1",
    "atanh_noise_correlation": "mean over impacts of artanh of the noise's correlation from sample to sample",
    "sd_atanh_noise_correlation": "spread of that between impacts",
    "discrepancy": "mean over impacts of the log of the discrepancy's rms, as a fraction of the trace's peak",
    "sd_discrepancy": "spread of that log between impacts",
    "element": "log of the element's further parameters",
    "sd_atanh_theta1": "spread of artanh θ₁ between impacts",
}
SHOWN_ELSEWHERE = ("name", "description", "formula", "priors")


def priors_table(model: Mapping[str, Any], unused: Collection[str] = ()) -> Table:
    """Every prior but the ``unused``: of what, for which quantity, and the distribution in words."""
    rows = [
        Row((name, _MEANINGS.get(name, ""), quantity, distribution))
        for name, prior in dict(model.get("priors", {})).items()
        if name not in unused
        for quantity, distribution in _distributions(prior)
    ]
    return Table(columns("parameter", "meaning", "quantity", "prior", words=("meaning",)), rows)


def _distributions(prior: Any) -> Iterator[tuple[str, str]]:
    if isinstance(prior, Mapping) and "distribution" not in prior:
        for quantity, inner in prior.items():
            # Of an element's parameters there are the mean over impacts and the spread.
            named = isinstance(inner, Mapping) and "distribution" not in inner
            for part, words in _distributions(inner):
                yield (f"{quantity}, {part}" if named else quantity), words
    else:
        yield "both", distribution_words(prior)


def distribution_words(prior: Any) -> str:
    """A distribution as a model file writes it, in words: "half-normal, scale 0.5"."""
    if not isinstance(prior, Mapping):
        return plain(prior)
    settings = [f"{name} {plain(value)}" for name, value in prior.items() if name != "distribution"]
    return ", ".join([str(prior["distribution"]), *settings])


def formulas(model: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Pairs of left and right side, such as ``("log K", "log(mass_kg) + (1|subject)")``."""
    return [(f"log {name}", str(right)) for name, right in dict(model.get("formula", {})).items()]
