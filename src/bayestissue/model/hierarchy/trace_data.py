"""From a dataset and a model file to the arrays and the model of a fit."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import numpyro
import pandas as pd
from jaxtyping import Float
from numpyro.infer.reparam import LocScaleReparam

from bayestissue.base.errors import InputError, Problem, along_with
from bayestissue.base.impact_arrays import IndexPerImpact
from bayestissue.mechanics.elements import element
from bayestissue.mechanics.elements.element import GRAVITY, REFERENCE_DIAMETER_M, Element
from bayestissue.model.hierarchy import SIDE_BY_SIDE
from bayestissue.model.hierarchy.derived import effects_by_name
from bayestissue.model.hierarchy.design import Design, build_design
from bayestissue.model.hierarchy.force_data import (
    PreparedForce,
    prepared_force,
    tells_added_mass,
)
from bayestissue.model.hierarchy.formulas.formula import terms_of
from bayestissue.model.hierarchy.formulas.identifiability import missing
from bayestissue.model.hierarchy.population import EffectParts, population_design, stated_mass_errors
from bayestissue.model.hierarchy.priors import normal
from bayestissue.model.hierarchy.recorder_noise import low_pass_of, recorded_noise
from bayestissue.model.hierarchy.reference import Reference
from bayestissue.model.hierarchy.responses import RESPONSES, parameter_of
from bayestissue.model.hierarchy.specification import Formulas, ModelSpecification, refused, unsuited
from bayestissue.model.hierarchy.trace_models import (
    GAIN,
    Kind,
    Record,
    TraceData,
    TraceModel,
    plain_model,
)
from bayestissue.model.likelihood.displacements import DisplacementRecord, displacement_record
from bayestissue.model.likelihood.noise import discrepancy_modes
from bayestissue.model.likelihood.record import Contact, DecelerationRecord, UnevenTimes
from bayestissue.model.likelihood.recorder import Colour, LowPass
from bayestissue.recordings.dataset.dataset_file import FILE as SETTINGS
from bayestissue.recordings.dataset.model import Dataset
from bayestissue.recordings.signal import Displacements, displacements
from bayestissue.recordings.signal.displacement import BEFORE, BELOW_ZERO, FEWEST_SAMPLES
from bayestissue.recordings.signal.filters import delay

# Of the log of force over mass times deceleration, where nothing is declared of masses and gains.
_LEAST_RATIO_SD = 1e-3
# Of the noise: an error of contact whose second order adds up to more is a parameter.
_BENT = 0.5
KINDS: tuple[Kind, ...] = ("arma", "a2", "impact")


@dataclass(frozen=True)
class Prepared:
    """A fit ready to start.

    Attributes:
        model: what is assumed.
        data: the recordings.
        design: the formulas over the impacts.
        signal: the recordings over their windows.
        impacts: their table.
        force: recorded beside the decelerations, if the fit is of it too.
        force_unused: else why not.
        reference: what phantoms of known stiffness say of all masses, if there were any.
        common_mass_sd: standard deviation of the log of a factor that all masses have in common, where the
            model file says so and nothing recorded tells it; 0 where each mass errs by itself.
        mass_group: of each impact, which error of its mass it has, where impacts share these.
    """

    model: TraceModel
    data: TraceData
    design: Design
    signal: Displacements
    impacts: pd.DataFrame
    force: PreparedForce | None = None
    force_unused: str = ""
    reference: Reference | None = None
    common_mass_sd: float = 0.0
    mass_group: IndexPerImpact | None = None

    @property
    def error_sd(self) -> Float[np.ndarray, "impact error"]:
        """Of the measuring chain's errors beforehand, that of a gain which all impacts share counted in."""
        record = self.data.record
        if not self.model.gain:
            return np.asarray(record.error_sd)
        gain_sd = jnp.full(len(self.impacts), self.model.priors.log_gain.sd)
        return np.hypot(record.error_sd, record.of_gain(gain_sd))


