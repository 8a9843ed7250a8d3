"""A simulated campaign: the truth of every impact, what a recorder makes of it, and its dataset folder."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float, Int

from bayestissue.dataset import write_dataset
from bayestissue.dataset.chain import Contact, Recorder, Uncertainty
from bayestissue.dataset.impacts import REFERENCE
from bayestissue.dataset.model import Channel, Dataset, channel_settings
from bayestissue.dataset.settings import gravity_m_s2
from bayestissue.dataset.traces import Traces
from bayestissue.hierarchy.formulas.group_terms import MASS_TERM, grouping_of
from bayestissue.results.tables import write_table
from bayestissue.signal.filters import decay, on_even_grid
from bayestissue.simulation.contact import deceleration, leaves, tissue_force, what_is_met
from bayestissue.simulation.specification import Phantom, RecordedForce, Recording, Simulation, Tissue

# Of the trace table, beside ``value``.
FORCE_COLUMN = "force_N"
_BLOCK = 1_000_000
# Steps of the motion between two samples of a recorder with a low-pass, or in a period of its corner, and
# time constants of the filter's slowest pole until it rests.
_FINER, _AT_REST = 64, 25.0
# Samples of noise before a filter in a period of its corner, at the least.
_NOISE_FINER = 8


@dataclass(frozen=True)
class Campaign:
    """What was simulated.

    Attributes:
        impacts: the table that a lab would have: ``impact``, ``subject``, ``trial``, ``mass_kg``,
            ``velocity_m_s``, ``energy_J``, ``sampling_rate_hz``, and the design's further factors.
        truth: one row per impact, with what the lab would like to know.
        n_samples: [impact], samples of each recording.
        time: [sample], s, all recordings one after another; each recorder's clock starts at 0.
        value: [sample], recorded deceleration, m/s².
        uncertainty: standard deviations of the measuring chain.
        contact: at a sample, or between two.
        recorder: the low-pass that the recordings went through, if any.
        gravity: along the motion, m/s²; what is recorded is then force over mass.
        headform: whether the impactor stands for a head.
        force: [sample], recorded beside it, N; None where none was.
        force_channel: what is declared of it, without recordings.
        force_limit: its sensor's, N.
    """

    impacts: pd.DataFrame
    truth: pd.DataFrame
    n_samples: Int[np.ndarray, " impact"]
    time: Float[np.ndarray, " sample"]
    value: Float[np.ndarray, " sample"]
    uncertainty: Uncertainty
    contact: Contact
    recorder: Recorder | None = None
    gravity: float = 0.0
    headform: bool = False
    force: Float[np.ndarray, " sample"] | None = None
    force_channel: Channel | None = None
    force_limit: float = np.inf

    def traces(self) -> pd.DataFrame:
        """The long trace table: ``impact``, ``time_s``, ``value`` and, where it was recorded, ``force_N``."""
        codes = np.repeat(np.arange(len(self.n_samples)), self.n_samples)
        names = pd.Categorical.from_codes(codes, categories=pd.Index(self.impacts["impact"]))
        force = {} if self.force is None else {FORCE_COLUMN: self.force}
        return pd.DataFrame({"impact": names, "time_s": self.time, "value": self.value, **force})

    def dataset(self, name: str) -> Dataset:
        """The campaign as a dataset, as if it had been written and read, without a folder or a hash."""
        start = np.cumsum([0, *self.n_samples])
        channels: tuple[Channel, ...] = ()
        if self.force is not None and self.force_channel is not None:
            clipped = np.where(np.abs(self.force) >= self.force_limit, np.sign(self.force), 0).astype(np.int8)
            traces = Traces(self.time, self.force, start, clipped=clipped if clipped.any() else None)
            channels = (replace(self.force_channel, traces=traces),)
        return Dataset(
            name=name,
            description="",
            impacts=self.impacts,
            traces=Traces(self.time, self.value, start),
            quantity="deceleration",
            uncertainty=self.uncertainty,
            warnings=(),
            left_out=(),
            folder=None,
            input_hash="",
            contact=self.contact,
            recorder=self.recorder,
            gravity=self.gravity,
            headform=self.headform,
            channels=channels,
        )


def simulate(simulation: Simulation, seed: int | None = None) -> Campaign:
    """Draw the truth of every impact and record it; the same seed gives the same numbers.

    The motion is that of a mass M that meets the tissue's element at V; the tissue can push but not pull, so
    the recording is at rest again from when the force is 0. A recorder's low-pass takes the motion as it is
    between the samples, a digital one the samples; range and steps are those of what comes after it, and so
    is noise unless it says otherwise.
    Tissue, chain and noise have random streams of their own: more noise leaves the truth as it is. Needs
    float64 (`bayestissue.runtime.configure`).

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
        n_samples=np.concatenate([people.n_samples, spring.n_samples]),
        time=np.concatenate([people.time, spring.time]),
        value=np.concatenate([people.value, spring.value]),
    )


