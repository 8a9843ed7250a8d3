"""The analysis of planned studies: their hierarchy, and posteriors of many of them side by side.

Log K and log C of each impact are measured with a known precision: what else a trace tells, such as its
noise, is integrated out of that beforehand (`bayestissue.studies.planning.information`). All that follows is
the hierarchy of a fit: u ~ N(X b, D^-1), with a Gaussian factor of u in the place of each trace.

A study's posterior of the hyperparameters has its mode found by Newton's method, all studies in step, and is
integrated by importance sampling from a multivariate t about it; the effects b are drawn given each point, in
closed form. Points are Sobol's, the same of all studies.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jax import Array
from jaxtyping import Bool, Float
from numpyro.distributions import biject_to
from scipy.special import chdtri, ndtri, softmax
from scipy.stats import qmc

from bayestissue.model.hierarchy import derived
from bayestissue.model.hierarchy.design import Design
from bayestissue.model.hierarchy.gaussian.arrangement import PopulationDesign
from bayestissue.model.hierarchy.gaussian.effects import SitesByCell, effects_from_standard
from bayestissue.model.hierarchy.gaussian.factor import GaussianFactor
from bayestissue.model.hierarchy.levels import design_at
from bayestissue.model.hierarchy.population import EffectParts, heavier, population_design, stated_mass_errors
from bayestissue.model.hierarchy.priors import Priors
from bayestissue.model.hierarchy.responses import RESPONSES
from bayestissue.model.hierarchy.specification import ModelSpecification
from bayestissue.model.hierarchy.trace_models import Hierarchy, hyperparameters_at
from bayestissue.studies.planning.plan_settings import INTEGRATION as SETTINGS


@dataclass(frozen=True)
class PlannedModel(Hierarchy):
    """What the analysis of a planned study assumes.

    Attributes:
        locations: what the elements of b are.
        priors: of the analysis.
        correlated: whether the deviations of log K and log C of one impact are.
        log_mass_sd: standard deviation of the error of the recorded log mass.
        common_mass_sd: standard deviation of the log of a factor that all masses have in common, in the place
            of errors of their own; None where they have those.
    """

    locations: EffectParts
    priors: Priors
    correlated: bool
    log_mass_sd: float
    common_mass_sd: float | None

    def at(self, y: Float[Array, " coordinate"]) -> tuple[dict[str, Array], Float[Array, ""]]:
        """The hyperparameters and their log prior density at unconstrained coordinates."""
        return hyperparameters_at(self, y)

    def unconstrained(self, values: Mapping[str, Any]) -> Float[np.ndarray, "study coordinate"]:
        """Coordinates of `at`, of any number of studies."""
        coordinates = [
            biject_to(self.prior_of(name).support).inv(jnp.asarray(values[name]))
            for name in self.hyperparameters
        ]
        return np.stack([np.asarray(coordinate) for coordinate in coordinates], axis=-1)

    def draws(
        self, design: Design, values: Mapping[str, np.ndarray], b: Float[np.ndarray, "chain draw location"]
    ) -> xr.Dataset:
        """Draws by the names that questions use, those of a typical person among them.

        Args:
            design: whose formulas the model has.
            values: hyperparameters, [chain, draw].
            b: all fixed and group effects.
        """
        design = replace(design, responses={q: design.responses[q] for q in RESPONSES})
        population = dict(values) | derived.effects_by_name(self.locations, design, b)
        draws = derived.labelled_draws(design, derived.formula_quantities(design, population))
        draws = draws.assign_coords(chain=np.arange(b.shape[0]), draw=np.arange(b.shape[1]))
        typical = {q: design_at(design.recorded, q, [{}]).log(draws)[..., 0] for q in RESPONSES}
        with np.errstate(over="ignore"):
            return draws.assign(
                {f"{q}_typical_person": (("chain", "draw"), np.exp(log)) for q, log in typical.items()}
            )


def planned_model(
    specification: ModelSpecification,
    design: Design,
    relative_mass_sd: float = 0.0,
) -> tuple[PlannedModel, PopulationDesign]:
    """The analysis of a study with this design, and its X arranged.

    Args:
        specification: the model file.
        design: its formulas over the rows of the study.
        relative_mass_sd: of the recorded mass.
    """
    priors = specification.complete_priors()
    # The parameters of an element besides K and C are part of a trace's precision.
    responses = {q: design.responses[q] for q in RESPONSES}
    mass_kg = design.recorded.rows["mass_kg"].to_numpy(float)
    individual, common, masses = stated_mass_errors(
        specification.mass_error, relative_mass_sd, design.subject, mass_kg
    )
    effects, columns = population_design(replace(design, responses=responses), priors, (), masses)
    return PlannedModel(effects, priors, specification.residual_correlation, individual, common), columns


@dataclass(frozen=True, eq=False)
class Posteriors:
    """Weighted draws of each study's posterior.

    Attributes:
        hyperparameters: by name.
        b: all fixed and group effects, a factor of all masses put right.
        weight: of each draw; a study's add up to 1.
        effective: how many draws that are equally weighted these are worth, of the points.
        mode: of the hyperparameters' unconstrained coordinates.
    """

    hyperparameters: dict[str, Float[np.ndarray, "study draw"]]
    b: Float[np.ndarray, "study draw location"]
    weight: Float[np.ndarray, "study draw"]
    effective: Float[np.ndarray, " study"]
    mode: Float[np.ndarray, "study coordinate"]


@dataclass(frozen=True, eq=False)
class PlannedSites:
    """What the analysis is given of many studies of one arrangement.

    Attributes:
        model: of the analysis.
        columns: X, arranged.
        precision: of each impact's site.
        centre: of the sites.
        present: the impacts that a study has.
    """

    model: PlannedModel
    columns: PopulationDesign
    precision: Float[np.ndarray, "impact parameter parameter"]
    centre: Float[np.ndarray, "study impact parameter"]
    present: Bool[np.ndarray, "study impact"]


def posteriors(sites: PlannedSites, start: Float[np.ndarray, "study coordinate"]) -> Posteriors:
    """Weighted draws of every study's posterior.

    Args:
        sites: of the studies.
        start: where each mode is looked for: unconstrained, in the order of the model's `hyperparameters`.
    """
    studies, size = start.shape
    points, repeats = SETTINGS.points, SETTINGS.effects
    columns, effects = sites.columns._replace(cell=np.zeros(0, int)), sites.model.locations.size
    # One more number is of the factor that all masses have in common.
    width = effects + (sites.model.common_mass_sd is not None)
    # Of each study points of its own, that what they are wrong by averages out.
    random = np.random.default_rng(11)
    shift, sign = random.uniform(size=(studies, size + 1)), random.choice([-1.0, 1.0], (studies, width))
    standard = ndtri(_sobol(width, points * repeats))
    outcome = _integrated(
        sites.model,
        (columns, sites.model.locations.mean, sites.precision),
        (
            sites.centre,
            sites.present,
            np.clip(start, -SETTINGS.farthest, SETTINGS.farthest),
            _proposal_points(size, points, shift),
            sign[:, :effects],
        ),
        standard[:, :effects].reshape(points, repeats, -1),
    )
    log_weight, values, b, mode = jax.tree.map(np.asarray, outcome)
    weight = softmax(np.where(np.isfinite(log_weight), log_weight, -np.inf), axis=1)
    # Given b it is drawn from its prior.
    of_mass = (sites.model.common_mass_sd or 0.0) * sign[:, -1:] * standard[:, -1]
    return Posteriors(
        {name: np.repeat(array, repeats, axis=1) for name, array in values.items()},
        heavier(sites.model.locations, b.reshape(len(start), points * repeats, -1), of_mass),
        np.repeat(weight / repeats, repeats, axis=1),
        1 / (weight**2).sum(axis=1),
        mode,
    )


def _proposal_points(
    size: int, number: int, shift: Float[np.ndarray, "study coordinate+1"]
) -> Float[np.ndarray, "study point coordinate"]:
    """Points of a multivariate t about 0, of each study shifted otherwise."""
    points = np.clip((_sobol(size + 1, number) + shift[:, None]) % 1, 1e-6, 1 - 1e-6)
    radius = np.sqrt(SETTINGS.tails / chdtri(SETTINGS.tails, points[..., size]))
    return ndtri(points[..., :size]) * radius[..., None]


@lru_cache
def _sobol(size: int, number: int) -> Float[np.ndarray, "point coordinate"]:
    return np.clip(qmc.Sobol(size, seed=5).random(number), 1e-6, 1 - 1e-6)


@partial(jax.jit, static_argnums=0)
def _integrated(
    model: PlannedModel,
    population: tuple[PopulationDesign, Array, Array],
    studies: tuple[Array, Array, Array, Array, Array],
    standard: Float[Array, "point effect location"],
) -> tuple[Array, dict[str, Array], Array, Array]:
    """Of each study: log weights of the points, the hyperparameters, draws of b, and the mode."""
    columns, mean, precision = population

    def of_study(study: tuple[Array, ...]) -> tuple[Array, dict[str, Array], Array, Array]:
        centre, present, start, points, sign = study
        there = present[:, None, None] * precision
        sites = GaussianFactor(centre, jnp.zeros_like(centre), there, jnp.zeros(len(centre)))
        by_cell = SitesByCell(columns, mean, columns.blocked(sites))

        def potential(y: Array) -> Array:
            values, log_prior = model.at(y)
            return -by_cell.integrated(model.covariances(values))[1] - log_prior

        def at(y: Array, standard: Array) -> tuple[Array, dict[str, Array], Array]:
            values, log_prior = model.at(y)
            effects, density = by_cell.integrated(model.covariances(values))
            b = jax.vmap(partial(effects_from_standard, columns, effects, mean))(standard)
            return density + log_prior, values, b

        mode, value, root = _mode(potential, start)
        whitened, log_proposal = _proposed(points, _split(potential, mode, value, root))
        of_points = mode + whitened @ root.T, sign * standard
        log_density, values, b = jax.lax.map(
            lambda point: at(*point), of_points, batch_size=SETTINGS.points_at_once
        )
        return log_density - log_proposal, values, b, mode

    return jax.lax.map(of_study, studies, batch_size=SETTINGS.studies_at_once)


def _proposed(
    points: Float[Array, "point coordinate"], scale: Float[Array, "side coordinate"]
) -> tuple[Float[Array, "point coordinate"], Float[Array, " point"]]:
    """Whitened draws of a mixture of two t about the mode, and their log density up to a constant.

    One has sides as long as the density's, of which ``scale`` says how much longer than a normal's they are
    along each axis. Every fourth draw is of a wide one, which bounds the weights where the density is longer
    than it looks from its mode.
    """
    size, tails, share = points.shape[1], SETTINGS.tails, 1 / SETTINGS.wide_every
    of_wide = jnp.arange(len(points)) % SETTINGS.wide_every == 0
    of_sides, wide = jnp.where(points > 0, scale[0], scale[1]), jnp.full(size, SETTINGS.wide)
    whitened = points * jnp.where(of_wide[:, None], wide, of_sides)

    def t(scale: Array) -> Array:
        squares = ((whitened / scale) ** 2).sum(-1)
        return -(tails + size) / 2 * jnp.log1p(squares / tails) - jnp.log(scale).sum(-1)

    # A draw is on the side of its point.
    return whitened, jnp.logaddexp(jnp.log1p(-share) + t(of_sides), t(wide) + jnp.log(share))


def _mode(
    potential: Callable[[Array], Array], start: Float[Array, " coordinate"]
) -> tuple[Float[Array, " coordinate"], Float[Array, ""], Float[Array, "coordinate coordinate"]]:
    """Where a function is least, its value, and a root of the inverse of its curvature there.

    Newton's method on differences of slopes, damped as Levenberg and Marquardt have it.
    """
    size, one = len(start), jnp.eye(len(start))
    steps = jnp.concatenate([jnp.zeros((1, size)), SETTINGS.step * one])

    def round_of(state: Any) -> Any:
        number, y, value, slope, curvature, damping, trial, _ = state
        values, slopes = jax.vmap(jax.value_and_grad(potential))(trial + steps)
        better = values[0] <= value
        matrix = (slopes[1:] - slopes[0]) / SETTINGS.step
        y, value = jnp.where(better, trial, y), jnp.where(better, values[0], value)
        slope = jnp.where(better, slopes[0], slope)
        # Positive in every direction.
        curved, axes = jnp.linalg.eigh((matrix + matrix.T) / 2)
        positive = (axes * jnp.maximum(curved, SETTINGS.least_curved)) @ axes.T
        curvature = jnp.where(better, positive, curvature)
        damping = jnp.where(better, damping / 10, 10 * damping + 1.0)
        step = -jnp.linalg.solve(curvature + damping * one, slope)
        promised = -(step * slope).sum() / 2
        step *= jnp.minimum(1.0, SETTINGS.longest / jnp.maximum(jnp.abs(step).max(), 1e-9))
        return number + 1, y, value, slope, curvature, damping, y + step, promised

    infinite = jnp.array(jnp.inf)
    begin = (jnp.array(0), start, infinite, jnp.zeros(size), one, jnp.array(0.0), start, infinite)
    _, mode, value, _, curvature, *_ = jax.lax.while_loop(
        lambda state: (state[0] < SETTINGS.rounds) & (state[-1] > SETTINGS.enough), round_of, begin
    )
    # Not of eigenvectors, whose signs and order jump between studies that are nearly alike.
    return mode, value, jnp.linalg.cholesky(jnp.linalg.inv(curvature))


def _split(
    potential: Callable[[Array], Array], mode: Array, value: Array, root: Array
) -> Float[Array, "side coordinate"]:
    """How much longer than a normal's the density's two sides are along each axis (Geweke 1989)."""
    sides, far = jnp.stack([root.T, -root.T]), jnp.array(SETTINGS.looked_at)[:, None, None]
    points = mode + far[..., None] * sides
    risen = jax.vmap(potential)(points.reshape(-1, len(mode))).reshape(points.shape[:-1]) - value
    longer = (far / jnp.sqrt(2 * jnp.maximum(risen, 1e-6))).max(0)
    return jnp.clip(jnp.nan_to_num(longer, nan=1.0), 1 / SETTINGS.most_split, SETTINGS.most_split)