def prepare(dataset: Dataset, specification: ModelSpecification, *, source: str) -> Prepared:
    """Integrate the traces, evaluate the formulas and arrange everything for the model.

    Raises:
        InputError: the model's likelihood is not one of traces, its formulas ask for what this design can't
            identify, or a trace has too few samples in its window;
            ``source`` is the model file's name.
    """
    problems = unsuited(facts_of(dataset, **specification.facts), "likelihood", source)
    if problems:
        raise InputError(problems)
    # Of a formula with such a column the design is refused; beside it stands where the values are missing.
    with along_with(_empty_cells(dataset, specification.formula)):
        design = build_design(
            specification.formula,
            dataset.impacts,
            reference_mass_kg=specification.reference_mass_kg,
            source=source,
        )
    if passed_over := specification.priors_passed_over(design.terms):
        words = {"terms": ", ".join(map(str, design.terms)) or "none"}
        raise InputError.stated("formula.prior", source, None, "priors", ", ".join(passed_over), **words)
    signal = displacements(dataset, specification.signal)
    problems = too_short(dataset, signal, source)
    if problems:
        raise InputError(problems)
    if not dataset.channels:
        return assemble(dataset, specification, design, signal)
    recordings = _Recordings(dataset, specification, signal)
    force = no_force(specification) or prepared_force(dataset, signal, recordings.low_pass, recordings.reach)
    if isinstance(force, str):
        return replace(assemble(dataset, specification, design, signal), force_unused=force)
    return assemble(dataset, specification, design, signal, force)


def no_force(specification: ModelSpecification) -> str:
    """Why a fit by a model can't be of a force too, whatever was recorded; empty where it can."""
    facts = specification.facts | {"force": True}
    return "".join(one.words.format_map(facts) for one in refused(facts, "force"))


def too_short(dataset: Dataset, signal: Displacements, source: str) -> list[Problem]:
    """Impacts of too few samples for any fit, a problem each; ``source`` is the model file's name."""
    short = np.flatnonzero(signal.n_below_limit < FEWEST_SAMPLES)
    names = dataset.impacts["impact"].astype(str).to_list()
    return [
        Problem.stated(
            "starts-deep.below", SETTINGS, None, "signal.offset", "none of its samples", impact=names[i]
        )
        if BELOW_ZERO in signal.flags[i]
        else Problem.stated(
            "too-few-samples.window",
            *(source, None, "signal.window", int(signal.n_below_limit[i]), names[i]),
            least=FEWEST_SAMPLES,
        )
        for i in short
    ]


def assemble(
    dataset: Dataset,
    specification: ModelSpecification,
    design: Design,
    signal: Displacements,
    force: PreparedForce | None = None,
) -> Prepared:
    """Model and data of a fit whose design and displacements are made, of a force too if there is one."""
    kind: Kind = specification.likelihood  # type: ignore[assignment]
    priors = specification.complete_priors(design.terms)
    if force is not None and tells_added_mass(force, specification.element):
        declared = max(float(np.hypot(force.mass_sd, force.gain_sd)), _LEAST_RATIO_SD)
        priors = priors.model_copy(update={"log_force_ratio": normal(0.0, declared)})
    gain_sd = _common_gain_sd(dataset, specification)
    if gain_sd and "log_gain" not in specification.priors.model_fields_set:
        priors = priors.model_copy(update={"log_gain": normal(0.0, gain_sd)})
    if gain_sd:
        # Each impact then has no error of it besides.
        exact = dataset.uncertainty.model_copy(update={"relative_gain_sd": 0.0})
        dataset = dataset.with_settings(uncertainty=exact)
    recordings = _Recordings(dataset, specification, signal, force)
    # With a force the errors of mass are what it is over mass times deceleration.
    relative_mass_sd = float(dataset.uncertainty.relative_mass_sd) if force is None else 0.0
    moved = in_proportion_to_mass(specification.element)
    log_mass_sd, common_mass_sd, masses = stated_mass_errors(
        specification.mass_error, relative_mass_sd, design.subject, signal.mass, moved
    )
    model = TraceModel(
        kind,
        EffectParts(()),
        priors,
        specification.residual_correlation,
        log_mass_sd,
        specification.element,
        discrepancy=recordings.has_discrepancy,
        headform=dataset.headform,
        force=force is not None,
        contact=kind == "impact" and recordings.estimate_contact,
        gain=gain_sd > 0,
    )
    effects, columns = population_design(design, priors, model.nuisance, masses)
    of_impact = kind == "impact"
    record: Record = recordings.decelerations() if of_impact else recordings.displacements()
    peak = np.abs(signal.deceleration).max(axis=1) if of_impact else signal.stop.x
    data = TraceData(
        record,
        jax.device_put(columns),
        jax.device_put(effects.mean),
        jax.device_put(np.log(signal.mass)),
        jax.device_put(np.log(np.maximum(peak, 1e-300))),
    )
    return Prepared(
        replace(model, locations=effects),
        data,
        design,
        signal,
        dataset.impacts,
        force,
        common_mass_sd=common_mass_sd or 0.0,
        mass_group=masses and masses.code,
    )