def _of_phantom(simulation: Simulation, phantom: Phantom) -> Simulation:
    """The same conditions and measuring chain, and a spring in place of people."""
    tissue = Tissue(K_N_per_m=phantom.K_N_per_m, C_N_s_per_m=phantom.C_N_s_per_m)
    design = simulation.design.model_copy(update={"subjects": 1, "repeats": phantom.repeats})
    return simulation.model_copy(update={"tissue": tissue, "design": design})


def _simulated(simulation: Simulation, seed: int | tuple[int, ...]) -> Campaign:
    """People alone, or a phantom alone."""
    streams = np.random.SeedSequence(seed).spawn(7)
    tissue, chain, noise, further, groups, factors, forces = (
        np.random.default_rng(stream) for stream in streams
    )
    impacts = _impacts(simulation, factors)
    truth = _truth(simulation, impacts, tissue, chain, further, groups)
    rate = simulation.recording.sampling_rate_hz
    end = truth["contact_time_s"].to_numpy() + leaves(truth)
    n = np.ceil((end + simulation.recording.after_contact_s) * rate).astype(int) + 1
    sample = np.arange(n.sum()) - np.repeat(np.cumsum(n) - n, n)
    if simulation.recording.force is not None:
        truth = truth.assign(**_of_force(simulation.recording.force, len(truth), forces))
    parts, of_force = zip(*_recorded(simulation, truth, n, noise, forces), strict=True)
    value = np.concatenate(parts)
    if simulation.output.decimals is not None:
        value = np.round(value, simulation.output.decimals)
    value = value.astype(np.float32) if simulation.output.float32 else value
    recording = simulation.recording
    uncertainty = Uncertainty(
        recording.relative_mass_sd,
        recording.velocity_sd_m_s,
        recording.relative_gain_sd,
        recording.offset_sd_m_s2,
    )
    recorder = simulation.recorder.values() if simulation.recorder else None
    gravity = gravity_m_s2(simulation.gravity)
    chain_of = uncertainty, recording.contact, recorder, gravity, simulation.headform
    time = np.round(sample / rate, 9)
    if recording.force is None:
        return Campaign(impacts, truth, n, time, value, *chain_of)
    return Campaign(
        impacts,
        truth,
        n,
        time,
        value,
        *chain_of,
        np.concatenate(of_force),
        _channel(recording.force),
        recording.force.limit_N or np.inf,
    )


def _of_force(force: RecordedForce, count: int, random: np.random.Generator) -> dict[str, Any]:
    """Gain, one for all impacts, and zero of the force's channel."""
    return {
        "force_gain": 1 + force.relative_gain_sd * random.standard_normal(),
        "force_offset_N": force.offset_sd_N * random.standard_normal(count),
    }


def _channel(force: RecordedForce) -> Channel:
    """What a lab would declare of it."""
    recorder = force.recorder.values() if force.recorder else None
    declared = force.relative_gain_sd, force.tip_mass_kg, recorder
    return Channel("force", "force", force.place, Traces.of([]), *declared)


def _impacts(simulation: Simulation, random: np.random.Generator) -> pd.DataFrame:
    people = pd.DataFrame({"subject": [f"s{k + 1:02d}" for k in range(simulation.design.subjects)]})
    repeats = pd.DataFrame({"repeat": np.arange(simulation.design.repeats) + 1})
    impacts = simulation.conditions().merge(people, how="cross")
    crossed = [factor for factor in simulation.design.factors if factor.every]
    for factor in crossed:
        impacts = impacts.merge(pd.DataFrame({factor.name: factor.levels}), how="cross")
    impacts = impacts.merge(repeats, how="cross")
    for factor in simulation.design.factors:
        if not factor.every:
            impacts[factor.name] = random.permutation(np.resize(factor.levels, len(impacts)))
    names = impacts["trial"] + "-" + impacts["subject"]
    for factor in crossed:
        names += "-" + impacts[factor.name]
    if simulation.design.repeats > 1:
        names += "-r" + impacts["repeat"].astype(str)
    energy = impacts["mass_kg"] * impacts["velocity_m_s"] ** 2 / 2
    rate = simulation.recording.sampling_rate_hz
    table = impacts.drop(columns="repeat").assign(impact=names, energy_J=energy, sampling_rate_hz=rate)
    factors = [factor.name for factor in simulation.design.factors]
    columns = [
        "impact",
        "subject",
        "trial",
        *factors,
        "mass_kg",
        "velocity_m_s",
        "energy_J",
        "sampling_rate_hz",
    ]
    return table[columns + ["diameter_m"] * ("diameter_m" in table)]


