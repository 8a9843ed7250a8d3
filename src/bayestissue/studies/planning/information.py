"""What one impact will tell of log K and log C, by condition: the precision of its Gaussian site.

Of each condition a few impacts are simulated on people of the population, through the recorder as it is
declared, and summarised by the same expansion that a fit of them would use. What else a trace tells, such
as the noise or an element's further parameters, is integrated out under its own prior,

    P = P_uu - P_un (P_nn + D_n)^-1 P_nu,

and planned impacts take these precisions in turn. Whether a Gaussian can stand for the traces at all shows in
how far the sites' centres are from the truth: the mean of (m - u)' P (m - u) over the length of u is 1 if it
can.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Float

from bayestissue.inference.execution.chunks import map_impacts
from bayestissue.inference.factors.conditional import ConditionalPrior
from bayestissue.inference.factors.expansions import expanded, first_guess
from bayestissue.inference.factors.sites import laplace_sites
from bayestissue.model.hierarchy.gaussian.factor import GaussianFactor
from bayestissue.model.hierarchy.specification import ModelSpecification
from bayestissue.model.hierarchy.trace_data import Prepared, prepare
from bayestissue.model.hierarchy.trace_models import GAIN, TraceModel, with_normal_errors
from bayestissue.recordings.dataset.dataset_file import Gravity, LowPassFilter
from bayestissue.studies.planning.plan_settings import PLAN as SETTINGS
from bayestissue.studies.simulation.campaign import simulate
from bayestissue.studies.simulation.simulation_file import (
    Condition,
    RecordedDeceleration,
    Recording,
    Simulation,
    StudyDesign,
    Tissue,
)

_CONDITION = ("mass_kg", "velocity_m_s", "diameter_m")


@dataclass(frozen=True, eq=False)
class Information:
    """Precisions of log K and log C from one impact's recording.

    Attributes:
        conditions: ``mass_kg``, ``velocity_m_s`` and, where it counts, ``diameter_m``.
        precision: of some people in each condition.
        calibration: mean of (m - u)' P (m - u) over the length of u, over all of them.
    """

    conditions: pd.DataFrame
    precision: Float[np.ndarray, "condition person parameter parameter"]
    calibration: float

    @property
    def is_gaussian(self) -> bool:
        """Whether Gaussian sites may stand for the traces."""
        low, high = SETTINGS.calibrated
        return low < self.calibration < high

    @property
    def measurement_sd(self) -> dict[str, float]:
        """The standard deviation that one trace leaves log K and log C: the median over people."""
        covariance = np.linalg.inv(self.precision)
        return {q: float(np.sqrt(np.median(covariance[..., k, k]))) for k, q in enumerate("KC")}

    def of_rows(self, rows: pd.DataFrame) -> Float[np.ndarray, "impact parameter parameter"]:
        """The precision of each planned impact."""
        conditions, hit_by = map(pd.MultiIndex.from_frame, (self.conditions, rows[list(self.conditions)]))
        condition = conditions.get_indexer(hit_by)
        person = pd.factorize(rows["subject"])[0] + rows.groupby("subject").cumcount().to_numpy()
        return self.precision[condition, person % self.precision.shape[1]]


def information(
    rows: pd.DataFrame,
    specification: ModelSpecification,
    tissue: Tissue,
    simulation: Simulation,
    seed: int = 0,
) -> Information:
    """What traces in the conditions of these rows tell.

    Args:
        rows: of all designs: ``mass_kg``, ``velocity_m_s``.
        specification: the analysis: likelihood, element, signal.
        tissue: of the people that are simulated: see `typical_tissue`.
        simulation: whose recording, recorder and gravity are those of the study.
        seed: of the simulated impacts.

    Raises:
        InputError: the recorder's traces are no data for this analysis, as where the window has too few
            samples.
    """
    columns = [name for name in _CONDITION if name in rows]
    conditions = rows[columns].drop_duplicates(ignore_index=True)
    hit_by = tuple(
        Condition(trial=f"t{number}", **{str(name): value for name, value in row.items()})
        for number, row in enumerate(conditions.to_dict("records"))
    )
    # An error of the mass is part of how impacts scatter, and not of what one impact tells; that of the gain
    # is, and whether others share it does not show in one.
    errors = {"relative_mass_sd": 0.0, "gain_error": "impact"}
    planned = simulation.model_copy(
        update={
            "design": StudyDesign(conditions=hit_by, subjects=SETTINGS.people),
            "tissue": tissue,
            "recording": simulation.recording.model_copy(update=errors),
        }
    )
    campaign = simulate(planned, seed)
    prepared = prepare(campaign.dataset("plan"), specification.alone(), source=specification.name)
    truth = np.log(campaign.truth[["K_N_per_m", "C_N_s_per_m"]].to_numpy())
    start = first_guess(prepared)
    start[:, :2] = truth
    nuisance = start[:, 2:]
    spread = spreads_of_nuisance(prepared.model)
    sd = np.append(np.maximum([tissue.sd_subject_K, tissue.sd_subject_C], 1e-3), spread)
    log_mass = np.log(prepared.signal.mass / tissue.reference_mass_kg)
    typical = np.log([tissue.K_N_per_m, tissue.C_N_s_per_m])
    exponents = tissue.mass_exponent_K, tissue.mass_exponent_C
    mean = np.append(typical + np.outer(log_mass, exponents), nuisance, axis=1)
    prior = ConditionalPrior(mean, np.diag(sd**-2.0)).of_each()
    smooth = with_normal_errors(prepared.data)
    sites = map_impacts(partial(laplace_sites, prepared.model), smooth, start, prior)
    size = truth.shape[1]
    centre, precision = without_nuisance(sites, sites.centre[:, 2:], spread)
    deviation = centre - truth
    calibration = float(np.einsum("ia,iab,ib->i", deviation, precision, deviation).mean() / size)
    return Information(
        conditions, precision.reshape(len(conditions), SETTINGS.people, size, size), calibration
    )


def told_of_tissue(
    prepared: Prepared,
) -> tuple[Float[np.ndarray, "impact 2"], Float[np.ndarray, "impact 2 2"]]:
    """What each recording tells: `without_nuisance` of its likelihood, expanded at its maximum."""
    model, sites = prepared.model, expanded(prepared)
    mean = np.array(sites.centre[:, 2:])
    if model.gain:
        # Known as the dataset declares it, and not by each trace.
        mean[:, model.nuisance.index(GAIN)] = model.priors.log_gain.mean
    return without_nuisance(sites, mean, spreads_of_nuisance(model))


def without_nuisance(
    sites: GaussianFactor, mean: Float[np.ndarray, "impact nuisance"], spread: Float[np.ndarray, " nuisance"]
) -> tuple[Float[np.ndarray, "impact 2"], Float[np.ndarray, "impact 2 2"]]:
    """Centre and precision of log K and log C, the other parameters integrated out.

    Args:
        sites: of all parameters of each impact.
        mean: of the others' prior.
        spread: its standard deviations.
    """
    P, shift, centre = (np.asarray(part) for part in (sites.precision, sites.shift, sites.centre))
    across = np.linalg.solve(P[:, 2:, 2:] + np.diag(spread**-2.0), P[:, 2:, :2])
    precision = P[:, :2, :2] - P[:, :2, 2:] @ across
    # A site may be written about another point than its maximum.
    pull = shift[:, 2:] - (centre[:, 2:] - mean) / spread**2
    gained = shift[:, :2] - np.einsum("ina,in->ia", across, pull)
    return centre[:, :2] + np.linalg.solve(precision, gained[..., None])[..., 0], precision


def spreads_of_nuisance(model: TraceModel) -> Float[np.ndarray, " nuisance"]:
    """How much each further parameter may differ from what is known of it: between impacts, by its prior.

    A gain that all impacts share differs from 0 as the dataset declares it.
    """
    priors: dict[str, Any] = model.priors.by_name()
    unknown = [name for name in model.nuisance if name != GAIN]
    spreads = {name: priors[f"sd_{name}"].scale for name in unknown} | {GAIN: model.priors.log_gain.sd}
    return np.array([spreads[name] for name in model.nuisance], float)


def simulation_of(
    recording: RecordedDeceleration, *, recorder: LowPassFilter | None = None, gravity: Gravity = "none"
) -> Simulation:
    """A specification of which the measuring chain alone counts."""
    tissue = Tissue(K_N_per_m=3000.0, C_N_s_per_m=25.0)
    chain = Recording(**recording.model_dump(exclude={"name"}))
    return Simulation(name="plan", tissue=tissue, recording=chain, recorder=recorder, gravity=gravity)
