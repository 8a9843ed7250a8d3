"""From a dataset and a model file to the arrays and the model of a fit."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd

from bayestissue.dataset.model import Dataset, Recorder
from bayestissue.elements import element
from bayestissue.elements.element import REFERENCE_DIAMETER_M
from bayestissue.errors import InputError, Problem
from bayestissue.hierarchy.design import Design, build_design
from bayestissue.hierarchy.effects import RESPONSES
from bayestissue.hierarchy.population import population_design
from bayestissue.hierarchy.specification import SIDE_BY_SIDE, ModelSpecification
from bayestissue.hierarchy.traces import Kind, Record, TraceData, TraceModel, nuisance_of
from bayestissue.likelihood.arma.displacement import displacement_record
from bayestissue.likelihood.element.coloured import colour_of
from bayestissue.likelihood.element.deceleration import DecelerationRecord
from bayestissue.likelihood.element.discrepancy import modes
from bayestissue.likelihood.element.recorder import Colour, LowPass
from bayestissue.likelihood.element.response import ElementRecord
from bayestissue.signal import Displacements, displacements
from bayestissue.signal.displacement import BEFORE, FEWEST_SAMPLES
from bayestissue.signal.filters import ahead_s, autocorrelation, delay
from bayestissue.signal.filters import modes as filter_modes
from bayestissue.signal.recorder_noise import white_share

KINDS: tuple[Kind, ...] = ("arma", "a2", "impact")


@dataclass(frozen=True)
class Prepared:
    """A fit ready to start."""

    model: TraceModel
    data: TraceData
    design: Design
    signal: Displacements
    impacts: pd.DataFrame


def prepare(dataset: Dataset, specification: ModelSpecification, *, source: str) -> Prepared:
    """Integrate the traces, evaluate the formulas and arrange everything for the model.

    Raises:
        InputError: the model's likelihood is not one of traces, its formulas ask for what this design can't
            identify or lack the people whose mass is in error, or a trace has too few samples in its window;
            ``source`` is the model file's name.
    """
    problems = unsuited(dataset, specification, source)
    if problems:
        raise InputError(problems)
    design = build_design(
        specification.formula,
        dataset.impacts,
        reference_mass_kg=specification.reference_mass_kg,
        source=source,
    )
    if specification.mass_error == "subject":
        problems = _without_people(design, source)
        if problems:
            raise InputError(problems)
    signal = displacements(dataset, specification.signal)
    problems = too_short(dataset, signal, source)
    if problems:
        raise InputError(problems)
    return assemble(dataset, specification, design, signal)


def too_short(dataset: Dataset, signal: Displacements, source: str) -> list[Problem]:
    """Impacts of too few samples for any fit, a problem each; ``source`` is the model file's name."""
    return [
        Problem(
            source,
            f"at least {FEWEST_SAMPLES} samples between contact and the end of the window",
            "Record faster, widen signal.window in the model, or leave the impact out (--skip-bad).",
            column="signal.window",
            impact=str(dataset.impacts["impact"].iloc[i]),
            value=int(signal.n_samples[i]),
            code="too-few-samples",
        )
        for i in np.flatnonzero(signal.n_samples < FEWEST_SAMPLES)
    ]


def assemble(
    dataset: Dataset, specification: ModelSpecification, design: Design, signal: Displacements
) -> Prepared:
    """Model and data of a fit whose design and displacements are made."""
    kind: Kind = specification.likelihood  # type: ignore[assignment]
    priors, discrepancy = specification.complete_priors(), specification.discrepancy == "always"
    autoregressive = specification.noise == "autoregressive"
    nuisance = nuisance_of(
        kind, specification.element, discrepancy=discrepancy, autoregressive=autoregressive
    )
    effects, columns = population_design(design, priors, nuisance)
    relative_mass_sd = float(dataset.uncertainty.relative_mass_sd)
    model = TraceModel(
        kind,
        effects,
        priors,
        specification.residual_correlation,
        relative_mass_sd,
        specification.mass_error if relative_mass_sd > 0 else "impact",
        specification.element,
        discrepancy,
        autoregressive,
    )
    record, peak = _record(dataset, specification, signal)
    data = TraceData(
        record,
        jax.device_put(columns),
        jax.device_put(effects.mean),
        jax.device_put(np.log(signal.mass)),
        jax.device_put(np.log(peak)),
    )
    return Prepared(model, data, design, signal, dataset.impacts)


