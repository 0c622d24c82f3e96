"""Recordings of a known array in a known field: the truth that fits are judged by."""

from tam_calibration.simulation.observe import Simulation, simulate
from tam_calibration.simulation.scenario import Scenario

__all__ = ["Scenario", "Simulation", "simulate"]
