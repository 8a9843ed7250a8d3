"""A small finished fit with the log densities that a comparison needs; its numbers are invented."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from made_once import made_once
from make_fit_run import CHAINS, CONDITIONS, DRAWS, PEOPLE, make_fit_run

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
    make_fit_run(folder, **fit)
    path = folder / "posterior.nc"
    with xr.open_datatree(path, engine="h5netcdf") as stored:
        tree = stored.load()
    rng = np.random.default_rng(5)
    level = 4000 + 100 * rng.standard_normal(IMPACTS)
    moves = rng.standard_normal((CHAINS, DRAWS, IMPACTS))
    density = level - worse * (1 + 0.1 * rng.standard_normal(IMPACTS)) - 0.05 * moves**2
    grid = density.reshape(CHAINS, DRAWS, CONDITIONS, PEOPLE)
    names = {name: tree["posterior"][name].to_numpy() for name in ("impact", "subject", "trial")}
    leading = ("chain", "draw")
    tree["log_likelihood"] = xr.DataTree(
        xr.Dataset({"trace": ((*leading, "impact"), density)}, {"impact": names["impact"]})
    )
    tree["log_likelihood_of_groups"] = xr.DataTree(
        xr.Dataset(
            {
                "traces_of_subject": ((*leading, "subject"), grid.sum(axis=2)),
                "traces_of_trial": ((*leading, "trial"), grid.sum(axis=3)),
            },
            {name: names[name] for name in ("subject", "trial")},
        )
    )
    tree["observed_data"] = xr.DataTree(tree["observed_data"].to_dataset() + shift)
    tree.to_netcdf(path, engine="h5netcdf")
    return folder
