"""The hierarchy over recorded traces: every impact's likelihood under one population of people and trials.

`plain_model` says what is believed, top down, as numpyro's own samplers take it. A fit's chain asks for the
parts: hyperparameters and their prior at coordinates, the likelihood of each trace, and the closed forms of
`bayestissue.model.hierarchy.gaussian.effects`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any, Literal, NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np
import numpyro
import numpyro.distributions as dist
from jax import Array
from jaxtyping import Float, Int
from numpyro.distributions import biject_to, constraints
from numpyro.distributions.transforms import AffineTransform, ComposeTransform, SoftplusTransform

from bayestissue.base.impact_arrays import JaxPerImpact, padded_rows
from bayestissue.mechanics.elements import element as element_named
from bayestissue.model.hierarchy import SIDE_BY_SIDE
from bayestissue.model.hierarchy.gaussian.arrangement import PopulationDesign, expected
from bayestissue.model.hierarchy.gaussian.effects import Covariances, SitesByCell
from bayestissue.model.hierarchy.gaussian.factor import GaussianFactor
from bayestissue.model.hierarchy.population import (
    EffectParts,
    Hyperparameters,
    covariances_of,
)
from bayestissue.model.hierarchy.priors import HalfNormal, Priors
from bayestissue.model.hierarchy.responses import RESPONSES, parameter_of
from bayestissue.model.likelihood.displacements import DisplacementRecord, MeasuredDisplacement
from bayestissue.model.likelihood.impact import MeasuredImpact, NoiseParameters
from bayestissue.model.likelihood.record import DecelerationRecord

Kind = Literal["arma", "a2", "impact"]
# So many sampling intervals before the middle of its own contact is.
CONTACT = "contact"
# Of recorded over true deceleration, where one sensor errs by one factor in all impacts.
GAIN = "log_gain"
# The spread between impacts of such an error, in units of its prior: small beside all else that a trace's
# height depends on.
_GAIN_SPREAD = 0.1
# Of a force beside the deceleration: its noise, and it over mass times deceleration.
FORCE = ("noise_force", "log_force_ratio")
Record = DisplacementRecord | DecelerationRecord
LOG_2 = 0.6931471805599453
_SHAPE_OF_MODEL = [
    *("kind", "locations", "priors", "correlated"),
    *("element", "discrepancy", "headform", "force", "contact", "gain"),
]


class PositiveOfScale(constraints.Constraint):
    """Positive numbers, s log(1 + e^y) of an unconstrained y.

    Attributes:
        scale: s.
    """

    def __init__(self, scale: Any) -> None:
        self.scale = scale

    def __call__(self, x: Any) -> Any:
        """Whether ``x`` is one of them."""
        return x > 0

    def feasible_like(self, prototype: Any) -> Any:
        """One of them, in the prototype's shape."""
        return jnp.broadcast_to(self.scale, jnp.shape(prototype))

    def tree_flatten(self) -> Any:
        """For JAX."""
        return (self.scale,), (("scale",), {})


@biject_to.register(PositiveOfScale)
def _transform(constraint: PositiveOfScale) -> ComposeTransform:
    stretch = AffineTransform(0.0, constraint.scale, domain=constraints.positive)
    return ComposeTransform([SoftplusTransform(), stretch])


