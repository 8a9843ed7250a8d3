"""A small finished fit with the log densities that a comparison needs; its numbers are invented."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from made_once import made_once
from make_fit_run import CHAINS, CONDITIONS, DRAWS, PEOPLE, Groups, write_fit_run

IMPACTS = PEOPLE * CONDITIONS


def make_scored_run(folder: Path, *, about: dict[str, Any] | None = None, **options: Any) -> Path:
    """A run as `make_fit_run` writes it, with log densities.

    ``about`` replaces keys of ``run.json``; every other option is that of `_scored_run`.
    """
    path = _scored_run(folder, **options) / "run.json"
    content = json.loads(path.read_text(encoding="utf-8")) | (about or {})
    path.write_text(json.dumps(content), encoding="utf-8")
    return folder


@made_once
def _scored_run(folder: Path, *, worse: float = 0.0, shift: float = 0.0, **fit: Any) -> Path:
    """Every impact's density is lower by ``worse`` than that of a run without it, give or take a tenth.

    ``shift`` is added to the observed traces, as another choice of the rest position would; ``fit`` has the
    options of `make_fit_run`.
    """

    def scored(groups: Groups) -> Groups:
        observed = groups["observed_data"] + shift
        return groups | _scores(groups["posterior"], worse) | {"observed_data": observed}

    return write_fit_run(folder, **fit, extended=scored)


def _scores(posterior: xr.Dataset, worse: float) -> Groups:
    rng = np.random.default_rng(5)
    level = 4000 + 100 * rng.standard_normal(IMPACTS)
    moves = rng.standard_normal((CHAINS, DRAWS, IMPACTS))
    density = level - worse * (1 + 0.1 * rng.standard_normal(IMPACTS)) - 0.05 * moves**2
    grid = density.reshape(CHAINS, DRAWS, CONDITIONS, PEOPLE)
    names = {name: posterior[name].to_numpy() for name in ("impact", "subject", "trial")}
    leading = ("chain", "draw")
    of_groups = {
        "traces_of_subject": ((*leading, "subject"), grid.sum(axis=2)),
        "traces_of_trial": ((*leading, "trial"), grid.sum(axis=3)),
    }
    return {
        "log_likelihood": xr.Dataset({"trace": ((*leading, "impact"), density)}, {"impact": names["impact"]}),
        "log_likelihood_of_groups": xr.Dataset(
            of_groups, {name: names[name] for name in ("subject", "trial")}
        ),
    }
