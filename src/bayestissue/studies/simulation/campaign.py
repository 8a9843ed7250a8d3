"""A simulated campaign: the truth of every impact, what a recorder makes of it, and its dataset folder."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from jax import Array
from jaxtyping import Bool, Float

from bayestissue.base.impact_arrays import JaxPerSample, PerImpact, PerSample, bucket
from bayestissue.base.outcome_table import HEADFORM_COLUMNS
from bayestissue.base.results.tables import write_table
from bayestissue.mechanics.elements import element, impact, outcomes
from bayestissue.mechanics.elements.element import Collision
from bayestissue.mechanics.oscillator import impact_motion, spring_damper_inverse
from bayestissue.model.hierarchy import SIDE_BY_SIDE
from bayestissue.model.hierarchy.formulas.group_terms import MASS_TERM, GroupTerm, grouping_of
from bayestissue.recordings.dataset import write_dataset
from bayestissue.recordings.dataset.dataset_file import LowPassFilter, Settings, gravity_m_s2
from bayestissue.recordings.dataset.impact_table import REFERENCE
from bayestissue.recordings.dataset.model import Dataset, long_table
from bayestissue.recordings.dataset.ragged_traces import Traces
from bayestissue.recordings.signal.filters import decay, on_even_grid
from bayestissue.studies.simulation.simulation_file import (
    Phantom,
    Simulation,
    Spreads,
    Tissue,
    crossed,
)

# Of each impact a number, something at each sample or step of its motion, which samples are recorded, and the
# values there, one impact's after another's.
Steps = Float[np.ndarray, "impact step"]
Recorded = Bool[np.ndarray, "impact sample"]
Values = Float[np.ndarray, " recorded"]
# Of the trace table, beside ``value``.
FORCE_COLUMN = "force_N"
_BLOCK = 1_000_000
# Steps of the motion between two samples of a recorder with a low-pass, or in a period of its corner, and
# time constants of the filter's slowest pole until it rests.
_FINER, _AT_REST = 64, 25.0
# Samples of noise before a filter in a period of its corner, at the least.
_NOISE_FINER = 8
# A soft damper in series with the spring lets a mass creep for ever: it is recorded for so long.
_NEVER_RESTS_S = 1.0


@dataclass(frozen=True)
class Campaign:
    """A dataset and what it was made from.

    Attributes:
        settings: what its ``dataset.toml`` says.
        impacts: the table that a lab would have: ``impact``, ``subject``, ``trial``, ``mass_kg``,
            ``velocity_m_s``, ``energy_J``, ``sampling_rate_hz``, and the design's further factors.
        truth: one row per impact, with what the lab would like to know.
        traces: recorded decelerations, m/s²; along gravity they are force over mass. Each recorder's clock
            starts at 0.
        further: the force recorded beside them, N, at the same samples; none where none was.
    """

    settings: Settings
    impacts: pd.DataFrame
    truth: pd.DataFrame
    traces: Traces
    further: tuple[Traces, ...] = ()

    def dataset(self, name: str) -> Dataset:
        """The campaign as a dataset, as if it had been written and read, without a folder or a hash."""
        settings = self.settings.in_si().model_copy(update={"name": name})
        return Dataset(settings, self.impacts, self.traces, self.further)


def simulate(simulation: Simulation, seed: int | None = None) -> Campaign:
    """Draw the truth of every impact and record it; the same seed gives the same numbers.

    The motion is that of a mass M that meets the tissue's element at V; the tissue can push but not pull, so
    the recording is at rest again from when the force is 0. A recorder's low-pass takes the motion as it is
    between the samples, a digital one the samples; range and steps are those of what comes after it, and so
    is noise unless it says otherwise.
    Tissue, chain and noise have random streams of their own: more noise leaves the truth as it is. Needs
    float64 (`bayestissue.base.runtime.configure`).

    Args:
        simulation: the specification.
        seed: instead of the specification's.
    """
    seed = simulation.seed if seed is None else seed
    people = _simulated(simulation, seed)
    if simulation.phantom is None:
        return people
    spring = _simulated(_of_phantom(simulation, simulation.phantom), (seed, 1))
    random = np.random.default_rng((seed, 2))
    stated = simulation.phantom.K_N_per_m + simulation.phantom.sd_N_per_m * random.standard_normal()
    known = dict(zip(REFERENCE, (stated, simulation.phantom.sd_N_per_m), strict=True))
    names = "phantom-" + spring.impacts["impact"]
    return replace(
        people,
        impacts=pd.concat(
            [people.impacts, spring.impacts.assign(impact=names, subject="phantom", **known)],
            ignore_index=True,
        ),
        truth=pd.concat([people.truth, spring.truth.assign(impact=names)], ignore_index=True),
        traces=Traces.of([*people.traces, *spring.traces]),
    )


def _of_phantom(simulation: Simulation, phantom: Phantom) -> Simulation:
    """The same conditions and measuring chain, and a spring in place of people."""
    tissue = Tissue(K_N_per_m=phantom.K_N_per_m, C_N_s_per_m=phantom.C_N_s_per_m)
    design = simulation.design.model_copy(update={"subjects": 1, "repeats": phantom.repeats})
    return simulation.model_copy(update={"tissue": tissue, "design": design})


class _Streams(NamedTuple):
    """Random numbers of each kind, so that more of one leaves the others as they are."""

    tissue: np.random.Generator
    chain: np.random.Generator
    noise: np.random.Generator
    further: np.random.Generator
    groups: np.random.Generator
    factors: np.random.Generator
    forces: np.random.Generator


def _simulated(simulation: Simulation, seed: int | tuple[int, ...]) -> Campaign:
    """People alone, or a phantom alone."""
    seeds = np.random.SeedSequence(seed).spawn(len(_Streams._fields))
    random = _Streams(*map(np.random.default_rng, seeds))
    impacts = _impacts(simulation, random.factors)
    truth = _truth(simulation, impacts, random)
    rate = simulation.recording.sampling_rate_hz
    end = truth["contact_time_s"].to_numpy() + leaves(truth)
    n = np.ceil((end + simulation.recording.after_contact_s) * rate).astype(int) + 1
    sample = np.arange(n.sum()) - np.repeat(np.cumsum(n) - n, n)
    force = simulation.recording.force
    if force is not None:
        # Of its channel the gain is one for all impacts.
        truth["force_gain"] = 1 + force.relative_gain_sd * random.forces.standard_normal()
        truth["force_offset_N"] = force.offset_sd_N * random.forces.standard_normal(len(truth))
    value, *forces = map(np.concatenate, zip(*_recorded(simulation, truth, n, random), strict=True))
    if simulation.output.decimals is not None:
        value = np.round(value, simulation.output.decimals)
    value = value.astype(np.float32) if simulation.output.float32 else value
    time, start = np.round(sample / rate, 9), np.cumsum([0, *n])
    limit = np.inf if force is None or force.limit_N is None else force.limit_N
    clipped = [(np.sign(one) * (np.abs(one) >= limit)).astype(np.int8) for one in forces]
    further = (Traces(time, one, start, clipped=at) for one, at in zip(forces, clipped, strict=True))
    return Campaign(_settings(simulation), impacts, truth, Traces(time, value, start), tuple(further))


def _settings(simulation: Simulation) -> Settings:
    """What a lab would declare."""
    recording, force, gravity = simulation.recording, simulation.recording.force, simulation.gravity
    content: dict[str, Any] = {
        "name": simulation.name,
        "description": simulation.description or "Simulated; truth.csv holds what it was made from.",
        "source": "bayestissue simulate",
        "signal": {"quantity": "deceleration", "unit": "m/s^2", "contact": recording.contact},
        "uncertainty": {
            "relative_mass_sd": recording.relative_mass_sd,
            "velocity_sd_m_s": recording.velocity_sd_m_s,
            "relative_gain_sd": recording.relative_gain_sd,
            "offset_sd": recording.offset_sd_m_s2,
        },
        "recorder": simulation.recorder,
    }
    if gravity_m_s2(gravity):
        content["signal"]["gravity"] = gravity_m_s2(gravity)
    if simulation.headform:
        content["impactor"] = {"headform": True}
    if force is not None:
        known = {"relative_gain_sd", "tip_mass_kg", "recorder"}
        channel: dict[str, Any] = {"name": "force", "quantity": "force", "place": force.place, "unit": "N"}
        channel |= {"value_column": FORCE_COLUMN, "limit": force.limit_N}
        content["channel"] = [channel | force.model_dump(include=known, exclude_defaults=True)]
    return Settings.model_validate(content)


def _impacts(simulation: Simulation, random: np.random.Generator) -> pd.DataFrame:
    design = simulation.design
    people = pd.DataFrame({"subject": [f"s{k + 1:02d}" for k in range(design.subjects)]})
    levels = [pd.DataFrame({factor.name: factor.levels}) for factor in design.factors if factor.every]
    impacts = crossed(simulation.conditions(), people, *levels, repeats=design.repeats)
    repeat = (impacts.groupby(level=0).cumcount() + 1).to_numpy()
    impacts = impacts.reset_index(drop=True)
    for factor in design.factors:
        if not factor.every:
            impacts[factor.name] = random.permutation(np.resize(factor.levels, len(impacts)))
    names = impacts["trial"] + "-" + impacts["subject"]
    for (name,) in levels:
        names += "-" + impacts[name]
    if design.repeats > 1:
        names += "-r" + pd.Series(repeat).astype(str)
    energy = impacts["mass_kg"] * impacts["velocity_m_s"] ** 2 / 2
    rate = simulation.recording.sampling_rate_hz
    table = impacts.assign(impact=names, energy_J=energy, sampling_rate_hz=rate)
    factors = [factor.name for factor in design.factors]
    last = [name for name in ("energy_J", "sampling_rate_hz", "diameter_m") if name in table]
    return table[["impact", "subject", "trial", *factors, "mass_kg", "velocity_m_s", *last]]


def _truth(simulation: Simulation, impacts: pd.DataFrame, random: _Streams) -> pd.DataFrame:
    recording, tissue, count = simulation.recording, simulation.tissue, len(impacts)
    chain, rate = random.chain, recording.sampling_rate_hz
    stated = impacts["mass_kg"].to_numpy() * recording.mass_factor
    mass = stated * (1 + recording.relative_mass_sd * chain.standard_normal(count))
    velocity = impacts["velocity_m_s"].to_numpy() + recording.velocity_sd_m_s * chain.standard_normal(count)
    # As many are drawn either way, so that what is drawn after them stays.
    gain_errors = recording.relative_gain_sd * chain.standard_normal(count)
    gain = 1 + (gain_errors if recording.gain_error == "impact" else np.full(count, gain_errors[0]))
    offset = recording.offset_sd_m_s2 * chain.standard_normal(count)
    since_sample = chain.uniform(size=count)
    contact = recording.before_contact_s + since_sample / rate
    if recording.contact == "on_sample":
        contact = np.full(count, np.ceil(recording.before_contact_s * rate) / rate)
    size = np.log(mass / tissue.reference_mass_kg)
    effects = _effects(tissue, impacts, size, random)
    stiffness, damping = (
        getattr(tissue, name) * np.exp(getattr(tissue, f"mass_exponent_{name[0]}") * size + effects[name[0]])
        for name in ("K_N_per_m", "C_N_s_per_m")
    )
    scatter = tissue.sd_impact_parameters * random.further.standard_normal((len(tissue.parameters), count))
    names = [parameter.name for parameter in element(tissue.element).extra]
    logs = {name: s + effects.get(name, 0.0) for name, s in zip(names, scatter, strict=True)}
    truth = pd.DataFrame(
        {
            "impact": impacts["impact"],
            "K_N_per_m": stiffness,
            "C_N_s_per_m": damping,
            "mass_kg": mass,
            "velocity_m_s": velocity,
            "gain": gain,
            "offset_m_s2": offset,
            "contact_time_s": contact,
            **{name: tissue.parameters[name] * np.exp(log) for name, log in logs.items()},
            **({"diameter_m": impacts["diameter_m"]} if "diameter_m" in impacts else {}),
        }
    )
    responses = ("K", "C", *tissue.parameters)
    columns = {name: effect for name, effect in effects.items() if name not in responses}
    return what_is_met(simulation, truth).assign(**columns)


def _effects(
    tissue: Tissue, impacts: pd.DataFrame, log_mass: PerImpact, random: _Streams
) -> dict[str, np.ndarray]:
    """The effects of each group term, by the names that a posterior gives them, and their sums by parameter.

    Of a slope the truth has the level's own coefficient, the population's included.
    """
    effects: dict[str, np.ndarray] = {"K": np.zeros(len(impacts)), "C": np.zeros(len(impacts))}
    mixing = np.array([[1, 0], [tissue.correlation, np.sqrt(1 - tissue.correlation**2)]])
    levels = {
        GroupTerm((level,)): Spreads(**{name: getattr(tissue, f"sd_{level}_{name}") for name in ("K", "C")})
        for level in ("subject", "trial", "impact")
    }
    # A file has a 0 with its sign: that of a level stays, since it is added to the negative one.
    for terms, stream, zero in ((levels, random.tissue, -0.0), (tissue.spreads(), random.groups, 0.0)):
        for term, spread in terms.items():
            code = grouping_of(impacts, term.factors).code
            if term.slope == MASS_TERM:
                covariate = log_mass
            elif term.slope:
                covariate = impacts[term.slope].to_numpy() - impacts[term.slope].mean()
            else:
                covariate = np.ones(len(impacts))
            standard = stream.standard_normal((code.max() + 1, 2)) @ mixing.T
            term_effects = {"K": spread.K * standard[code, 0], "C": spread.C * standard[code, 1]}
            for name, sd in spread.__pydantic_extra__.items():
                term_effects[name] = sd * stream.standard_normal(code.max() + 1)[code]
            for name, effect in term_effects.items():
                effects[name] = effects.get(name, 0.0) + effect * covariate
                shared = getattr(tissue, f"mass_exponent_{name}", 0.0) if term.slope == MASS_TERM else zero
                column = term.variable(name)
                effects[column] = effects.get(column, zero) + effect + shared
    return effects


def what_is_met(simulation: Simulation, truth: pd.DataFrame) -> pd.DataFrame:
    """The truth with all that follows from mass, velocity and the element's parameters in it.

    All outcomes of the impact are among it, at the true mass and velocity.

    omega_n and zeta are those of stiffness and damping as they compare across elements: K_secant and
    C_equivalent of `bayestissue.mechanics.elements.outcomes`, and of all mass that moves. Along gravity a
    spring and damper also has a moment of its own at which it leaves, or none.
    """
    name, gravity = simulation.tissue.element, gravity_m_s2(simulation.gravity) or None
    p, (mass, velocity) = _parameters(name, truth), truth[["mass_kg", "velocity_m_s"]].to_numpy().T
    surroundings: Any = {"diameter": _diameter(truth), "gravity": gravity, "headform": simulation.headform}
    comes = jax.device_get(outcomes(name, p, mass, velocity, **surroundings))
    moves = Collision.of(element(name), p, mass, velocity).inertia
    omega_n, zeta = map(np.asarray, spring_damper_inverse(comes["K_secant"], comes["C_equivalent"], moves))
    columns = {column: comes[name] for name, column in HEADFORM_COLUMNS.items() if name in comes}
    if gravity or name != SIDE_BY_SIDE:
        # One that only fades is recorded for five times as long as it took to the peak.
        peak, end = comes["time_to_peak"], comes["contact_duration"]
        fades = np.where(np.isfinite(peak), 5 * peak, _NEVER_RESTS_S)
        columns["leaves_s"] = np.where(np.isfinite(end), end, fades)
    of_element = [parameter.name for parameter in element(name).extra]
    sizes = {column: truth[column] for column in (*of_element, "diameter_m") if column in truth}
    truth = truth.drop(columns=list(sizes))
    truth.insert(3, "omega_n_rad_s", omega_n)
    truth.insert(4, "zeta", zeta)
    if name != SIDE_BY_SIDE:
        columns |= {
            **sizes,
            "K_secant_N_per_m": comes["K_secant"],
            "C_equivalent_N_s_per_m": comes["C_equivalent"],
            "energy_lost": comes["energy_lost"],
        }
    return truth.assign(**columns)


def leaves(truth: pd.DataFrame) -> PerImpact:
    """When the tissue pushes no more [s]; for Kelvin-Voigt twice the time to peak (thesis, section 2.12)."""
    column = truth["leaves_s"] if "leaves_s" in truth else 2 * truth["time_to_peak_s"]
    return column.to_numpy()


def deceleration(
    name: str, truth: pd.DataFrame, time: Float[np.ndarray, " sample"], gravity: float = 0.0
) -> JaxPerSample:
    """Force over mass, [impact, sample]: 0 before contact and once the force is 0.

    Args:
        name: of the element.
        truth: the impacts, with the columns of `what_is_met` and of K, C, mass, velocity and contact time.
        time: on the recorder's clock [s].
        gravity: along the motion [m/s^2].
    """
    contact = truth["contact_time_s"].to_numpy()[:, None]
    samples = len(time)
    # The last time over again: what is compiled for one length of recordings serves others.
    time = np.pad(time, (0, bucket(samples) - samples), mode="edge")
    if name == SIDE_BY_SIDE and not gravity:
        names = ["omega_n_rad_s", "zeta", "velocity_m_s"]
        motion = tuple(truth[column].to_numpy()[:, None] for column in names)
        return _side_by_side(time, contact, leaves(truth)[:, None], motion)[:, :samples]
    p = _parameters(name, truth)
    since = jnp.asarray(time - contact)
    mass, velocity = truth["mass_kg"].to_numpy(), truth["velocity_m_s"].to_numpy()
    surroundings = {"diameter": _diameter(truth), "gravity": gravity or None}
    return impact(name, p, mass, velocity, since, **surroundings).deceleration[:, :samples]


def tissue_force(name: str, truth: pd.DataFrame, deceleration: PerSample, gravity: float = 0.0) -> PerSample:
    """The tissue's own force F [N], of this deceleration d of the impactor: (M + m) d - m g while it pushes.

    What tissue that moved along does once the impactor has left is not followed: F is 0 then.

    Args:
        name: of the element.
        truth: the impacts.
        deceleration: of `deceleration`.
        gravity: along the motion [m/s^2].
    """
    mass, velocity = truth[["mass_kg", "velocity_m_s"]].to_numpy().T
    met = Collision.of(element(name), _parameters(name, truth), mass, velocity)
    share = np.broadcast_to(met.impactor_share, mass.shape)[:, None]
    pushes = deceleration > 0
    return mass[:, None] / share * np.where(pushes, deceleration - (1 - share) * gravity, 0.0)


def _diameter(truth: pd.DataFrame) -> PerImpact | None:
    return truth["diameter_m"].to_numpy() if "diameter_m" in truth else None


def _parameters(name: str, truth: pd.DataFrame) -> dict[str, Array]:
    """Of the element, by name, each [impact]."""
    columns = {"K": "K_N_per_m", "C": "C_N_s_per_m"}
    columns |= {parameter.name: parameter.name for parameter in element(name).extra}
    return {parameter: jnp.asarray(truth[column].to_numpy()) for parameter, column in columns.items()}


@jax.jit
def _side_by_side(time: Array, contact: Array, leaves: Array, motion: tuple[Array, ...]) -> Array:
    since = time - contact
    moved = impact_motion(jnp.maximum(since, 0), *motion)
    return jnp.where((since >= 0) & (since < leaves), moved.deceleration, 0)


class _Chain(NamedTuple):
    """What stands between a quantity and its values in the file.

    Attributes:
        sensed: what the sensor feels, of the impacts and their decelerations.
        recorder: the low-pass, if any.
        gain, offset: columns of the truth.
        noise_sd: standard deviation of the noise, and as a fraction of the peak, whose variances add up.
        random: of the noise.
        limit: the sensor clips beyond this, either way.
        bits: the range has 2 to this power steps.
    """

    sensed: Callable[[pd.DataFrame, np.ndarray], np.ndarray]
    recorder: LowPassFilter | None
    gain: str
    offset: str
    noise_sd: tuple[float, float]
    random: np.random.Generator
    limit: float | None
    bits: int | None = None

    def values(self, truth: pd.DataFrame, moved: Steps, recorded: Recorded, grid: _Grid) -> Values:
        """The samples that are recorded, one impact's after another's.

        Args:
            truth: the impacts.
            moved: their decelerations at the times of the ``grid``.
            recorded: which samples are.
            grid: of the motion.
        """
        exact = grid.passed(self.sensed(truth, moved), self.recorder)
        noise = grid.noise(self, recorded)
        gain, offset = (truth[name].to_numpy()[:, None] for name in (self.gain, self.offset))
        sd = np.hypot(self.noise_sd[0], self.noise_sd[1] * exact.max(axis=1, keepdims=True))
        value = (gain * exact + offset)[recorded] + np.repeat(sd[:, 0], recorded.sum(axis=1)) * noise
        if self.limit is None:
            return value
        if self.bits is not None:
            step = 2 * self.limit / 2**self.bits
            value = np.round(np.clip(value, -self.limit, self.limit) / step) * step
        return np.clip(value, -self.limit, self.limit)


def _chains(simulation: Simulation, random: _Streams) -> Iterator[_Chain]:
    """Of the deceleration, and of the force if one is recorded."""
    recording, force = simulation.recording, simulation.recording.force
    noise, columns = (recording.noise_sd_m_s2, recording.noise_relative_to_peak), ("gain", "offset_m_s2")
    limits = recording.range_m_s2, recording.bits
    yield _Chain(lambda _, moved: moved, simulation.recorder, *columns, noise, random.noise, *limits)
    if force is not None:
        noise, columns = (force.noise_sd_N, force.noise_relative_to_peak), ("force_gain", "force_offset_N")

        def sensed(truth: pd.DataFrame, moved: np.ndarray) -> np.ndarray:
            """The tissue's force below it, or at the impactor (M - m) d [N]."""
            if force.place == "base":
                return tissue_force(simulation.tissue.element, truth, moved, gravity_m_s2(simulation.gravity))
            return (truth["mass_kg"].to_numpy()[:, None] - force.tip_mass_kg) * moved

        yield _Chain(sensed, force.recorder, *columns, noise, random.forces, force.limit_N)