class HalfNormalSpread(dist.HalfNormal):
    """A half-normal number whose unconstrained coordinate y gives it as scale log(1 + e^y).

    On the log scale, numpyro's choice, the upper tail falls as exp(-e^{2y} / 2). A chain climbs it in
    steps that multiply every impact's deviation at once, and diverges. As a function of this y that tail is
    a normal's, and the lower one is the same as on the log scale.
    """

    @constraints.dependent_property(is_discrete=False, event_dim=0)
    def support(self) -> PositiveOfScale:
        """The positive numbers."""
        return PositiveOfScale(self.scale)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class TraceData:
    """What the model reads of a dataset, all of it arrays.

    Attributes:
        record: the traces.
        design: of the population.
        location_mean: prior mean of b.
        log_mass: log of the recorded mass in kg.
        log_peak: log of the greatest displacement [m], or deceleration [m/s^2], of the trace: the unit of
            its noise.
    """

    record: Record
    design: PopulationDesign
    location_mean: Float[Array, " location"]
    log_mass: JaxPerImpact
    log_peak: JaxPerImpact

    def impacts(self, rows: Int[np.ndarray, " row"]) -> TraceData:
        """Of some impacts, the population's design included as far as it says X b of each."""
        design = self.design and self.design._replace(cell=np.asarray(self.design.cell)[rows])
        per_impact = (np.asarray(values)[rows] for values in (self.log_mass, self.log_peak))
        return TraceData(self.record.impacts(rows), design, self.location_mean, *per_impact)

    @cached_property
    def padded(self) -> TraceData:
        """As many impacts and samples as a `bucket` holds, whose numbers are to be cut off results again."""
        data = self.impacts(padded_rows(len(self.log_mass)))
        on_device: TraceData = jax.device_put(replace(data, record=data.record.padded()))
        return on_device


class Hierarchy:
    """What every hierarchy has: standard deviations of effects and impacts, and a residual correlation."""

    locations: EffectParts
    priors: Priors
    correlated: bool
    log_mass_sd: float

    @property
    def nuisance(self) -> tuple[str, ...]:
        """Names of an impact's parameters besides log K and log C."""
        return ()

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of an impact's parameters, those of log K and log C first."""
        return (*RESPONSES, *self.nuisance)

    @property
    def hyperparameters(self) -> tuple[str, ...]:
        """Names of the standard deviations and correlations: all that is sampled but standard normals."""
        groups = sorted({name for name in self.locations.spread if name})
        impact_level = ["sd_impact_K", "sd_impact_C"] + ["residual_correlation"] * self.correlated
        return (*groups, *impact_level, *(f"sd_{name}" for name in self.nuisance if name != GAIN))

    def prior_of(self, name: str) -> dist.Distribution:
        """The prior of one of `hyperparameters`."""
        prior = self.priors.by_name()[name]
        return HalfNormalSpread(prior.scale) if isinstance(prior, HalfNormal) else prior.numpyro()

    def covariances(self, hyperparameters: Hyperparameters) -> Covariances:
        """See `covariances_of`."""
        return covariances_of(self.locations, self.spreads(hyperparameters), self.log_mass_sd, self.nuisance)

    def spreads(self, hyperparameters: Hyperparameters) -> Hyperparameters:
        """The hyperparameters, and what is not sampled but known of them."""
        return hyperparameters

    @property
    def own_mass_sd(self) -> float:
        """Standard deviation of the error of log mass that each impact has by itself."""
        return 0.0 if self.locations.of_shared_masses else self.log_mass_sd


@partial(jax.tree_util.register_dataclass, data_fields=["log_mass_sd"], meta_fields=_SHAPE_OF_MODEL)
@dataclass(frozen=True)
class TraceModel(Hierarchy):
    """What is assumed: the likelihood, the parts of b, the priors, and the error of the recorded mass.

    A tree of one leaf, ``log_mass_sd``, which the dataset states; all else is compared by value, so that what
    is compiled for one dataset serves every other of the same model file and sizes.

    Whether impacts share the errors of their masses, ``locations`` says. ``element`` is what the impactor
    meets, ``discrepancy`` whether it meets something else besides, ``headform`` whether what hits stands for
    a head, ``force`` whether a force was recorded beside the deceleration, ``contact`` whether its place in a
    sampling interval is a parameter of each impact, ``gain`` whether one error of the gain is that of all
    impacts.
    """

    kind: Kind
    locations: EffectParts
    priors: Priors
    correlated: bool
    log_mass_sd: float
    element: str = SIDE_BY_SIDE
    discrepancy: bool = False
    headform: bool = False
    force: bool = False
    contact: bool = False
    gain: bool = False

    @property
    def nuisance(self) -> tuple[str, ...]:
        """Names of an impact's parameters besides log K and log C; a discrepancy's or a force's come last."""
        of_noise = ["noise"] + ["atanh_theta1"] * (self.kind == "arma")
        element_logs = [parameter_of(one.name) for one in element_named(self.element).extra]
        of_chain = [CONTACT] * self.contact + [GAIN] * self.gain
        last = ["discrepancy"] * self.discrepancy + [*FORCE] * self.force
        return (*of_noise, *element_logs, *of_chain, *last)

    def named(self, u: list[Array]) -> dict[str, Array]:
        """An impact's parameters by name."""
        return dict(zip(self.parameters, u, strict=True))

    def spreads(self, hyperparameters: Hyperparameters) -> Hyperparameters:
        """The hyperparameters, and the spread of a gain that all impacts share."""
        if not self.gain:
            return hyperparameters
        spread = jnp.full_like(hyperparameters["sd_impact_K"], _GAIN_SPREAD * self.priors.log_gain.sd)
        return hyperparameters | {f"sd_{GAIN}": spread}

    @property
    def depends_on_depth(self) -> bool:
        """Whether force over depth is another at every depth, so that impacts compare at a common one."""
        return self.discrepancy or not element_named(self.element).linear


