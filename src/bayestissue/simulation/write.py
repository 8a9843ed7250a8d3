"""A simulated campaign as a dataset folder with the truth beside it."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

from bayestissue.dataset import write_dataset
from bayestissue.simulation.campaign import Campaign
from bayestissue.simulation.specification import Simulation


def write_campaign(folder: Path, campaign: Campaign, simulation: Simulation) -> None:
    """Write ``dataset.toml``, ``impacts.csv``, the traces and ``truth.csv``.

    ``truth.csv`` has one row per impact. The parameters that all impacts share stand in the specification,
    which the caller copies beside it.
    """
    settings: dict[str, Any] = {
        "name": simulation.name,
        "description": simulation.description or "Simulated; truth.csv holds what it was made from.",
        "source": "bayestissue simulate",
        "signal": {"quantity": "deceleration", "unit": "m/s^2"},
        "uncertainty": asdict(campaign.uncertainty),
    }
    if campaign.gravity:
        settings["signal"] |= {"gravity": campaign.gravity}
    if campaign.recorder is not None:
        settings["recorder"] = campaign.recorder.settings()
    write_dataset(
        folder,
        settings=settings,
        impacts=campaign.impacts,
        traces=campaign.traces(),
        trace_file=f"traces.{simulation.output.traces}",  # type: ignore[arg-type]
    )
    campaign.truth.to_csv(folder / "truth.csv", index=False, lineterminator="\n")