def _common_gain_sd(dataset: Dataset, specification: ModelSpecification) -> float:
    """Standard deviation of the gain's error that is one of all impacts; 0 where each has its own."""
    shared = specification.gain_error == "all" and len(dataset.impacts) > 1
    identified = dataset.quantity != "displacement" and element(specification.element).added_mass is None
    return dataset.uncertainty.relative_gain_sd if shared and identified else 0.0


def in_proportion_to_mass(of_element: str) -> tuple[str, ...]:
    """Names of an impact's parameters that a heavier impactor than declared has greater in proportion."""
    further = (parameter_of(one.name) for one in element(of_element).extra if one.of_mass)
    return (*RESPONSES, *further)


def with_discrepancy(dataset: Dataset, specification: ModelSpecification, prepared: Prepared) -> Prepared:
    """The same fit with a discrepancy beside the element."""
    wider = specification.model_copy(update={"discrepancy": "always"})
    without = assemble(dataset, wider, prepared.design, prepared.signal)
    why = no_force(wider) if prepared.force else prepared.force_unused
    return replace(without, force_unused=why, reference=prepared.reference)


def facts_of(dataset: Dataset, **stated: Any) -> dict[str, Any]:
    """What a `Combination` is of: what is ``stated``, and the dataset."""
    names, traces = dataset.impacts["impact"], dataset.traces
    facts = stated | {"traces": True, "quantity": dataset.quantity}
    for name, rows in (("uneven", traces.uneven), ("clipped", traces.limited)):
        of_these = f"{rows.sum()} of these, {names.iloc[int(np.argmax(rows))]} the first"
        facts |= {name: bool(rows.any()), f"of_{name}": of_these}
    return facts | {"recorder": dataset.recorder, "filtered": dataset.recorder is not None}


def _empty_cells(dataset: Dataset, formulas: Formulas) -> list[Problem]:
    """A problem for each cell without a value in a column that a formula is of."""
    impacts = dataset.impacts
    named = [terms_of(formula).columns for _, formula in formulas if formula is not None]
    problems = []
    for column in dict.fromkeys(name for columns in named for name in columns if name in impacts):
        kind = "number" if pd.api.types.is_numeric_dtype(impacts[column]) else "category"
        problems += [
            dataset.cell("formula.empty", str(impact), column, "an empty cell", kind=kind)
            for impact in impacts.loc[missing(impacts[column]), "impact"]
        ]
    return problems


def _share(velocity_sd: float, together: np.ndarray) -> np.ndarray:
    """Of the variance of errors that act together, that of the velocity's."""
    return np.divide(velocity_sd**2, together**2, out=np.ones_like(together), where=together > 0)


