"""Prior distributions as they are written in a model file."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Annotated, Any, ClassVar, Literal

from pydantic import ConfigDict, Field

from bayestissue.base.settings import TomlTable
from bayestissue.model.hierarchy.formulas.group_terms import GroupTerm

Positive = Annotated[float, Field(gt=0)]


class _Prior(TomlTable):
    _words: ClassVar[str]

    def numpyro(self) -> Any:
        """The same distribution as a `numpyro.distributions.Distribution` of one number."""
        import numpyro.distributions as dist

        match self:
            case Normal(mean=mean, sd=sd):
                return dist.Normal(mean, sd)
            case HalfNormal(scale=scale):
                return dist.HalfNormal(scale)
            case HalfStudentT(df=df, scale=scale):
                return dist.FoldedDistribution(dist.StudentT(df, 0.0, scale))
            case Correlation(concentration=concentration):
                # For two variables LKJ is this beta distribution stretched over (−1, 1).
                beta = dist.Beta(concentration, concentration)
                stretch = dist.transforms.AffineTransform(-1.0, 2.0, domain=dist.constraints.unit_interval)
                return dist.TransformedDistribution(beta, stretch)

    def words(self) -> str:
        """The distribution in words, for the report."""
        return self._words.format(**self.model_dump())


class Normal(_Prior):
    """``{ distribution = "normal", mean = 0.5, sd = 1.0 }``: any real number."""

    _words = "normal, mean {mean:g}, standard deviation {sd:g}"
    distribution: Literal["normal"]
    mean: float
    sd: Positive


class HalfNormal(_Prior):
    """``{ distribution = "half-normal", scale = 0.5 }``: a number above zero."""

    _words = "half-normal, scale {scale:g}"
    distribution: Literal["half-normal"]
    scale: Positive


class HalfStudentT(_Prior):
    """``{ distribution = "half-student-t", df = 3, scale = 0.5 }``: above zero, with a long tail."""

    _words = "half-Student-t, {df:g} degrees of freedom, scale {scale:g}"
    distribution: Literal["half-student-t"]
    df: Positive
    scale: Positive


class Correlation(_Prior):
    """``{ distribution = "lkj", concentration = 2 }``: a correlation r, density ∝ (1 − r²)^(2 − 1)."""

    _words = "LKJ, concentration {concentration:g}"
    distribution: Literal["lkj"]
    concentration: Positive


Scale = Annotated[HalfNormal | HalfStudentT, Field(discriminator="distribution")]


class Pair[Prior](TomlTable):
    """One prior for log K and one for log C."""

    K: Prior
    C: Prior


class Responses[Prior](Pair[Prior]):
    """The same, and one for the log of each further parameter that has a formula of its own."""

    model_config = ConfigDict(extra="allow", frozen=True)
    __pydantic_extra__: dict[str, Prior] = Field(init=False)


# Named in the module, where pickle looks for them.
PairOfLocations = Pair[Normal]
PairOfScales = Pair[Scale]
Locations = Responses[Normal]
Scales = Responses[Scale]


def normal(mean: float, sd: float) -> Normal:
    """The normal prior."""
    return Normal(distribution="normal", mean=mean, sd=sd)


def half_normal(scale: float) -> HalfNormal:
    """The half-normal prior of this scale."""
    return HalfNormal(distribution="half-normal", scale=scale)


class ElementPrior(TomlTable):
    """Of one parameter of a mechanical element besides K and C, on the log scale.

    ``log`` is the mean over impacts of its log, ``spread`` the standard deviation between impacts.

    Attributes:
        log: mean over impacts of the log of the parameter.
        spread: standard deviation of that log between impacts.
    """

    log: Normal
    spread: Scale = half_normal(0.2)


# Of a group term for which a model file says nothing.
SD_OF_TERM = Scales(K=half_normal(0.5), C=half_normal(0.5))
# Of further parameters' effects, for which a model file says nothing.
_OF_FURTHER: dict[str, _Prior] = {
    "mass_exponent": normal(0.0, 1.0),
    "covariate": normal(0.0, 0.5),
    "sd_subject": half_normal(0.5),
    "sd_trial": half_normal(0.5),
}


def term_of_group(key: str) -> GroupTerm:
    """The term that a key of ``sd_group`` is of: ``"subject:side"``."""
    return GroupTerm(tuple(name.strip().strip("`") for name in key.split(":")))


def term_of_slope(key: str) -> GroupTerm:
    """The term that a key of ``sd_slope`` is of: ``"log(mass_kg)|subject"``."""
    slope, _, grouping = key.rpartition("|")
    return GroupTerm(term_of_group(grouping).factors, slope.strip())


class Priors(TomlTable):
    """Every prior of the hierarchy; each has a default that a model file may replace.

    All are on the log scale of K (N/m) and C (N s/m).

    Attributes:
        intercept: log K (K in N/m) and log C (C in N s/m) at the reference mass.
        mass_exponent: slopes of log K and log C on log mass.
        covariate: change of log K and log C for one standard deviation of any other covariate.
        sd_subject: standard deviation between people.
        sd_trial: standard deviation between conditions beyond what the covariates explain.
        sd_group: standard deviation between the levels of another group term, by its name, such as
            "subject:side".
        sd_slope: standard deviation of a slope between levels, by its name, such as "log(mass_kg)|subject":
            of the mass exponent, or of the change for one standard deviation of another covariate.
        sd_impact: standard deviation between the impacts of one person in one condition.
        residual_correlation: correlation of the deviations of log K and log C of one impact.
        noise: mean over impacts of the log of the noise's standard deviation as a fraction of the trace's
            peak.
        sd_noise: standard deviation between impacts of the log noise.
        atanh_theta1: mean over impacts of artanh theta1, the moving-average coefficient. Of the likelihood
            arma.
        sd_atanh_theta1: standard deviation between impacts of artanh theta1.
        contact: mean over impacts of f, where recordings leave open at which place of a sampling interval
            contact is: (1/2 + f) intervals before the first sample in contact.
        sd_contact: standard deviation between impacts of that.
        log_gain: mean over impacts of the log of recorded over true deceleration, where one error of the gain
            is that of all impacts, from which each differs by a tenth of its deviation. Left out: about 0,
            with the standard deviation that the dataset declares.
        discrepancy: mean over impacts of the log of the rms of the force beside the element's, as a fraction
            of the trace's peak.
        sd_discrepancy: standard deviation between impacts of that.
        noise_force: mean over impacts of the log of the standard deviation of a force's noise, over mass, as
            a fraction of the deceleration's peak. Of a dataset with a force beside the deceleration, as the
            next three.
        sd_noise_force: standard deviation between impacts of that.
        log_force_ratio: mean over impacts of the log of force over mass times deceleration, the errors of all
            masses and of both gains together; what the dataset declares of these divides it.
        sd_log_force_ratio: standard deviation between impacts of that.
        element: the further parameters of a mechanical element, by name: log, the mean over impacts of a
            parameter's log, and spread, the standard deviation between impacts. A parameter with a formula of
            its own is in mass_exponent, covariate and sd_* too, but for sd_impact.
    """

    def __hash__(self) -> int:
        # That of pydantic would ask the mapping of elements for one.
        return hash(self.model_dump_json())

    intercept: PairOfLocations = PairOfLocations(K=normal(5.0, 3.0), C=normal(2.0, 3.0))
    mass_exponent: Locations = Locations(K=normal(0.5, 1.0), C=normal(0.5, 1.0))
    covariate: Locations = Locations(K=normal(0.0, 0.5), C=normal(0.0, 0.5))
    sd_subject: Scales = Scales(K=half_normal(0.5), C=half_normal(0.5))
    sd_trial: Scales = Scales(K=half_normal(0.5), C=half_normal(0.5))
    sd_group: dict[str, Scales] = Field(default_factory=dict)
    sd_slope: dict[str, Scales] = Field(default_factory=dict)
    sd_impact: PairOfScales = PairOfScales(K=half_normal(0.5), C=half_normal(1.0))
    residual_correlation: Correlation = Correlation(distribution="lkj", concentration=2.0)
    noise: Normal = normal(-10.0, 5.0)
    sd_noise: Scale = half_normal(1.0)
    atanh_theta1: Normal = normal(0.0, 1.5)
    sd_atanh_theta1: Scale = half_normal(0.5)
    contact: Normal = normal(0.0, 0.5)
    sd_contact: Scale = half_normal(0.3)
    log_gain: Normal = normal(0.0, 0.01)
    discrepancy: Normal = normal(-4.0, 2.0)
    sd_discrepancy: Scale = half_normal(1.0)
    noise_force: Normal = normal(-10.0, 5.0)
    sd_noise_force: Scale = half_normal(1.0)
    log_force_ratio: Normal = normal(0.0, 0.3)
    sd_log_force_ratio: Scale = half_normal(0.03)
    element: dict[str, ElementPrior] = Field(default_factory=dict)

    def further(self) -> tuple[str, ...]:
        """The keys of priors of further parameters' effects: ``priors.sd_subject.thickness_m``."""
        pairs = {name: getattr(self, name) for name in _OF_FURTHER}
        for name in ("sd_group", "sd_slope"):
            pairs |= {f'{name}."{key}"': pair for key, pair in getattr(self, name).items()}
        extras = ((name, pair.__pydantic_extra__) for name, pair in pairs.items())
        return tuple(f"priors.{name}.{key}" for name, further in extras for key in further)

    def by_name(self) -> dict[str, _Prior]:
        """Of every top-level parameter, by its name: ``intercept_K``, ``sd_subject_side_C``, ``sd_noise``."""
        pairs = {name: prior for name, prior in self if isinstance(prior, Pair)}
        pairs |= {f"sd_{term.stem}": pair for term, pair in self.of_terms().items()}
        priors = {f"{stem}_{response}": prior for stem, pair in pairs.items() for response, prior in pair}
        for name, prior in self.element.items():
            priors |= {f"log_{name}_mean": prior.log, f"sd_log_{name}": prior.spread}
        alone = {name: prior for name, prior in self if isinstance(prior, _Prior)}
        return priors | {f"{n}_mean" if isinstance(p, Normal) else n: p for n, p in alone.items()}

    def with_further(self, names: Iterable[str]) -> Priors:
        """The same with priors of the effects on further parameters, where the file gives none."""

        def filled(pair: Locations | Scales, default: _Prior) -> TomlTable:
            return pair.model_copy(update=dict.fromkeys(names, default) | pair.__pydantic_extra__)

        update: dict[str, Any] = {
            name: filled(getattr(self, name), default) for name, default in _OF_FURTHER.items()
        }
        for name in ("sd_group", "sd_slope"):
            pairs = getattr(self, name).items()
            update[name] = {key: filled(pair, half_normal(0.5)) for key, pair in pairs}
        return self.model_copy(update=update)

    def of_terms(self) -> dict[GroupTerm, Scales]:
        """The priors of ``sd_group`` and ``sd_slope`` by the term that each is of."""
        groups = {term_of_group(key): pair for key, pair in self.sd_group.items()}
        return groups | {term_of_slope(key): pair for key, pair in self.sd_slope.items()}

    def log_densities(self, population: Mapping[str, Any]) -> dict[str, Any]:
        """Log prior density of each top-level parameter among these hyperparameters and effects, elementwise.

        Subject and trial effects are not among them: their distribution is part of the model, and scaling
        a prior asks what the priors of its parameters do.
        """
        priors = self.by_name()
        known = {name: value for name, value in population.items() if name in priors}
        return {name: priors[name].numpyro().log_prob(value) for name, value in known.items()}
