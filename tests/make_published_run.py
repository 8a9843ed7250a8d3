"""A finished `reproduce` that the program made: ``python tests/make_published_run.py`` makes it anew."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

import tomlkit
import xarray as xr

from bayestissue.base import runtime
from bayestissue.base.resources import shared
from bayestissue.base.results.files import write_tree
from command_line import bayestissue
from made_once import made_once
from tree_file import pack, single_precision, unpack

STORED = Path(__file__).with_name("published_run.tar.xz")
CHAINS, DRAWS = 2, 150
EXPLANATIONS = ("log mass", "mass", "energy", "none")


@made_once
def make_published_run(folder: Path) -> Path:
    """The stored one."""
    return unpack(STORED, folder)


def store(folder: Path) -> None:
    """By the program, of four explanations, with a quarter of the draws."""
    model = tomlkit.parse(shared("models", "published.toml").read_text(encoding="utf-8"))
    formulas = model["comparison"]["formulas"]
    model["comparison"]["formulas"] = {name: formulas[name] for name in EXPLANATIONS}
    model["sampler"] |= {"chains": CHAINS, "draws": 4 * DRAWS}
    (folder / "model.toml").write_text(tomlkit.dumps(model), encoding="utf-8")
    runtime.configure()
    made = bayestissue("reproduce", "--model", folder / "model.toml", "--out", run := folder / "run")
    assert made.status == 0, made.err
    with xr.open_datatree(run / "posterior.nc", engine="h5netcdf") as tree:
        groups = {name: part.to_dataset().load() for name, part in tree.children.items()}
    few = {
        name: data.isel(draw=slice(None, None, 4)).map(single_precision, keep_attrs=True)
        for name, data in groups.items()
        if "draw" in data.dims
    }
    for name in ("posterior.nc", "report.html", ".bayestissue.json"):
        (run / name).unlink()
    write_tree(xr.DataTree.from_dict(groups | few), run / "posterior.nc")
    pack(run, STORED)


if __name__ == "__main__":
    with TemporaryDirectory() as name:
        store(Path(name))
