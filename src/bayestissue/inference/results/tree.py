"""A fit's draws as one labelled tree, with what the model predicts and what it was given."""

from __future__ import annotations

from functools import partial
from typing import Any

import jax
import numpy as np
import xarray as xr
from pandas.api.types import is_numeric_dtype

from bayestissue.inference.execution.compiling import compiled_quickly
from bayestissue.inference.execution.kept import some_impacts, some_of
from bayestissue.inference.quantities.impact_quantities import NAMES
from bayestissue.inference.quantities.quantity_draws import (
    PRIOR_PREDICTIVE_DRAWS,
    Draws,
    predicted,
    prior_draws,
    quantities,
    replicates,
)
from bayestissue.inference.quantities.secants import (
    EXPONENTS,
    comparable_draws,
    mass_exponents_of_secants,
)
from bayestissue.inference.results.labels import (
    Variable,
    design_variables,
    labelled,
    variables,
)
from bayestissue.mechanics.elements.element import GRAVITY
from bayestissue.mechanics.elements.head_injury import HEADFORM
from bayestissue.model.hierarchy.formulas.group_terms import stem_of
from bayestissue.model.hierarchy.specification import ModelSpecification
from bayestissue.model.hierarchy.trace_data import Prepared, common_depth
from bayestissue.recordings.dataset.impact_table import RESERVED


def posterior_tree(
    prepared: Prepared, specification: ModelSpecification, statistics: xr.Dataset, draws: Draws, seed: int
) -> xr.DataTree:
    """All groups of a finished fit; see `bayestissue.inference.results.labels` for units and meanings.

    Where impacts are many, theirs are the draws that were kept, along a dimension of their own, and what
    multiplies draws by impacts once more (predictions, priors, log densities) is of some impacts.
    """
    rng = np.random.default_rng(seed)
    further = design_variables(prepared.design) | {
        f"column_{stem_of(n)}": Variable({"column": n, "long_name": f"the impact's {n}"}, ("impact",))
        for n in _columns(prepared)
    }
    recorded, kept_numbers = prepared.design.recorded, draws.kept_numbers
    subset = some_of(prepared, some_impacts(len(prepared.impacts)))
    of_impacts = partial(labelled, coordinates=_coordinates(subset, kept_numbers), further=further)
    of_all_impacts = partial(
        labelled,
        coordinates=_coordinates(prepared, kept_numbers),
        further=further,
        thinned=() if kept_numbers is None else {*NAMES, *EXPONENTS, *prepared.data.record.errors},
    )
    values = quantities(prepared, draws, rng) | mass_exponents_of_secants(prepared, draws, seed)
    priors = compiled_quickly(specification.complete_priors().log_densities)(
        {name: array for name, array in draws.population.items() if name in values}
    )
    log_likelihood, posterior = draws.log_likelihood, of_all_impacts(values)
    if prepared.model.discrepancy:
        levels = {name: recorded.labels(name) for name in ("subject", *recorded.response("K").named_by)}
        together = comparable_draws(posterior[["K_secant"]], levels)
        known = {**variables(), **further}
        posterior = posterior.assign({n: v.assign_attrs(known[n].attrs) for n, v in together.items()})
    return xr.DataTree.from_dict(
        {
            "posterior": posterior,
            "sample_stats": statistics,
            "log_likelihood": of_impacts({"trace": log_likelihood["trace"]}),
            "log_likelihood_of_groups": of_impacts({k: v for k, v in log_likelihood.items() if k != "trace"}),
            "log_prior": of_impacts({name: np.asarray(v) for name, v in priors.items()}),
            "posterior_predictive": of_impacts(predicted(subset, draws, seed)),
            "observed_data": of_impacts(_observed(subset), sampled=False),
            "constant_data": of_all_impacts(_constants(prepared), sampled=False),
            **_prior_groups(subset, of_impacts, seed, rng, single=kept_numbers is not None),
        }
    )


def _coordinates(prepared: Prepared, kept_numbers: np.ndarray | None) -> dict[str, Any]:
    levels = prepared.design.levels()
    names = {"impact": prepared.impacts["impact"].astype(str).tolist(), **levels}
    return names if kept_numbers is None else names | {"kept_draw": kept_numbers}


def _observed(prepared: Prepared) -> dict[str, np.ndarray]:
    signal = prepared.signal
    return {
        "displacement": np.where(signal.inside, signal.x, np.nan),
        "deceleration": np.where(signal.inside, signal.deceleration, np.nan),
        **({"force": prepared.force.recorded(signal.mass)} if prepared.force else {}),
    }


def _constants(prepared: Prepared) -> dict[str, np.ndarray]:
    signal, record = prepared.signal, prepared.data.record
    error_sd, first = prepared.error_sd, np.asarray(record.first_time)
    columns = prepared.impacts[_columns(prepared)]
    return {
        **({"common_depth_m": common_depth(signal)} if prepared.model.depends_on_depth else {}),
        **({GRAVITY: signal.gravity[0]} if signal.gravity.any() else {}),
        **({"force_time": prepared.force.time} if prepared.force else {}),
        **({HEADFORM: 1} if prepared.model.headform else {}),
        "time": np.where(signal.inside, first[:, None] + signal.time_s, np.nan),
        "mass_kg": signal.mass,
        "velocity_m_s": signal.velocity,
        "n_samples": signal.n_samples,
        "sampling_interval_s": np.asarray(record.dt),
        "first_sample_s": first,
        **{
            f"impact_{stem_of(name)}": np.array(grouping.levels)[grouping.code]
            for name, grouping in prepared.design.groupings.items()
        },
        **{f"{name}_sd": error_sd[:, i] for i, name in enumerate(record.errors)},
        **{
            f"column_{stem_of(str(name))}": column.to_numpy(float if is_numeric_dtype(column) else str)
            for name, column in columns.items()
        },
    }


def _columns(prepared: Prepared) -> list[str]:
    """The columns of the impacts that formulas may name and that stand nowhere else."""
    return [str(name) for name in prepared.impacts if name not in RESERVED and "/" not in str(name)]


def _prior_groups(
    prepared: Prepared, put: Any, seed: int, rng: np.random.Generator, *, single: bool
) -> dict[str, xr.Dataset]:
    # A prior's wall may be thin enough to throw the impactor back faster than any number.
    with np.errstate(over="ignore"):
        draws = prior_draws(prepared, seed, single=single)
        u = draws.impacts["parameters"][0, :PRIOR_PREDICTIVE_DRAWS].astype(float)
        keys = jax.random.split(jax.random.fold_in(jax.random.PRNGKey(seed), 13), len(u))
        replicated = replicates(prepared.model, prepared.data, u, keys)
        traces = {name: v.astype(np.float32)[None] for name, v in replicated.items()}
    return {"prior": put(quantities(prepared, draws, rng)), "prior_predictive": put(traces)}