def common_depth(signal: Displacements) -> float:
    """The smallest of the greatest depths that the recorded windows show [m].

    It comes from the recordings, so that it is one number: the same for every impact and every draw.
    """
    return float(signal.x.max(axis=1).min())


@dataclass(frozen=True)
class _Recordings:
    """What the likelihood's record of the traces is made of.

    Attributes:
        dataset: the recordings, and what is declared of their errors.
        specification: the model.
        signal: the recordings over their windows.
        force: recorded beside the decelerations, if the fit is of it too.
    """

    dataset: Dataset
    specification: ModelSpecification
    signal: Displacements
    force: PreparedForce | None = None

    @property
    def element(self) -> Element:
        """What the impactor meets."""
        return element(self.specification.element)

    @property
    def has_discrepancy(self) -> bool:
        """Whether it meets something else besides."""
        return self.specification.discrepancy == "always"

    @cached_property
    def low_pass(self) -> LowPass | None:
        """Of the decelerations."""
        recorder = self.dataset.recorder
        return None if recorder is None else low_pass_of(recorder, self.signal.dt)

    @cached_property
    def reach(self) -> int:
        """In how many sampling intervals before the first sample contact may be; none where it is known."""
        signal, recorder = self.signal, self.dataset.recorder
        if recorder is not None and self.low_pass is not None:
            # No force jumps behind it.
            late = signal.before.reach_s + delay(recorder)
            return int(np.ceil((late / signal.dt).max())) + self.low_pass.lead
        if self.has_discrepancy:
            return 0
        if not self.element.jumps and (signal.before.reach_s > 0).all():
            return min(int(np.ceil((signal.before.reach_s / signal.dt).max())), BEFORE)
        if signal.before.blurred.any():
            # Noise hides the jump: contact is anywhere between two moments, too far apart to be linear in.
            return min(int(np.ceil((2 * signal.contact.bracket_s / signal.dt).max())), BEFORE)
        return 0

    @cached_property
    def estimate_contact(self) -> bool:
        """Whether the place of contact in its sampling interval is a parameter of each impact.

        Where it is to be estimated, and where samples are so few that a trace is not linear in an error of
        it. Where contact may lie in several intervals, as noise hides a jump, its place is the same in each
        of them.
        """
        signal = self.signal
        undecided = signal.phase.kind == "undecided"
        if self.reach:
            return undecided and self.element.jumps and not signal.uneven.any()
        unknown = undecided or (signal.phase.kind == "between" and _bent(signal))
        return unknown and bool((signal.contact.interval_s > 0).any())

    @property
    def velocity_sd(self) -> np.ndarray:
        """Standard deviation of the errors of velocity and gain together [m/s]."""
        chain = self.dataset.uncertainty
        return np.hypot(chain.velocity_sd_m_s, chain.relative_gain_sd * self.signal.velocity)

    @property
    def zero_sd(self) -> np.ndarray:
        """Standard deviation of the zero [m/s^2]: what a quiet part before contact tells, or as declared."""
        return self.signal.quiet.zero_sd(self.dataset.uncertainty.offset_sd)

    def displacements(self) -> DisplacementRecord:
        """The displacements, with the standard deviations of their linear errors."""
        dataset, signal, chain = self.dataset, self.signal, self.dataset.uncertainty
        level_sd = signal.velocity * signal.contact.sd
        # Along gravity a gain in error is an offset too, and a contact time a velocity.
        velocity_sd = np.hypot(self.velocity_sd, signal.gravity * signal.contact.sd)
        offset_sd = np.hypot(self.zero_sd, signal.gravity * chain.relative_gain_sd)
        if dataset.quantity == "displacement":
            level_sd = np.hypot(level_sd, chain.offset_sd)
            velocity_sd, offset_sd = np.zeros_like(velocity_sd), np.zeros_like(offset_sd)
        errors = np.stack([level_sd, velocity_sd, offset_sd], axis=1)
        start = (signal.n_samples, signal.contact.since_s, signal.dt)
        record = displacement_record(signal.x, *start, errors, signal.gravity if dataset.gravity else None)
        if dataset.quantity == "displacement":
            return record
        share = jnp.asarray(_share(chain.velocity_sd_m_s, velocity_sd))
        return record._replace(velocity=jnp.asarray(signal.velocity), velocity_share=share)

    def decelerations(self) -> DecelerationRecord:
        """The decelerations, with the standard deviations of their linear errors."""
        dataset, signal, start = self.dataset, self.signal, self.signal.contact
        number = len(signal.dt)
        interval = signal.dt if self.reach else start.interval_s
        elsewhere = ~(self.estimate_contact & (interval > 0))
        contact, contact_sd = Contact.known(start.bracket_uniform), np.where(elsewhere, start.bracket_sd, 0.0)
        colour, rate, longer = recorded_noise(dataset, signal, self.reach + signal.deceleration.shape[1])
        if self.reach:
            contact, contact_sd = self._in_cells(colour), self.reach * signal.dt / np.sqrt(12)
        offset_sd = np.where(signal.quiet.there, longer * self.zero_sd, self.zero_sd)
        errors, velocity_share = self._errors([offset_sd, contact_sd])
        diameter = dataset.impacts.get("diameter_m", pd.Series(REFERENCE_DIAMETER_M, dataset.impacts.index))
        surroundings = {"diameter_m": diameter.astype(float).fillna(REFERENCE_DIAMETER_M).to_numpy()}
        # It takes up what a wrong moment of contact does to a trace.
        modes = discrepancy_modes(signal.n_samples, signal.sample_numbers) if self.has_discrepancy else None
        return DecelerationRecord.from_arrays(
            signal.deceleration,
            signal.n_samples,
            start.bracket_s,
            signal.dt,
            signal.velocity,
            np.stack(errors, axis=1),
            signal.mass,
            surroundings | ({GRAVITY: signal.gravity} if dataset.gravity else {}),
            contact._replace(uniform=contact.uniform & elsewhere),
            colour=colour,
            rate=rate,
            shared_by=np.full(number, float(number)) if self.element.added_mass else None,
            velocity_share=velocity_share,
            common_depth=np.full(number, common_depth(signal)),
            low_pass=self.low_pass,
            uneven=_uneven_times(signal, self.reach),
            clipped=signal.clipped if signal.clipped.any() else None,
            interval=interval if self.estimate_contact else None,
            force=self.force and self.force.rows,
            **({"discrepancy": modes} if modes else {}),
        )

    def _in_cells(self, colour: Colour) -> Contact:
        """Contact in any of so many sampling intervals before the first sample; ``colour`` of the noise.

        The likelihood asks the samples itself when contact was; what they said of it must not count twice.
        Cells are of one sampling interval: over three a trace is not linear in the moment, and of traces of
        sixty samples 90 % intervals of Hunt and Crossley's C then held 85 %.
        """
        signal, reach = self.signal, self.reach
        fraction = signal.phase.fraction if signal.phase.known else None
        before = np.pad(signal.before.value, ((0, 0), (max(0, reach - BEFORE), 0)))
        before = before[:, before.shape[1] - reach :]
        n_before = np.minimum(signal.before.n_samples, reach)
        n_quiet = np.maximum(n_before - signal.before.n_since_quiet, 0)
        if not colour.is_white:
            return Contact.anywhere(before, n_before, n_quiet=n_quiet)
        if self.has_discrepancy:
            return Contact.anywhere(before, np.zeros_like(n_before), fraction=fraction)
        noise_sd = np.maximum(signal.quiet.noise_sd, 1e-12)
        return Contact.anywhere(before, n_before, noise_sd, fraction, n_quiet)

    def _errors(self, of_contact: list[np.ndarray]) -> tuple[list[np.ndarray], np.ndarray]:
        """Standard deviations of each impact's errors of the chain, and the velocity's share of the first.

        A spring and damper's motion is in proportion to the velocity: errors of velocity and gain are then
        one error of both, unless something else tells them apart. Gravity does, and a force. ``of_contact``
        has those of the zero [m/s^2] and of the contact time [s].
        """
        dataset, chain, force = self.dataset, self.dataset.uncertainty, self.force
        number = len(self.signal.dt)
        side_by_side = self.specification.element == SIDE_BY_SIDE
        share = _share(chain.velocity_sd_m_s, self.velocity_sd)
        # Of an impact along gravity an error of the gain is not one of the velocity.
        along_gravity = dataset.gravity and chain.relative_gain_sd
        separate = dataset.recorder or self.has_discrepancy or self.reach or force or along_gravity
        if side_by_side and not separate:
            return [self.velocity_sd, *of_contact], share
        if side_by_side and dataset.recorder is not None and not dataset.gravity and force is None:
            return [self.velocity_sd, np.zeros(number), *of_contact], share
        # The height of recordings tells a mass that moves along in all of them: what impacts share of the
        # errors of velocity and gain, which nothing says, must not average out. So much wider, they tell
        # together what one impact does.
        shared = np.sqrt(number) if self.element.added_mass else 1.0
        of_both = [np.full(number, shared * sd) for sd in (chain.velocity_sd_m_s, chain.relative_gain_sd)]
        of_force = [] if force is None else [force.offset_sd, force.clock_sd]
        return [*of_both, *of_force, *of_contact], np.ones(number)