class Physical(NamedTuple):
    """An impact's parameters as the likelihood takes them, each [impact]."""

    omega_n: Array
    zeta: Array
    theta1: Array | None
    log_sigma: Array


@jax.jit
def physical(model: TraceModel, data: TraceData, u: list[Array]) -> Physical:
    """omega_n = sqrt(K / M), zeta = C / (2 omega_n M), theta1 and the noise.

    For "arma" the noise parameter is log s with s^2 = sigma_a^2 (1 + theta1^2), the variance of
    a_t - theta1 a_{t-1}, which the data tell whatever theta1 is; sigma_a alone would follow theta1.
    """
    omega_n = jnp.exp((u[0] - data.log_mass) / 2)
    zeta = jnp.exp(u[1] - data.log_mass - LOG_2) / omega_n
    log_s = u[2] + data.log_peak
    if model.kind != "arma":
        return Physical(omega_n, zeta, None, log_s)
    theta1 = jnp.tanh(u[3])
    return Physical(omega_n, zeta, theta1, log_s - jnp.log1p(theta1**2) / 2)


def element_parameters(model: TraceModel, u: list[Array]) -> Float[Array, "parameter impact"]:
    """K, C and the element's further parameters."""
    return jnp.exp(jnp.stack([u[index] for index in of_the_element(model)]))


def of_the_element(model: TraceModel) -> list[int]:
    """Which of an impact's parameters are the element's: the noise's come between C and the further."""
    return [model.parameters.index(parameter_of(one.name)) for one in element_named(model.element).parameters]


def added_mass_of(model: TraceModel) -> int | None:
    """Which of an impact's parameters is the log of a mass that moves along; None where none does."""
    which = element_named(model.element)
    if which.added_mass is None:
        return None
    (number,) = (model.parameters.index(parameter_of(one.name)) for one in which.extra if one.of_mass)
    return number


def trace_likelihood(
    model: TraceModel, data: TraceData, u: list[Array]
) -> MeasuredDisplacement | MeasuredImpact:
    """The likelihood of every impact's trace."""
    if model.kind == "impact":
        return impact_likelihood(model, data, u)
    at, record = physical(model, data, u), cast(DisplacementRecord, data.record)
    log_gain = model.named(u).get(GAIN)
    return MeasuredDisplacement(at.omega_n, at.zeta, at.theta1, at.log_sigma, record, log_gain)


def impact_likelihood(model: TraceModel, data: TraceData, u: list[Array]) -> MeasuredImpact:
    """The likelihood of every impact's trace, of recorded decelerations."""
    at, record = model.named(u), cast(DecelerationRecord, data.record)
    size = {name: at[name] + data.log_peak for name in ("noise", "discrepancy", FORCE[0]) if name in at}
    of_force = size.get(FORCE[0]), at.get(FORCE[1])
    noise = NoiseParameters(size["noise"], size.get("discrepancy"), *of_force, at.get(GAIN))
    if model.contact:
        record = record.with_contact_earlier(at[CONTACT])
    return MeasuredImpact(element_named(model.element), element_parameters(model, u), noise, record)


