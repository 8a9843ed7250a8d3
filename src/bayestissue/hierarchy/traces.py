"""The hierarchy over recorded traces: every impact's likelihood under one population of people and trials.

Written twice. `plain_model` says what is believed, top down. `sampled_model` is the same density in
coordinates made for sampling: b and every impact's parameters are affine maps of standard normals, made by
`bayestissue.hierarchy.gaussian.conditional` to undo whatever the data and the standard deviations correlate.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Literal, NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np
import numpyro
import numpyro.distributions as dist
from jax import Array
from jaxtyping import Bool, Float, Int
from numpyro.distributions import biject_to

from bayestissue.elements import element as element_named
from bayestissue.hierarchy import SIDE_BY_SIDE
from bayestissue.hierarchy.effects import intercept
from bayestissue.hierarchy.gaussian.arrangement import PopulationDesign, expected
from bayestissue.hierarchy.gaussian.conditional import Data
from bayestissue.hierarchy.gaussian.covariances import Covariances
from bayestissue.hierarchy.gaussian.effects import effects_from_standard, integrate_effects
from bayestissue.hierarchy.gaussian.factor import Conditional, GaussianFactor
from bayestissue.hierarchy.half_normal import HalfNormalSpread
from bayestissue.hierarchy.population import Effects, MassError, covariances_of, of_impacts
from bayestissue.hierarchy.priors import HalfNormal, Priors
from bayestissue.hierarchy.warp import SinhArcsinh
from bayestissue.likelihood.arma.displacement import DisplacementRecord, MeasuredDisplacement
from bayestissue.likelihood.element.impact import MeasuredImpact, NoiseParameters
from bayestissue.likelihood.element.record import DecelerationRecord
from bayestissue.padding import padded_rows

Kind = Literal["arma", "a2", "impact"]
NUISANCE: dict[str, tuple[str, ...]] = {
    "arma": ("noise", "atanh_theta1"),
    "a2": ("noise",),
    "impact": ("noise",),
}
Record = DisplacementRecord | DecelerationRecord
LOG_2 = 0.6931471805599453
# The site that holds the coordinates of all hyperparameters where they are warped.
COORDINATES = "coordinates"
_SHAPE_OF_MODEL = [
    *("kind", "locations", "priors", "correlated"),
    *("mass_error", "element", "discrepancy", "autoregressive"),
]


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
    log_mass: Float[Array, " impact"]
    log_peak: Float[Array, " impact"]

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


class Hyperparameters:
    """What every hierarchy has: standard deviations of effects and impacts, and a residual correlation."""

    locations: Effects
    priors: Priors
    correlated: bool

    @property
    def nuisance(self) -> tuple[str, ...]:
        """Names of an impact's parameters besides log K and log C."""
        return ()

    @property
    def hyperparameters(self) -> tuple[str, ...]:
        """Names of the standard deviations and correlations: all that is sampled but standard normals."""
        groups = sorted({name for name in self.locations.spread if name})
        impact_level = ["sd_impact_K", "sd_impact_C"] + ["residual_correlation"] * self.correlated
        return (*groups, *impact_level, *(f"sd_{name}" for name in self.nuisance))

    def prior_of(self, name: str) -> dist.Distribution:
        """The prior of one of `hyperparameters`."""
        prior = self.priors.by_name()[name]
        return HalfNormalSpread(prior.scale) if isinstance(prior, HalfNormal) else prior.numpyro()


