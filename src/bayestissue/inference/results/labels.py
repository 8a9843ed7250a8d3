"""Names, units and dimensions of posterior quantities, put on arrays at the edge."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from functools import partial
from types import MappingProxyType
from typing import Any

import numpy as np
import xarray as xr

from bayestissue.elements import element, element_names
from bayestissue.elements.element import GRAVITY
from bayestissue.hierarchy.derived import effect_dimensions
from bayestissue.hierarchy.design import Design
from bayestissue.hierarchy.effects import intercept, parameter_of
from bayestissue.hierarchy.formulas.group_terms import MASS_TERM, stem_of
from bayestissue.inference.quantities.elements import element_attributes
from bayestissue.inference.results.meanings import meaning
from bayestissue.inference.samplers.sampling import Draws

STIFFNESS, DAMPING = "N/m", "N s/m"
_UNITS = {"K": STIFFNESS, "C": DAMPING}
_MEANINGS = {
    "{q}_observed": "published {name} of the impact",
    "{q}_average": "published average of {name} over the people of a condition",
    "{q}_sd": "published standard deviation of {name} over the people of a condition",
    "linear_intercept_{q}": "constant of the straight line of the conditions' mean {name} against mass",
}
_NAMES = {"K": "stiffness K", "C": "damping C"}
_OF = ("cell", "subject", "trial", "new", "typical_person")
_ONE_COLUMN = ("subject", "trial")

_TRACE_ATTRIBUTES = {
    name: {"unit": unit, "long_name": meaning}
    for name, unit, meaning in (
        ("omega_n", "rad/s", "natural frequency of the impact"),
        ("zeta", "1", "damping ratio of the impact"),
        ("theta1", "1", "moving-average coefficient of the displacement"),
        ("sigma_a", "m", "standard deviation of the shocks"),
        ("sigma_d", "m/s^2", "standard deviation of the accelerometer's noise"),
        ("mass", "kg", "mass of the impactor"),
        ("noise_mean", "1", "mean over impacts of the log of the noise relative to the trace's peak"),
        ("sd_noise", "1", "standard deviation between impacts of the log noise"),
        ("atanh_theta1_mean", "1", "mean over impacts of artanh theta1"),
        ("sd_atanh_theta1", "1", "standard deviation between impacts of artanh theta1"),
        ("displacement", "m", "displacement into the tissue"),
        ("deceleration", "m/s^2", "deceleration of the impactor"),
        ("time", "s", "time since contact"),
        ("trace", "1", "log density of the impact's trace, its own parameters integrated out"),
        ("traces", "1", "log density of all traces, the impacts' own parameters integrated out"),
        ("traces_of_subject", "1", "log density of a subject's traces, the subject's effects integrated out"),
        ("traces_of_trial", "1", "log density of a trial's traces, the trial's effects integrated out"),
        ("level_error", "m", "error of the displacement at contact"),
        ("ramp_error", "m/s", "error of the displacement's slope: of velocity and gain"),
        ("velocity_error", "m/s", "error of velocity and gain, as a velocity"),
        ("gain_error", "1", "relative error of the recorder's sensitivity"),
        ("gain_error_sd", "1", "standard deviation of the relative error of the recorder's sensitivity"),
        ("offset_error", "m/s^2", "error of the recorder's zero"),
        ("contact_time_error", "s", "error of the contact time"),
        ("level_error_sd", "m", "standard deviation of the error of the displacement at contact"),
        ("ramp_error_sd", "m/s", "standard deviation of the error of the displacement's slope"),
        ("velocity_error_sd", "m/s", "standard deviation of the error of velocity and gain"),
        ("offset_error_sd", "m/s^2", "standard deviation of the error of the recorder's zero"),
        ("contact_time_error_sd", "s", "standard deviation of the error of the contact time"),
        ("mass_kg", "kg", "recorded mass"),
        ("velocity_m_s", "m/s", "recorded velocity at contact"),
        ("common_depth_m", "m", "depth that every impact reaches, that of K_common_depth"),
        (GRAVITY, "m/s^2", "gravity along the motion, where there is any: decelerations are force over mass"),
        ("n_samples", "1", "samples in the window"),
        ("sampling_interval_s", "s", "sampling interval"),
        ("first_sample_s", "s", "time from contact to the first sample"),
    )
}

# Of posterior.nc: what each group holds, and the variables that are in it alone; others are in the posterior.
GROUPS: dict[str, tuple[str, tuple[str, ...]]] = {
    "posterior": ("draws of every unknown, and of what follows from them", ()),
    "prior": ("the same before the data are seen; of traces", ()),
    "sample_stats": ("what the sampler tells of every draw, by ArviZ's names", ()),
    "log_prior": ("log prior density of each parameter of the population", ()),
    "log_likelihood": ("log density of what was observed, by impact", ("trace",)),
    "log_likelihood_of_groups": (
        "log density of the traces of a level of each group",
        ("traces", "traces_of_subject", "traces_of_trial"),
    ),
    "posterior_predictive": ("traces that the model makes after it saw the data", ()),
    "prior_predictive": ("traces that the model makes before it saw them", ()),
    "observed_data": ("what was observed, as the model sees it", ("displacement", "deceleration")),
    "constant_data": (
        "what is known of each impact",
        (
            *("mass_kg", "velocity_m_s", "n_samples", "sampling_interval_s", "first_sample_s", "time"),
            *("common_depth_m", GRAVITY),
            *(f"{name}_error_sd" for name in ("level", "ramp", "velocity", "gain", "offset", "contact_time")),
        ),
    ),
}


def _exponent(name: str) -> dict[str, str]:
    return {"unit": "1", "long_name": f"slope of log {name} on log mass, all else equal"}


def _attributes() -> dict[str, dict[str, str]]:
    table = {
        pattern.format(q=q): {"unit": _UNITS[q], "long_name": words.format(name=_NAMES[q])}
        for q in _UNITS
        for pattern, words in _MEANINGS.items()
    }
    for q, unit in _UNITS.items():
        name = _NAMES[q]
        table |= {
            variable: {"unit": unit, "long_name": f"{name} of {meaning(variable).level}"}
            for variable in (q, *(f"{q}_{level}" for level in _OF))
        }
        table |= {
            f"linear_slope_{q}": {
                "unit": f"{unit} / kg",
                "long_name": f"slope of the straight line of the conditions' mean {name} against mass",
            },
            f"mass_exponent_{q}": _exponent(name),
            f"intercept_{q}": {"unit": "1", "long_name": f"log of {name} in {unit} at the reference mass"},
        }
        for group in ("subject", "trial"):
            table[f"{group}_effect_{q}"] = {"unit": "1", "long_name": f"effect of the {group} on log {name}"}
        for group in ("subject", "trial", "impact"):
            table[f"sd_{group}_{q}"] = {
                "unit": "1",
                "long_name": f"standard deviation between {group}s of log {name}",
            }
    table["residual_correlation"] = {
        "unit": "1",
        "long_name": "correlation of the impact-to-impact deviations of log K and log C",
    }
    return table | _TRACE_ATTRIBUTES


ATTRIBUTES = _attributes()


def design_attributes(design: Design) -> dict[str, dict[str, str]]:
    """Unit and meaning of what a design has besides the effects of subject and trial on K and C."""
    extra = {parameter.name: parameter for name in element_names() for parameter in element(name).extra}
    units = {q: _UNITS[q] if q in _UNITS else extra[q].unit for q in design.responses}
    names = {q: _NAMES.get(q, q) for q in design.responses}
    table: dict[str, dict[str, str]] = {}
    for name in design.groupings:
        stem = stem_of(name)
        level_words = f"each {name} at the reference mass"
        if name in _ONE_COLUMN:
            level_words = meaning(f"K_{name}").level
        for q, unit in units.items():
            table[f"{q}_{stem}"] = {"unit": unit, "long_name": f"{names[q]} of {level_words}"}
        what = f"log density of the traces of a {name}, the effects that it alone has integrated out"
        table[f"traces_of_{stem}"] = {"unit": "1", "long_name": what}
        table[f"impact_{stem}"] = {"long_name": f"the impact's {name}"}
    for q, name in names.items():
        if q not in _UNITS:
            table[f"mass_exponent_{q}"] = _exponent(name)
            at = f"log of {name} in {units[q]} at the reference mass and mean covariates"
            table[intercept(parameter_of(q))] = {"unit": "1", "long_name": at}
    for q, part in design.responses.items():
        for column in part.names:
            what = f"change of log {names[q]} for one unit of {column}, all else equal"
            table[f"effect_of_{column}_{q}"] = {"unit": "1", "long_name": what}
    for term in design.terms:
        for q, name in names.items():
            what = f"log {name}"
            if term.slope:
                which = "mass exponent of" if term.slope == MASS_TERM else f"effect of {term.slope} on log"
                table[term.coefficient(q)] = {
                    "unit": "1",
                    "long_name": f"{which} {name} of a {term.grouping} itself",
                }
                what = f"the {which} {name}"
            else:
                table[term.effect(q)] = {"unit": "1", "long_name": f"effect of the {term.grouping} on {what}"}
            between = f"standard deviation between levels of {term.grouping} of {what}"
            table[term.sd(q)] = {"unit": "1", "long_name": between}
        for name in design.recorded.named_by(q):
            level_words = f"a typical person at the reference mass, of each {name}"
            table[f"{q}_{stem_of(name)}"] = {"unit": units[q], "long_name": f"{names[q]} of {level_words}"}
    # People and conditions have words of their own for K and C.
    table = {name: words for name, words in table.items() if name not in ATTRIBUTES}
    return table | _averaged(design, ATTRIBUTES | table)


def _averaged(design: Design, known: Mapping[str, dict[str, str]]) -> dict[str, dict[str, str]]:
    """Words of what is averaged over categories that its name does not give, and ``averaged_over`` which."""
    table = {}
    for q in design.responses:
        groupings = design.groupings.items()
        columns_of: dict[str, tuple[str, ...]] = {stem_of(name): group.factors for name, group in groupings}
        columns_of |= {stem_of(name): (name,) for name in design.recorded.named_by(q)}
        for stem, columns in (columns_of | {"typical_person": (), "new": ()}).items():
            over = " and ".join(design.recorded.averaged(q, columns))
            if over and (words := known.get(f"{q}_{stem}")):
                long_name = f"{words['long_name']}, averaged over {over} with equal weight"
                table[f"{q}_{stem}"] = {**words, "long_name": long_name, "averaged_over": over}
    return table


def design_dimensions(design: Design) -> dict[str, tuple[str, ...]]:
    """Of each response of the levels of a grouping, and of the effects of each group term."""
    dimensions: dict[str, tuple[str, ...]] = {
        f"{q}_{stem_of(name)}": (name,)
        for q in design.responses
        for name in (*design.groupings, *design.recorded.named_by(q))
    }
    return dimensions | {name: (grouping,) for name, grouping in effect_dimensions(design).items()}


def of_one_person(draws: xr.Dataset) -> None:
    """Say of "this person" what is said of a typical or a new one where there are several."""
    for q in _UNITS:
        for variable in (f"{q}_{level}" for level in _OF):
            if variable in draws:
                words = draws[variable].attrs
                over = words.get("averaged_over", "")
                words["long_name"] = f"{_NAMES[q]} of {meaning(variable, people=1).level}" + (
                    f", averaged over {over} with equal weight" if over else ""
                )


def labelled(
    arrays: Mapping[str, np.ndarray],
    dimensions: Mapping[str, tuple[str, ...]],
    coordinates: Mapping[str, list[str] | np.ndarray],
    *,
    sampled: bool = True,
    kept: Collection[str] = (),
    attributes: Mapping[str, Mapping[str, str]] = MappingProxyType({}),
) -> xr.Dataset:
    """``arrays`` [chain, draw, ...] as a Dataset with named dimensions, units and meanings.

    ``dimensions`` gives what follows chain and draw; a name that it lacks is a scalar. With ``sampled``
    false the arrays have no chain and draw; those named in ``kept`` have some draws only, "kept_draw".
    ``attributes`` are of names that no other data have.
    """
    variables, known = {}, ATTRIBUTES | element_attributes() | dict(attributes)
    for name, values in arrays.items():
        leading = ("chain", "kept_draw" if name in kept else "draw") if sampled else ()
        dims = (*leading, *dimensions.get(name, ()))
        variables[name] = xr.Variable(dims, np.asarray(values), known.get(name, {"unit": "1"}))
    used = {dimension for variable in variables.values() for dimension in variable.dims}
    coords = {name: list(values) for name, values in coordinates.items() if name in used}
    for name in ("chain", "draw"):
        if name in used:
            coords[name] = list(range(next(v.sizes[name] for v in variables.values() if name in v.dims)))
    return xr.Dataset(variables, coords)


# By ArviZ's names: the sampler's, and what stands for the transitions that led to one draw.
_STATISTICS: dict[str, tuple[str, Callable[[np.ndarray], Any]]] = {
    "diverging": ("diverging", partial(np.any, axis=-1)),
    "n_steps": ("num_steps", partial(np.sum, axis=-1)),
    "tree_depth": ("num_steps", lambda steps: np.ceil(np.log2(steps.max(axis=-1) + 1)).astype(int)),
    "acceptance_rate": ("accept_prob", partial(np.mean, axis=-1)),
    "energy": ("energy", lambda values: values[..., -1]),
    "lp": ("potential_energy", lambda values: -values[..., -1]),
}


def labelled_statistics(draws: Draws, *, of_transitions: bool = False) -> xr.Dataset:
    """What the sampler tells of every draw that was kept, by ArviZ's names, or of every transition.

    Of the transitions that led to a draw: whether any diverged, their steps together, their deepest tree and
    their mean acceptance; energy and density are the last one's.
    """
    chains, transitions = draws.statistics["num_steps"].shape
    count = transitions if of_transitions else next(iter(draws.sites.values())).shape[1]
    statistics = {
        name: of_several(draws.statistics[statistic].reshape(chains, count, -1))
        for name, (statistic, of_several) in _STATISTICS.items()
    }
    # A tree of the greatest allowed depth that turned by itself is not cut off; only one more step tells.
    return labelled(statistics, {}, {}).assign_attrs(max_tree_depth=draws.max_tree_depth)