def with_discrepancy(dataset: Dataset, specification: ModelSpecification, prepared: Prepared) -> Prepared:
    """The same fit with a discrepancy beside the element."""
    wider = specification.model_copy(update={"discrepancy": "always"})
    return assemble(dataset, wider, prepared.design, prepared.signal)


def unsuited(dataset: Dataset, specification: ModelSpecification, source: str) -> list[Problem]:
    """What the model asks for that these recordings can't give; ``source`` is the model file's name."""
    problems = []
    if specification.likelihood not in KINDS:
        problems.append(
            Problem(
                source,
                f"one of {', '.join(KINDS)}",
                "Choose a model of traces, such as models/arma.toml; published estimates go through "
                "`bayestissue reproduce`.",
                column="likelihood",
                value=specification.likelihood,
                code="unsuited-likelihood",
            )
        )
    if specification.likelihood == "impact" and dataset.quantity == "displacement":
        problems.append(
            Problem(
                source,
                '"arma" or "a2", since this dataset holds displacements',
                "Use models/arma.toml: the impact likelihood reads recorded decelerations.",
                column="likelihood",
                value="impact",
                code="unsuited-likelihood",
            )
        )
    if specification.likelihood != "impact" and specification.likelihood in KINDS and dataset.recorder:
        problems.append(
            Problem(
                source,
                f'"impact", since dataset.toml declares a low-pass ({dataset.recorder}), which an ARMA model '
                "of the displacement has no place for",
                "Use models/impact.toml. Without the table [recorder] this model would run, with K and C too "
                "small: `check` says by how much.",
                column="likelihood",
                value=specification.likelihood,
                code="low-pass-not-applied",
            )
        )
    if specification.likelihood == "impact" and specification.signal.filter != "none":
        problems.append(
            Problem(
                source,
                '"none", since a filter leaves noise that is neither white nor autoregressive',
                "Take signal.filter out: the likelihood itself tells impact from noise.",
                column="signal.filter",
                value=specification.signal.filter,
                code="unsuited-likelihood",
            )
        )
    return problems


def _without_people(design: Design, source: str) -> list[Problem]:
    """Formulas that leave no room for an error that all impacts of a person share."""
    problems = []
    for response in RESPONSES:
        if "subject" in design.responses[response].groups:
            continue
        left_out = [fault for fault in design.left_out.get(response, ()) if fault.term == "(1|subject)"]
        remedy = 'Add "+ (1|subject)", or set mass_error = "impact".'
        if left_out:
            remedy = f'Set mass_error = "impact": {left_out[0].reason}.'
        problems.append(
            Problem(
                source,
                '"(1|subject)" in it, since mass_error = "subject" gives each person an error of its own',
                remedy,
                column=f"formula.{response}",
                value=getattr(design.formulas, response),
                code="unsuited-likelihood",
            )
        )
    return problems