def _uneven_times(signal: Displacements, reach: int) -> UnevenTimes | None:
    """When the samples were; none where all times are even."""
    if not signal.uneven.any():
        return None
    # Past a row's end any times serve, but none that fall.
    later = np.maximum.accumulate(signal.time_s, axis=1)
    return UnevenTimes(jnp.asarray(later), jnp.asarray(signal.before.time_s[:, BEFORE - reach :]))


def _bent(signal: Displacements) -> bool:
    """Whether an error of contact is more than linear in the median trace, by its noise.

    With n samples until zero velocity, a quarter of a period, half an interval moves a sinusoid's phase by
    pi / 4n, and the second order, (pi / 4n)^2 / 2 of the peak, adds up to n^1/2 times that. Where nobody had
    it, 90 % intervals of K from seven samples with 0.15 % of noise held 55 %.
    """
    n, peak = signal.time_to_peak / signal.dt, np.abs(signal.deceleration).max(axis=1)
    with np.errstate(divide="ignore"):
        second_order = (np.pi / 4 / n) ** 2 / 2 * np.sqrt(n) * peak / signal.quiet.noise_sd
    return bool(np.median(second_order) > _BENT)


def named_model(prepared: Prepared) -> Callable[[], None]:
    """`plain_model` of a fit's data, with effects, K and C by their names beside what is sampled.

    K and C are at the recorded mass, whose error, where impacts share it, is ``log_mass_error``. A
    discrepancy is there as the log of its rms. A gain is sampled in units of its spread, of which one trace
    tells next to nothing.
    """
    model = prepared.model
    in_spreads = {GAIN: LocScaleReparam(0)}

    def named() -> None:
        if not jax.config.jax_enable_x64:
            raise RuntimeError("these likelihoods need double precision: call numpyro.enable_x64() first")
        with numpyro.handlers.trace() as sampled, numpyro.handlers.reparam(config=in_spreads):
            plain_model(model, jax.tree.map(jnp.asarray, prepared.data))
        value = {name: site["value"] for name, site in sampled.items() if site["type"] == "sample"}
        effects = effects_by_name(model.locations, prepared.design, value["locations"])
        for name, effect in effects.items():
            numpyro.deterministic(name, effect)
        for number, q in enumerate("KC"):
            numpyro.deterministic(q, jnp.exp(value["log_K_and_C"][:, number]))

    return named