def _truth(
    simulation: Simulation,
    impacts: pd.DataFrame,
    tissue: np.random.Generator,
    chain: np.random.Generator,
    further: np.random.Generator,
    groups: np.random.Generator,
) -> pd.DataFrame:
    recording, count = simulation.recording, len(impacts)
    stated = impacts["mass_kg"].to_numpy() * recording.mass_factor
    mass = stated * (1 + recording.relative_mass_sd * chain.standard_normal(count))
    velocity = impacts["velocity_m_s"].to_numpy() + recording.velocity_sd_m_s * chain.standard_normal(count)
    gain = 1 + recording.relative_gain_sd * chain.standard_normal(count)
    offset = recording.offset_sd_m_s2 * chain.standard_normal(count)
    since_sample = chain.uniform(size=count)
    contact = recording.before_contact_s + since_sample / recording.sampling_rate_hz
    if recording.contact == "on_sample":
        before = np.ceil(recording.before_contact_s * recording.sampling_rate_hz)
        contact = np.full(count, before / recording.sampling_rate_hz)
    size = np.log(mass / simulation.tissue.reference_mass_kg)
    effects = _effects(simulation.tissue, impacts, tissue)
    _add_group_terms(simulation.tissue, impacts, size, groups, effects)
    stiffness, damping = (
        getattr(simulation.tissue, name)
        * np.exp(getattr(simulation.tissue, f"mass_exponent_{name[0]}") * size + effects[name[0]])
        for name in ("K_N_per_m", "C_N_s_per_m")
    )
    responses = ("K", "C", *simulation.tissue.parameters)
    motion = (mass, velocity, gravity_m_s2(simulation.gravity), simulation.headform)
    met = what_is_met(simulation.tissue, impacts, stiffness, damping, *motion, further, effects)
    return pd.DataFrame(
        {
            "impact": impacts["impact"],
            "K_N_per_m": stiffness,
            "C_N_s_per_m": damping,
            **{name: met.pop(name) for name in ("omega_n_rad_s", "zeta")},
            "mass_kg": mass,
            "velocity_m_s": velocity,
            "gain": gain,
            "offset_m_s2": offset,
            "contact_time_s": contact,
            **met,
            **{name: effect for name, effect in effects.items() if name not in responses},
        }
    )


def _effects(tissue: Tissue, impacts: pd.DataFrame, random: np.random.Generator) -> dict[str, np.ndarray]:
    levels = {
        "subject": pd.factorize(impacts["subject"])[0],
        "trial": pd.factorize(impacts["trial"])[0],
        "impact": np.arange(len(impacts)),
    }
    effects: dict[str, np.ndarray] = {"K": np.zeros(len(impacts)), "C": np.zeros(len(impacts))}
    for level, codes in levels.items():
        standard = random.standard_normal((codes.max() + 1, 2)) @ _mixing(tissue).T
        for column, name in enumerate(("K", "C")):
            effect = getattr(tissue, f"sd_{level}_{name}") * standard[codes, column]
            effects[f"{level}_effect_{name}"] = effect
            effects[name] = effects[name] + effect
    return effects


def _add_group_terms(
    tissue: Tissue,
    impacts: pd.DataFrame,
    log_mass: Float[np.ndarray, " impact"],
    random: np.random.Generator,
    effects: dict[str, np.ndarray],
) -> None:
    """Add the effects of further group terms, by the names that a posterior gives them.

    Of a slope the truth has the level's own coefficient, the population's included.
    """
    for term, spread in tissue.spreads().items():
        code = grouping_of(impacts, term.factors).code
        if term.slope == MASS_TERM:
            covariate = log_mass
        elif term.slope:
            covariate = impacts[term.slope].to_numpy() - impacts[term.slope].mean()
        else:
            covariate = np.ones(len(impacts))
        standard = random.standard_normal((code.max() + 1, 2)) @ _mixing(tissue).T
        term_effects = {"K": spread.K * standard[code, 0], "C": spread.C * standard[code, 1]}
        for name, sd in spread.__pydantic_extra__.items():
            term_effects[name] = sd * random.standard_normal(code.max() + 1)[code]
        for name, effect in term_effects.items():
            effects[name] = effects.get(name, 0.0) + effect * covariate
            shared = getattr(tissue, f"mass_exponent_{name}", 0.0) if term.slope == MASS_TERM else 0.0
            column = term.coefficient(name) if term.slope else term.effect(name)
            effects[column] = effects.get(column, 0.0) + effect + shared