@partial(jax.tree_util.register_dataclass, data_fields=["log_mass_sd"], meta_fields=_SHAPE_OF_MODEL)
@dataclass(frozen=True)
class TraceModel(Hyperparameters):
    """What is assumed: the likelihood, the parts of b, the priors, and the error of the recorded mass.

    A tree of one leaf, ``log_mass_sd``, which the dataset states; all else is compared by value, so that what
    is compiled for one dataset serves every other of the same model file and sizes.

    ``mass_error`` says whether each impact has an error of its own, or all impacts of a person the same,
    ``element`` what the impactor meets, ``discrepancy`` whether it meets something else besides,
    ``autoregressive`` whether the recorder's noise is that instead of white.
    """

    kind: Kind
    locations: Effects
    priors: Priors
    correlated: bool
    log_mass_sd: float
    mass_error: MassError = "impact"
    element: str = SIDE_BY_SIDE
    discrepancy: bool = False
    autoregressive: bool = False

    @property
    def nuisance(self) -> tuple[str, ...]:
        """Names of an impact's parameters besides log K and log C."""
        noise_model = {"discrepancy": self.discrepancy, "autoregressive": self.autoregressive}
        return nuisance_of(self.kind, self.element, **noise_model)

    @property
    def weakly_identified(self) -> bool:
        """Whether traces may leave an impact's last parameter open on one side.

        They do so of a theta1 near -1, and of an element's further parameter where the tissue is as good as
        a spring and damper side by side: no finite value of it is then needed.
        """
        extra = [f"log_{parameter.name}" for parameter in element_named(self.element).extra]
        return self.nuisance[-1] in {"atanh_theta1", *extra}

    @property
    def depends_on_depth(self) -> bool:
        """Whether force over depth is another at every depth, so that impacts compare at a common one."""
        return self.discrepancy or not element_named(self.element).linear

    @property
    def may_have_grid(self) -> bool:
        """Whether a grid may stand for what traces say of that parameter: one that has no formula of its own.

        All impacts then share its mean, the last element of b, which is sampled beside the hyperparameters.
        Effects of people and covariates on it are integrated out in closed form, which takes a Gaussian site.
        """
        return self.weakly_identified and self.locations.blocks[-1].name == intercept(self.nuisance[-1])


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
    a_t - theta1 a_{t-1}, which the data tell whatever theta1 is; sigma_a alone would follow theta1. For
    autoregressive noise it is that of its shocks: see `bayestissue.likelihood.element.noise`.
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
    further = len(element_named(model.element).extra)
    return jnp.exp(jnp.stack([u[0], u[1], *u[3 : 3 + further]]))


def nuisance_of(
    kind: Kind, element: str, *, discrepancy: bool = False, autoregressive: bool = False
) -> tuple[str, ...]:
    """Names of an impact's parameters besides log K and log C, a discrepancy's or a correlation's last.

    Without these two an element's further parameter is the last: see `TraceModel.weakly_identified`.
    """
    which = element_named(element)
    element_logs = [f"log_{parameter.name}" for parameter in which.extra]
    last = ["discrepancy"] * discrepancy + ["atanh_noise_correlation"] * autoregressive
    return (*NUISANCE[kind], *element_logs, *last)


def trace_likelihood(
    model: TraceModel, data: TraceData, u: list[Array]
) -> MeasuredDisplacement | MeasuredImpact:
    """The likelihood of every impact's trace."""
    if model.kind == "impact":
        return impact_likelihood(model, data, u)
    at, record = physical(model, data, u), cast(DisplacementRecord, data.record)
    return MeasuredDisplacement(at.omega_n, at.zeta, at.theta1, at.log_sigma, record)


def impact_likelihood(model: TraceModel, data: TraceData, u: list[Array]) -> MeasuredImpact:
    """The likelihood of every impact's trace, of recorded decelerations."""
    log_discrepancy = u[-1] + data.log_peak if model.discrepancy else None
    atanh_correlation = u[-1] if model.autoregressive else None
    noise = NoiseParameters(physical(model, data, u).log_sigma, log_discrepancy, atanh_correlation)
    record = cast(DecelerationRecord, data.record)
    return MeasuredImpact(element_named(model.element), element_parameters(model, u), noise, record)


def log_likelihood(model: TraceModel, data: TraceData, u: list[Array]) -> Float[Array, " impact"]:
    """Log density of each trace given its own parameters, the chain's errors integrated out."""
    return trace_likelihood(model, data, u).log_density()


def with_normal_errors(data: TraceData) -> TraceData:
    """The same traces, every error of the measuring chain taken as normal with its standard deviation."""
    return replace(data, record=data.record.with_normal_errors())


