"""Planned designs, and thousands of studies of them drawn as Gaussian sites.

Designs that share their conditions are rows of one arrangement, the largest: a smaller one lacks some of its
impacts. Study number s has then the same people, the same truth and the same errors in all of them, and what
is compiled for one serves all. An impact's site has its centre at u plus an error N(0, P^-1): no trace is
simulated. Where all masses have a factor in common, u is at the recorded ones: log K and log C less its log.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import jax.numpy as jnp
import numpy as np
import pandas as pd
from jaxtyping import Bool, Float

from bayestissue.model.hierarchy.design import Design, build_design
from bayestissue.model.hierarchy.gaussian.arrangement import PopulationDesign, expected
from bayestissue.model.hierarchy.population import MASS_ERROR, shared_mass_errors
from bayestissue.model.hierarchy.responses import RESPONSES
from bayestissue.model.hierarchy.specification import ModelSpecification
from bayestissue.studies.planning.design_prior import BLOCK, Streams, Truths
from bayestissue.studies.planning.information import Information
from bayestissue.studies.planning.running import Running
from bayestissue.studies.planning.study_posterior import PlannedModel, planned_model

_REPEAT = "_repeat"


@dataclass(frozen=True, eq=False)
class Arrangement:
    """Designs over the same conditions.

    Attributes:
        numbers: which of all designs they are.
        rows: the impacts of all of them, each once.
        present: which of these each design has.
        design: the formulas over all rows.
        model: the analysis.
        columns: X, arranged.
        precision: of log K and log C of each impact, from its trace.
        recorded: of the impacts that a running study has, the first ones, the centres of their sites.
    """

    numbers: tuple[int, ...]
    rows: pd.DataFrame
    present: Bool[np.ndarray, "design impact"]
    design: Design
    model: PlannedModel
    columns: PopulationDesign
    precision: Float[np.ndarray, "impact parameter parameter"]
    recorded: Float[np.ndarray, "recorded parameter"]

    def with_traces(self, information: Information, running: Running) -> Arrangement:
        """The same with what traces tell.

        Args:
            information: by condition.
            running: what all designs go on from; its impacts are the first rows.
        """
        precision = information.of_rows(self.rows)
        precision[: len(running.centre)] = running.precision
        return replace(self, precision=precision, recorded=running.centre)


def arrangements(
    designs: Sequence[pd.DataFrame],
    specification: ModelSpecification,
    *,
    reference_mass_kg: float,
    relative_mass_sd: float = 0.0,
) -> list[Arrangement]:
    """The designs, those over the same conditions together, before it is known what traces tell.

    Args:
        designs: each one's impacts: ``subject``, ``trial``, ``mass_kg``, ``velocity_m_s`` and factors.
        specification: the analysis.
        reference_mass_kg: the mass that K and C are stated at, of all designs.
        relative_mass_sd: of the recorded mass.

    Raises:
        InputError: a formula asks for what a design can't identify.
    """
    together: dict[frozenset[tuple[object, ...]], list[int]] = {}
    for number, rows in enumerate(designs):
        conditions = rows.drop(columns="subject").drop_duplicates()
        key = frozenset(conditions.itertuples(index=False, name=None))
        together.setdefault(key, []).append(number)
    arranged = []
    for numbers in together.values():
        tables = [_with_repeats(designs[number]) for number in numbers]
        rows = pd.concat(tables).drop_duplicates(ignore_index=True)
        keys = pd.MultiIndex.from_frame(rows)
        present = np.stack([keys.isin(pd.MultiIndex.from_frame(table)) for table in tables])
        rows = rows.drop(columns=_REPEAT)
        design = build_design(
            specification.formula, rows, reference_mass_kg=reference_mass_kg, source=specification.name
        )
        model, columns = planned_model(specification, design, relative_mass_sd)
        size = len(RESPONSES)
        nothing = np.zeros((len(rows), size, size)), np.zeros((0, size))
        arranged.append(Arrangement(tuple(numbers), rows, present, design, model, columns, *nothing))
    return arranged


def _with_repeats(rows: pd.DataFrame) -> pd.DataFrame:
    return rows.assign(**{_REPEAT: rows.groupby(list(rows), dropna=False).cumcount().to_numpy()})


@dataclass(frozen=True, eq=False)
class Studies:
    """A block of studies, of the largest design.

    Attributes:
        b: all fixed and group effects.
        centre: of each impact's site.
    """

    b: Float[np.ndarray, "study location"]
    centre: Float[np.ndarray, "study impact parameter"]


def draw_studies(arrangement: Arrangement, truths: Truths, streams: Streams) -> Studies:
    """Draw people, conditions, impacts and what their traces say.

    Args:
        arrangement: the designs.
        truths: of each study.
        streams: the block's random numbers.
    """
    model, impacts, known_errors = arrangement.model, len(arrangement.rows), truths.mass_errors
    b = np.zeros((BLOCK, model.locations.size))
    for part in model.locations.blocks:
        where = model.locations.parts[part.name]
        if part.name == MASS_ERROR:
            b[:, where] = model.log_mass_sd * streams.normal("mass", part.width)
            if known_errors is not None:
                # Impactors that have hit already are as wrong as they were.
                numbered = jnp.arange(model.locations.size) - float(where.start)
                code = np.asarray(shared_mass_errors(model.locations, arrangement.columns, numbered))
                b[:, where.start + code[: known_errors.shape[1]].round().astype(int)] = known_errors
        elif part.spread:
            standard = streams.normal(part.name, part.width)
            effects = truths.hyperparameters[part.spread][:, None] * standard
            known = truths.effects.get(part.name, np.full((BLOCK, 0), np.nan))
            levels = known.shape[1]
            effects[:, :levels] = np.where(np.isnan(known), effects[:, :levels], known)
            b[:, where] = effects
        else:
            b[:, where] = truths.fixed[part.name]
    means = np.moveaxis(np.asarray(expected(arrangement.columns, jnp.asarray(b))), 0, -1)
    sd_K, sd_C = truths.hyperparameters["sd_impact_K"], truths.hyperparameters["sd_impact_C"]
    correlation = truths.hyperparameters.get("residual_correlation", np.zeros(BLOCK))
    standard = streams.normal("impacts", 2 * impacts).reshape(BLOCK, impacts, 2)
    scatter = np.empty_like(standard)
    scatter[..., 0] = sd_K[:, None] * standard[..., 0]
    across = np.sqrt(1 - correlation**2)[:, None]
    scatter[..., 1] = sd_C[:, None] * (correlation[:, None] * standard[..., 0] + across * standard[..., 1])
    # A heavier impactor than recorded makes K and C look smaller alike: of each impact, or of all.
    of_mass = model.own_mass_sd * streams.normal("mass", impacts)
    if model.common_mass_sd is not None:
        drawn = model.common_mass_sd * streams.normal("mass", 1)
        of_mass = np.broadcast_to(drawn if known_errors is None else known_errors[:, :1], (BLOCK, impacts))
    by_mass = np.stack([of_mass, of_mass], axis=-1)
    # Of P = L L' an error L'^-1 z has the covariance P^-1.
    root = np.linalg.cholesky(arrangement.precision)
    errors = streams.normal("errors", 2 * impacts).reshape(BLOCK, impacts, 2)
    measured = np.linalg.solve(np.swapaxes(root, -1, -2), errors[..., None])[..., 0]
    centre = means + scatter - by_mass + measured
    centre[:, : len(arrangement.recorded)] = arrangement.recorded
    return Studies(b, centre)