def _record(
    dataset: Dataset, specification: ModelSpecification, signal: Displacements
) -> tuple[Record, np.ndarray]:
    """The traces with the standard deviations of their linear errors, and each trace's peak."""
    chain, recorded = dataset.uncertainty, dataset.quantity == "displacement"
    velocity_sd = np.hypot(chain.velocity_sd_m_s, chain.relative_gain_sd * signal.velocity)
    # What a quiet part before contact tells of the offset replaces what was declared of it.
    offset_sd = np.where(np.isfinite(signal.offset_sd), signal.offset_sd, chain.offset_sd)
    start = (signal.n_samples, signal.first_sample_s, signal.dt)
    if specification.likelihood == "impact":
        # The likelihood asks the samples itself when contact was; what they said of it must not count twice.
        start = (signal.n_samples, signal.bracket_s, signal.dt)
        plain = specification.discrepancy != "always" and specification.noise == "white"
        # Of an impact along gravity an error of the gain is not one of the velocity.
        plain &= not signal.blurred.any()
        plain &= not (dataset.gravity and chain.relative_gain_sd)
        if specification.element != SIDE_BY_SIDE or not plain or dataset.recorder is not None:
            return _element_record(dataset, specification, signal, offset_sd)
        errors = np.stack([velocity_sd, offset_sd, signal.bracket_sd], axis=1)
        peak = np.abs(signal.deceleration).max(axis=1)
        record = (signal.deceleration, *start, signal.velocity, errors, signal.bracket_uniform)
        return DecelerationRecord.from_arrays(*record, gravity=signal.gravity), peak
    gravity = signal.gravity if specification.signal.equilibrium != "sample-mean" else 0.0
    level_sd = signal.velocity * signal.contact_time_sd
    # Along gravity a gain in error is an offset too, and a contact time a velocity.
    velocity_sd = np.hypot(velocity_sd, signal.gravity * signal.contact_time_sd)
    offset_sd = np.hypot(offset_sd, signal.gravity * chain.relative_gain_sd)
    if recorded:
        level_sd = np.hypot(level_sd, chain.offset_sd)
        velocity_sd, offset_sd = np.zeros_like(velocity_sd), np.zeros_like(offset_sd)
    peak = signal.peak_displacement
    if specification.signal.equilibrium == "estimated":
        level_sd = np.hypot(level_sd, peak)
    errors = np.stack([level_sd, velocity_sd, offset_sd], axis=1)
    return displacement_record(signal.x, *start, errors, gravity), peak


def common_depth(signal: Displacements) -> float:
    """The smallest of the greatest depths that the recorded windows show [m].

    It comes from the recordings, so that it is one number: the same for every impact and every draw.
    """
    return float((signal.x.max(axis=1) + signal.equilibrium).min())


