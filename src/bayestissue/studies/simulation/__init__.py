"""Campaigns whose truth is known: a design, a tissue and a measuring chain, from a specification."""

from bayestissue.studies.simulation.campaign import Campaign, simulate, write_campaign
from bayestissue.studies.simulation.simulation_file import Simulation, read_simulation

__all__ = ["Campaign", "Simulation", "read_simulation", "simulate", "write_campaign"]