def _recorded(
    simulation: Simulation, truth: pd.DataFrame, n: np.ndarray, random: _Streams
) -> Iterator[list[np.ndarray]]:
    """Recorded values, and forces where there are any, in blocks of impacts that bound the memory in use."""
    rate, finer, ring = simulation.recording.sampling_rate_hz, 1, 0
    gravity, chains = gravity_m_s2(simulation.gravity), [*_chains(simulation, random)]
    for chain in chains:
        if (one := chain.recorder) is not None:
            steps = 1 if one.digital else int(np.ceil(_FINER * max(1.0, one.low_pass_hz / rate)))
            # On either side until the filter has come to rest, forwards and backwards.
            finer, ring = max(finer, steps), max(ring, int(np.ceil(_AT_REST / decay(one, 1 / rate) * rate)))
    grid = _Grid(rate, finer, ring)
    time = np.arange(-ring * finer, (n.max() + ring) * finer) / (rate * finer)
    rows = min(len(n), max(1, _BLOCK // len(time)))
    for begin in range(0, len(n), rows):
        # Every block has the same number of rows, so that one compilation serves them all.
        index = np.minimum(np.arange(begin, begin + rows), len(n) - 1)
        part = slice(begin, min(begin + rows, len(n)))
        met = deceleration(simulation.tissue.element, truth.iloc[index], time, gravity)
        moved, block = np.asarray(met)[: part.stop - begin], truth.iloc[part]
        recorded = np.arange(n.max()) < n[part, None]
        yield [chain.values(block, moved, recorded, grid) for chain in chains]


class _Grid(NamedTuple):
    """Times of a motion: ``finer`` steps a sample, and ``ring`` samples more on either side."""

    rate: float
    finer: int
    ring: int

    def passed(self, motion: Steps, recorder: LowPassFilter | None) -> PerSample:
        """What a low-pass makes of a motion at these times, at the samples."""
        finer = self.finer
        if recorder is None or recorder.digital:
            motion, finer = motion[:, ::finer], 1
        passed = motion if recorder is None else on_even_grid(motion, self.rate * finer, recorder)
        return passed[:, self.ring * finer : -self.ring * finer or None : finer]

    def noise(self, chain: _Chain, recorded: Recorded) -> Values:
        """Noise of variance 1 at the samples that are recorded, one impact's after another's."""
        recorder, random = chain.recorder, chain.random
        if recorder is None or recorder.noise != "before":
            return random.standard_normal(recorded.sum())
        # White before the filter, at the samples or finer.
        finer = 1 if recorder.digital else int(np.ceil(_NOISE_FINER * recorder.low_pass_hz / self.rate))
        rate, ring = self.rate * finer, self.ring * finer
        impulse = np.zeros((1, 2 * max(self.ring, 1) * finer + 1))
        impulse[0, impulse.shape[1] // 2] = 1
        size = np.sqrt((on_even_grid(impulse, rate, recorder) ** 2).sum())
        white = random.standard_normal((len(recorded), recorded.shape[1] * finer + 2 * ring))
        filtered = on_even_grid(white, rate, recorder) / size
        return filtered[:, ring : -ring or None : finer][recorded]


def write_campaign(folder: Path, campaign: Campaign, simulation: Simulation) -> None:
    """Write ``dataset.toml``, ``impacts.csv``, the traces and ``truth.csv``.

    ``truth.csv`` has one row per impact. The parameters that all impacts share stand in the specification,
    which the caller copies beside it.
    """
    table = long_table(pd.Index(campaign.impacts["impact"]), campaign.traces)
    for force in campaign.further:
        table[FORCE_COLUMN] = force.value
    write_dataset(
        folder,
        settings=campaign.settings.stated(),
        impacts=campaign.impacts,
        traces=table,
        trace_file=f"traces.{simulation.output.traces}",  # type: ignore[arg-type]
    )
    write_table(campaign.truth, folder / "truth.csv")