def _mixing(tissue: Tissue) -> Float[np.ndarray, "2 2"]:
    return np.array([[1, 0], [tissue.correlation, np.sqrt(1 - tissue.correlation**2)]])


def _recorded(
    simulation: Simulation,
    truth: pd.DataFrame,
    n: np.ndarray,
    random: np.random.Generator,
    of_force: np.random.Generator,
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Recorded values, and forces where there are any, in blocks of impacts that bound the memory in use."""
    recording = simulation.recording
    rate, finer, ring = recording.sampling_rate_hz, 1, 0
    gravity = gravity_m_s2(simulation.gravity)
    recorder, force_recorder = (
        settings.values() if settings else None
        for settings in (simulation.recorder, recording.force and recording.force.recorder)
    )
    for one in (recorder, force_recorder):
        if one is not None:
            steps = 1 if one.digital else int(np.ceil(_FINER * max(1.0, one.low_pass_hz / rate)))
            # On either side until the filter has come to rest, forwards and backwards.
            finer, ring = max(finer, steps), max(ring, int(np.ceil(_AT_REST / decay(one, 1 / rate) * rate)))
    time = np.arange(-ring * finer, (n.max() + ring) * finer) / (rate * finer)
    rows = min(len(n), max(1, _BLOCK // len(time)))
    for begin in range(0, len(n), rows):
        # Every block has the same number of rows, so that one compilation serves them all.
        index = np.minimum(np.arange(begin, begin + rows), len(n) - 1)
        part = slice(begin, min(begin + rows, len(n)))
        met = deceleration(simulation.tissue.element, truth.iloc[index], time, gravity)
        moved = np.asarray(met)[: part.stop - begin]
        d = _passed(moved, recorder, rate, finer, ring)
        recorded = np.arange(d.shape[1]) < n[part, None]
        noise = _noise(recorder, rate, ring, recorded, random)
        force = np.empty(0)
        if recording.force is not None:
            pushes = _force(simulation, recording.force, truth.iloc[part], moved)
            behind = _passed(pushes, force_recorder, rate, finer, ring)
            noise_of_force = _noise(force_recorder, rate, ring, recorded, of_force)
            force = _recorded_force(recording.force, truth.iloc[part], behind, recorded, noise_of_force)
        yield _through_chain(recording, truth.iloc[part], d, recorded, noise), force


def _passed(
    motion: Float[np.ndarray, "impact step"], recorder: Recorder | None, rate: float, finer: int, ring: int
) -> Float[np.ndarray, "impact sample"]:
    """What a recorder's low-pass makes of a motion in ``finer`` steps a sample, ``ring`` samples about it."""
    if recorder is None or recorder.digital:
        motion, finer = motion[:, ::finer], 1
    passed = motion if recorder is None else on_even_grid(motion, rate * finer, recorder)
    return passed[:, ring * finer : -ring * finer or None : finer]


def _noise(
    recorder: Recorder | None,
    rate: float,
    ring: int,
    recorded: Bool[np.ndarray, "impact sample"],
    random: np.random.Generator,
) -> Float[np.ndarray, " recorded"]:
    """Noise of variance 1 at the samples that are recorded, one impact's after another's."""
    if recorder is not None and recorder.noise == "before":
        return _filtered_noise(recorder, rate, ring, recorded.shape, random)[recorded]
    return random.standard_normal(recorded.sum())


def _force(
    simulation: Simulation,
    force: RecordedForce,
    truth: pd.DataFrame,
    motion: Float[np.ndarray, "impact step"],
) -> Float[np.ndarray, "impact step"]:
    """What the sensor feels [N]: the tissue's force below it, or at the impactor (M - m) d."""
    if force.place == "base":
        return tissue_force(simulation.tissue.element, truth, motion, gravity_m_s2(simulation.gravity))
    return (truth["mass_kg"].to_numpy()[:, None] - force.tip_mass_kg) * motion


def _recorded_force(
    force: RecordedForce,
    truth: pd.DataFrame,
    exact: Float[np.ndarray, "impact sample"],
    recorded: Bool[np.ndarray, "impact sample"],
    noise: Float[np.ndarray, " recorded"],
) -> Float[np.ndarray, " recorded"]:
    """(1 + gain) F + zero + noise of variance 1, in its unit, at the samples that are recorded.

    F is ``exact``: that of `_force` behind the sensor's low-pass. One impact's samples after another's.
    """
    gain, offset = (truth[name].to_numpy()[:, None] for name in ("force_gain", "force_offset_N"))
    sd = np.hypot(force.noise_sd_N, force.noise_relative_to_peak * exact.max(axis=1, keepdims=True))
    noise = np.repeat(sd[:, 0], recorded.sum(axis=1)) * noise
    value = (gain * exact + offset)[recorded] + noise
    return value if force.limit_N is None else np.clip(value, -force.limit_N, force.limit_N)


def _filtered_noise(
    recorder: Recorder, rate: float, ring: int, shape: tuple[int, ...], random: np.random.Generator
) -> Float[np.ndarray, "impact sample"]:
    """Noise of variance 1 that was white before the filter, at the samples or finer."""
    finer = 1 if recorder.digital else int(np.ceil(_NOISE_FINER * recorder.low_pass_hz / rate))
    length = (shape[1] + 2 * ring) * finer
    impulse = np.zeros((1, 2 * max(ring, 1) * finer + 1))
    impulse[0, impulse.shape[1] // 2] = 1
    size = np.sqrt((on_even_grid(impulse, rate * finer, recorder) ** 2).sum())
    filtered = on_even_grid(random.standard_normal((shape[0], length)), rate * finer, recorder) / size
    return filtered[:, ring * finer : -ring * finer or None : finer]


def _through_chain(
    recording: Recording,
    truth: pd.DataFrame,
    motion: Float[np.ndarray, "impact sample"],
    recorded: Bool[np.ndarray, "impact sample"],
    noise: Float[np.ndarray, " recorded"],
) -> Float[np.ndarray, " recorded"]:
    """The samples that are recorded, one impact's after another's; ``noise`` has variance 1."""
    gain, offset = (truth[name].to_numpy()[:, None] for name in ("gain", "offset_m_s2"))
    peak = motion.max(axis=1, keepdims=True)
    sd = np.hypot(recording.noise_sd_m_s2, recording.noise_relative_to_peak * peak)
    value = (gain * motion + offset)[recorded]
    value = value + np.repeat(sd[:, 0], recorded.sum(axis=1)) * noise
    if recording.range_m_s2 is not None:
        value = np.clip(value, -recording.range_m_s2, recording.range_m_s2)
        if recording.bits is not None:
            step = 2 * recording.range_m_s2 / 2**recording.bits
            value = np.clip(np.round(value / step) * step, -recording.range_m_s2, recording.range_m_s2)
    return value


def write_campaign(folder: Path, campaign: Campaign, simulation: Simulation) -> None:
    """Write ``dataset.toml``, ``impacts.csv``, the traces and ``truth.csv``.

    ``truth.csv`` has one row per impact. The parameters that all impacts share stand in the specification,
    which the caller copies beside it.
    """
    settings: dict[str, Any] = {
        "name": simulation.name,
        "description": simulation.description or "Simulated; truth.csv holds what it was made from.",
        "source": "bayestissue simulate",
        "signal": {"quantity": "deceleration", "unit": "m/s^2"},
        "uncertainty": asdict(campaign.uncertainty),
    }
    if campaign.gravity:
        settings["signal"] |= {"gravity": campaign.gravity}
    if campaign.headform:
        settings["impactor"] = {"headform": True}
    settings["signal"] |= {"contact": campaign.contact}
    if campaign.recorder is not None:
        settings["recorder"] = campaign.recorder.settings()
    if campaign.force_channel is not None:
        where: dict[str, Any] = {"value_column": FORCE_COLUMN}
        if np.isfinite(campaign.force_limit):
            where |= {"limit": campaign.force_limit}
        settings["channel"] = [channel_settings(campaign.force_channel) | where]
    write_dataset(
        folder,
        settings=settings,
        impacts=campaign.impacts,
        traces=campaign.traces(),
        trace_file=f"traces.{simulation.output.traces}",  # type: ignore[arg-type]
    )
    write_table(campaign.truth, folder / "truth.csv")