def log_likelihood(model: TraceModel, data: TraceData, u: list[Array]) -> JaxPerImpact:
    """Log density of each trace given its own parameters, the chain's errors integrated out."""
    return trace_likelihood(model, data, u).log_density()


def with_contact_at(data: TraceData, likelihood: MeasuredImpact, first_time: JaxPerImpact) -> TraceData:
    """The same traces with contact known to be so long before the first sample, as the likelihood has it.

    A place of contact that is a parameter moves it from there again.
    """
    record = cast(DecelerationRecord, data.record)
    later = first_time - likelihood.record.first_time
    return replace(data, record=record.at_contact(record.first_time + later))


def with_normal_errors(data: TraceData) -> TraceData:
    """The same traces, every error of the measuring chain taken as normal with its standard deviation."""
    return replace(data, record=data.record.with_normal_errors())


def sample_hyperparameters(model: Hierarchy) -> Hyperparameters:
    """Sample all standard deviations and the correlation from their priors."""
    return {name: numpyro.sample(name, model.prior_of(name)) for name in model.hyperparameters}


def hyperparameters_at(
    model: Hierarchy, y: Float[Array, " hyperparameter"]
) -> tuple[Hyperparameters, Float[Array, ""]]:
    """The hyperparameters, and their log prior density, from unconstrained coordinates."""
    hyperparameters: Hyperparameters = {}
    density = jnp.zeros(())
    # Alike priors in one call: dozens of operations on single numbers take long to compile.
    for prior, names in _grouped(model):
        coordinates = y[jnp.array([model.hyperparameters.index(name) for name in names])]
        transform = biject_to(prior.support)
        values = transform(coordinates)
        density += (prior.log_prob(values) + transform.log_abs_det_jacobian(coordinates, values)).sum()
        hyperparameters |= dict(zip(names, values, strict=True))
    return hyperparameters, density


def _grouped(model: Hierarchy) -> list[tuple[dist.Distribution, list[str]]]:
    """The hyperparameters' priors, all half-normal ones as one of a vector."""
    priors = {name: model.prior_of(name) for name in model.hyperparameters}
    half_normal = [name for name, prior in priors.items() if isinstance(prior, HalfNormalSpread)]
    scales = jnp.array([priors[name].scale for name in half_normal])
    together = [(HalfNormalSpread(scales), half_normal)] if half_normal else []
    return together + [(prior, [name]) for name, prior in priors.items() if name not in half_normal]


def plain_model(model: TraceModel, data: TraceData) -> None:
    """The model from the top down: standard deviations, b, each impact's parameters, its trace."""
    numpyro.factor("trace", log_likelihood(model, data, impacts_model(model, data)).sum())


def impacts_model(model: TraceModel, data: TraceData) -> list[Array]:
    """The same without the traces; returns each impact's parameters."""
    covariances = model.covariances(sample_hyperparameters(model))
    b = numpyro.sample("locations", dist.Normal(data.location_mean, covariances.locations).to_event(1))
    mean_u = expected(data.design, b)
    with numpyro.plate("impacts", data.log_mass.shape[0]):
        # Its check would be compiled in twenty pieces, even within a compiled function.
        pair = dist.MultivariateNormal(mean_u[:2].T, covariances.pair_matrix, validate_args=False)
        logs = numpyro.sample("log_K_and_C", pair)
        nuisance = [
            numpyro.sample(name, dist.Normal(mean, sd))
            for name, mean, sd in zip(model.nuisance, mean_u[2:], covariances.nuisance, strict=True)
        ]
    return [logs[..., 0], logs[..., 1], *nuisance]


def sites_by_cell(data: TraceData, sites: GaussianFactor) -> SitesByCell:
    """What the hierarchy's closed forms ask of the dataset, a site standing for each trace.

    Without each impact's cell, so that what is compiled serves other numbers of impacts.
    """
    design = data.design._replace(cell=np.zeros(0, int))
    by_cell = SitesByCell(design, data.location_mean, data.design.blocked(sites))
    return jax.tree.map(jnp.asarray, by_cell)
