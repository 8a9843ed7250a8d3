"""`bayestissue simulate`: a dataset whose truth is known."""

from __future__ import annotations

from pathlib import Path

from bayestissue.commands.console import echo
from bayestissue.results import claim
from bayestissue.runtime import configure


def run(specification: Path, *, out: Path, seed: int | None, overwrite: bool, quiet: bool) -> None:
    """Simulate what a specification says and write it as a dataset.

    Writes what a dataset needs (``dataset.toml``, ``impacts.csv``, the traces), ``truth.csv`` with one row
    per impact, and ``truth.toml``, the specification with the seed that was used.

    Raises:
        InputError: the specification is wrong, or ``out`` is not free.
    """
    with claim(out, overwrite=overwrite, command="simulate", inputs=(specification,)) as place:
        configure()
        from bayestissue.simulation import read_simulation, simulate, write_campaign

        simulation = read_simulation(specification)
        if seed is not None:
            simulation = simulation.model_copy(update={"seed": seed})
        campaign = simulate(simulation)
        with place.folder() as staging:
            write_campaign(staging, campaign, simulation)
            _write_specification(staging / "truth.toml", specification, simulation.seed)
        if not quiet:
            impacts, samples = len(campaign.impacts), len(campaign.value)
            echo(f"wrote {place.path}: {impacts} impacts, {samples} samples, seed {simulation.seed}")


def _write_specification(path: Path, specification: Path, seed: int) -> None:
    text = specification.read_text(encoding="utf-8-sig")
    lines = [line for line in text.splitlines() if line.split("=")[0].strip() != "seed"]
    path.write_text("\n".join([f"seed = {seed}", *lines]) + "\n", encoding="utf-8")