def sample_hyperparameters(model: Hyperparameters) -> dict[str, Array]:
    """Sample all standard deviations and the correlation from their priors."""
    return {name: numpyro.sample(name, model.prior_of(name)) for name in model.hyperparameters}


def sample_warped(
    model: Hyperparameters, warp: SinhArcsinh
) -> tuple[dict[str, Array], Float[Array, " rest"]]:
    """The same on coordinates of one site, `COORDINATES`, in which the posterior is nearly normal.

    ``warp`` maps them to the unconstrained ones in the order of `TraceModel.hyperparameters`, and to any
    others that the caller has a density for: those are returned as well.
    """
    anything = dist.ImproperUniform(dist.constraints.real_vector, (), warp.location.shape)
    y = numpyro.sample(COORDINATES, anything)
    raw = warp(y)
    count = len(model.hyperparameters)
    sites, density = hyperparameters_at(model, raw[:count])
    numpyro.factor("hyperparameters", density + jnp.log(warp.slope(y)).sum())
    return sites, raw[count:]


def hyperparameters_at(
    model: Hyperparameters, raw: Float[Array, " hyperparameter"]
) -> tuple[dict[str, Array], Float[Array, ""]]:
    """All standard deviations and the correlation, and the log prior density of unconstrained coordinates."""
    sites: dict[str, Array] = {}
    density = jnp.zeros(())
    # Alike priors in one call: dozens of operations on single numbers take long to compile.
    for prior, names in _grouped(model):
        values = raw[jnp.array([model.hyperparameters.index(name) for name in names])]
        transform = biject_to(prior.support)
        constrained_values = transform(values)
        density += (
            prior.log_prob(constrained_values) + transform.log_abs_det_jacobian(values, constrained_values)
        ).sum()
        sites |= dict(zip(names, constrained_values, strict=True))
    return sites, density


def _grouped(model: Hyperparameters) -> list[tuple[dist.Distribution, list[str]]]:
    """The hyperparameters' priors, all half-normal ones as one of a vector."""
    priors = {name: model.prior_of(name) for name in model.hyperparameters}
    half_normal = [name for name, prior in priors.items() if isinstance(prior, HalfNormalSpread)]
    scales = jnp.array([priors[name].scale for name in half_normal])
    together = [(HalfNormalSpread(scales), half_normal)] if half_normal else []
    return together + [(prior, [name]) for name, prior in priors.items() if name not in half_normal]


def constrained(model: Hyperparameters, raw: Mapping[str, Array]) -> dict[str, Array]:
    """The standard deviations and the correlation from their unconstrained coordinates, of any shape."""
    return {name: biject_to(model.prior_of(name).support)(raw[name]) for name in model.hyperparameters}


def population(model: TraceModel, sites: dict[str, Array]) -> Covariances:
    """See `covariances_of`."""
    return covariances_of(model.locations, sites, model.log_mass_sd, model.nuisance, model.mass_error)


def plain_model(model: TraceModel, data: TraceData, *, conditioned: bool = True) -> None:
    """The model from the top down: standard deviations, b, each impact's parameters, its trace."""
    likelihood = trace_likelihood(model, data, impacts_model(model, data))
    if conditioned:
        numpyro.factor("trace", likelihood.log_density().sum())
    else:
        numpyro.deterministic("trace", likelihood.sample(numpyro.prng_key()))


def impacts_model(model: TraceModel, data: TraceData) -> list[Array]:
    """The same without the traces; returns each impact's parameters."""
    covariances = population(model, sample_hyperparameters(model))
    b = numpyro.sample("locations", dist.Normal(data.location_mean, covariances.locations).to_event(1))
    mean_u = expected(data.design, b)
    if covariances.shared is not None:
        # K of a heavier person than recorded looks smaller, by as much in every impact.
        person = dist.Normal(0.0, model.log_mass_sd).expand([len(covariances.shared.effect_on_K)]).to_event(1)
        error = of_impacts(data.design, covariances, numpyro.sample("log_mass_error", person))
        mean_u = mean_u.at[:2].add(-error)
    with numpyro.plate("impacts", data.log_mass.shape[0]):
        # Its check would be compiled in twenty pieces, even within a compiled function.
        pair = dist.MultivariateNormal(mean_u[:2].T, covariances.pair_matrix, validate_args=False)
        logs = numpyro.sample("log_K_and_C", pair)
        nuisance = [
            numpyro.sample(name, dist.Normal(mean, sd))
            for name, mean, sd in zip(model.nuisance, mean_u[2:], covariances.nuisance, strict=True)
        ]
    return [logs[..., 0], logs[..., 1], *nuisance]


