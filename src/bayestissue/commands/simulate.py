"""`bayestissue simulate`: a dataset whose truth is known."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bayestissue.commands.options import OtherSeed, Out, Overwrite, Quiet
from bayestissue.results import claim
from bayestissue.runtime import configure


def run(
    specification: Annotated[Path, typer.Argument(metavar="SPEC.toml")],
    out: Out,
    seed: OtherSeed = None,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
) -> None:
    """Make a dataset whose truth is known: a design, a tissue, a measuring chain, and truth.csv beside it.

    Args:
        specification: Design, tissue, measuring chain and seed.
        seed: Instead of the one in SPEC.toml.
    """
    with claim(out, overwrite=overwrite, command="simulate", inputs=(specification,)) as target:
        configure()
        from bayestissue.commands.console import echo
        from bayestissue.outline import counted
        from bayestissue.simulation import read_simulation, simulate, write_campaign

        simulation = read_simulation(specification)
        if seed is not None:
            simulation = simulation.model_copy(update={"seed": seed})
        campaign = simulate(simulation)
        with target.folder() as staging:
            write_campaign(staging, campaign, simulation)
            _write_specification(staging / "truth.toml", specification, simulation.seed)
        if not quiet:
            impacts, samples = counted(len(campaign.impacts), "impact"), len(campaign.value)
            echo(f"wrote {target.path}: {impacts}, {samples} samples, seed {simulation.seed}")


def _write_specification(path: Path, specification: Path, seed: int) -> None:
    text = specification.read_text(encoding="utf-8-sig")
    lines = [line for line in text.splitlines() if line.split("=")[0].strip() != "seed"]
    path.write_text("\n".join([f"seed = {seed}", *lines]) + "\n", encoding="utf-8")