def _element_record(
    dataset: Dataset,
    specification: ModelSpecification,
    signal: Displacements,
    offset_sd: np.ndarray,
) -> tuple[ElementRecord, np.ndarray]:
    """The same for any element, of which the impactor's diameter may matter."""
    chain, impacts = dataset.uncertainty, dataset.impacts
    size = impacts.get("diameter_m", pd.Series(REFERENCE_DIAMETER_M, impacts.index)).to_numpy(float)
    gain_sd, velocity_sd = (
        np.full(len(size), value) for value in (chain.relative_gain_sd, chain.velocity_sd_m_s)
    )
    if specification.element == SIDE_BY_SIDE and dataset.recorder is not None and not dataset.gravity:
        # In proportion to the velocity: one error, as of the likelihood without a filter.
        velocity_sd, gain_sd = np.hypot(velocity_sd, gain_sd * signal.velocity), np.zeros(len(size))
    optional: dict[str, Any] = {"gravity": signal.gravity} if dataset.gravity else {}
    contact_sd, uniform = signal.bracket_sd, signal.bracket_uniform
    lead = 0
    if dataset.recorder is not None:
        white = white_share(dataset, signal) if specification.noise == "white" else 1.0
        optional["low_pass"] = low_pass = _low_pass(dataset.recorder, signal.dt)
        lead = low_pass.lead
    if specification.discrepancy == "always":
        # It takes up what a wrong moment of contact does to a trace.
        basis, share = modes(signal.n_samples, signal.deceleration.shape[1])
        optional |= {"basis": basis, "share": share}
    if dataset.recorder is not None:
        # No force jumps behind it.
        reach = int(np.ceil(((signal.reach_s + delay(dataset.recorder)) / signal.dt).max())) + lead
    elif (
        specification.discrepancy != "always"
        and not element(specification.element).jumps
        and (signal.reach_s > 0).all()
    ):
        reach = min(int(np.ceil((signal.reach_s / signal.dt).max())), BEFORE)
    elif specification.discrepancy != "always" and signal.blurred.any():
        # Noise hides the jump: contact is anywhere between two moments, too far apart to be linear in.
        reach = min(int(np.ceil((2 * signal.bracket_s / signal.dt).max())), BEFORE)
    else:
        reach = 0
    if reach:
        # Cells of one sampling interval: over three a trace is not linear, and of traces of sixty samples
        # 90 % intervals of Hunt and Crossley's C then held 85 %.
        early = np.pad(signal.before, ((0, 0), (max(0, reach - BEFORE), 0)))
        before = np.moveaxis(early[:, early.shape[1] - reach :, None], 1, 0)
        optional |= {"before": before, "n_before": np.minimum(signal.n_before, reach)}
        optional["quiet_sd"] = np.maximum(signal.noise_sd, 1e-12)
        contact_sd, uniform = reach * signal.dt / np.sqrt(12), np.ones_like(uniform)
        if dataset.recorder is not None and white < 1:
            rows = reach + signal.deceleration.shape[1]
            optional["colour"], optional["rate"], longer = _colour(dataset.recorder, white, rows, signal.dt)
            offset_sd = np.where(np.isfinite(signal.offset_sd), longer * offset_sd, offset_sd)
    if specification.discrepancy == "always" or not element(specification.element).linear:
        optional["common_depth"] = np.full(len(size), common_depth(signal))
    record = ElementRecord.from_arrays(
        signal.deceleration,
        signal.n_samples,
        signal.bracket_s,
        signal.dt,
        signal.velocity,
        np.stack([velocity_sd, gain_sd, offset_sd, contact_sd], axis=1),
        uniform,
        signal.mass,
        np.where(np.isfinite(size), size, REFERENCE_DIAMETER_M),
        **optional,
    )
    if specification.noise == "autoregressive":
        record = record._replace(quiet=jnp.asarray(np.isfinite(signal.offset_sd)))
    return record, np.abs(signal.deceleration).max(axis=1)


def _colour(
    recorder: Recorder, white: float, rows: int, dt: np.ndarray
) -> tuple[Colour, np.ndarray, np.ndarray]:
    """The recorder's noise, each impact's sampling rate, and by how much longer a mean takes to settle.

    A mean of many samples varies in proportion to the sum of their correlations.
    """
    intervals, rate = np.unique([float(f"{interval:.6g}") for interval in dt], return_inverse=True)
    of_lags = [partial(autocorrelation, recorder, dt=float(interval)) for interval in intervals]
    sums = white + (1 - white) * np.array([2 * at_lags(np.arange(rows)).sum() - 1 for at_lags in of_lags])
    return colour_of(white, of_lags, rows), rate, np.sqrt(np.maximum(sums, white))[rate]


# Of the phase at the filter's corner over a cell of contact's moment, in rad: a trace is then linear in it
# but for 1 % of the force's jump at the cell's ends.
_CELL_PHASE = 0.35
_MOST_CELLS = 24


def _low_pass(recorder: Recorder, dt: np.ndarray) -> LowPass:
    """The recorder's filter as the likelihood takes it, and how it is told in samples this far apart."""
    poles, weights = filter_modes(recorder)
    corner = 2 * np.pi * recorder.low_pass_hz
    # Between two samples nothing happens to those that a digital filter ran over.
    finer = 1 if recorder.digital else int(np.clip(np.ceil(corner * dt.max() / _CELL_PHASE), 1, _MOST_CELLS))
    ahead = None
    if recorder.zero_phase:
        ahead = jnp.zeros(int(np.ceil((ahead_s(recorder, dt) / dt).max())))
    cells = (jnp.arange(finer) + 0.5) / finer
    sampled = jnp.asarray(corner) if recorder.digital else None
    return LowPass(jnp.asarray(poles), jnp.asarray(weights), cells, ahead, sampled)