def sampled_model(
    model: TraceModel,
    data: TraceData,
    sites: GaussianFactor,
    warp: SinhArcsinh | None = None,
    present: Bool[Array, " impact"] | None = None,
) -> None:
    """The same density over standard normals; `from_standard` gives b and u back.

    The factor is log p(b, u) + log |d(b, u) / d(standard normals)| less the standard normals' own density.
    ``warp`` is the map from the coordinates that are sampled to the hyperparameters' unconstrained ones, and
    to the last location's standard normal if that is far from normal in the posterior: see `sample_warped`.
    Of the traces those that are not ``present`` are left out, whose sites must be zero.
    """
    count = len(model.hyperparameters)
    sampled = (
        sample_hyperparameters(model) if warp is None else sample_warped(model, warp.part(slice(count)))[0]
    )
    number, size = sites.centre.shape
    z_b = numpyro.sample("standard_locations", _standard(model.locations.size))
    z_u = numpyro.sample("standard_impacts", _standard(number, size))
    if warp is not None and warp.location.shape[0] > count:
        y, z_b = z_b[-1], warped(z_b, warp)
        numpyro.factor("warp", jnp.log(warp.part(-1).slope(y)) + (y**2 - z_b[-1] ** 2) / 2)
    draw = from_standard(model, data, sites, sampled, z_b, z_u)
    density = draw.log_marginal - sites.log_density(jnp.stack(draw.u, axis=-1)).sum()
    numpyro.factor("change_of_variables", density)
    u = draw.u
    if present is not None:
        # Slopes of what is left out must be numbers too.
        u = [jnp.where(present, values, values[:1]) for values in u]
    of_traces = log_likelihood(model, data, u)
    numpyro.factor("traces", (of_traces if present is None else jnp.where(present, of_traces, 0.0)).sum())


def warped(z_b: Float[Array, "*batch location"], warp: SinhArcsinh) -> Float[Array, "*batch location"]:
    """The locations' standard normals with the last one warped by the last part of ``warp``."""
    return z_b.at[..., -1].set(warp.part(-1)(z_b[..., -1]))


def _standard(*shape: int) -> dist.Distribution:
    return dist.Normal().expand(list(shape)).to_event(len(shape))


def gaussian(data: TraceData, sites: GaussianFactor) -> Data:
    """What the hierarchy's closed forms ask of the dataset, a site standing for each trace."""
    return Data.from_sites(data.design, data.location_mean, sites)


class Drawn(NamedTuple):
    """b, each impact's parameters and their expectation X b, from standard normals."""

    b: Array
    u: list[Array]
    prior_mean: Array
    log_marginal: Array


def from_standard(
    model: TraceModel,
    data: TraceData,
    sites: GaussianFactor,
    sampled: dict[str, Array],
    z_b: Float[Array, " location"],
    z_u: Float[Array, "impact parameter"],
) -> Drawn:
    """The conditionals' affine maps, the standard deviations given, and the sites' `log_marginal`."""
    covariances = population(model, sampled)
    sums = gaussian(data, sites).sums(covariances)
    effects, log_marginal = integrate_effects(data.design, covariances, sums)
    b = effects_from_standard(data.design, effects, data.location_mean, z_b)
    prior_mean = expected(data.design, b)
    conditional = Conditional(covariances.of_impact(), sites.batch_last())
    return Drawn(b, list(conditional.draw(prior_mean, z_u.T)), prior_mean, log_marginal)
